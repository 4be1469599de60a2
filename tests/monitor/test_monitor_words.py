"""Words, bars, histories and what the plots are drawn of: what a reader sees for given values."""

from __future__ import annotations

import math
import re
from datetime import datetime
from itertools import pairwise

import pytest
from monitor_messages import (
    Scene,
    attitude,
    battery,
    escs,
    heartbeat,
    hover,
    look,
    position,
    px4_table,
    servo,
)
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.monitor.screen import marks, words
from coaxlink.monitor.screen.dialogs import parse_time
from coaxlink.monitor.screen.history import History, Point, Window, errors, shares
from coaxlink.monitor.screen.pages import parameter_words
from coaxlink.monitor.screen.plots import around_zero, parts, share_range, ticks
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.rotors import RotorView


def test_numbers_times_and_bars() -> None:
    cases = [
        (marks.number(None), "--"),
        (marks.number(math.nan), "--"),
        (marks.number(math.inf), "--"),
        (marks.number(-0.001), "0.0"),
        (marks.number(-0.001, signed=True), "+0.0"),
        (marks.number(24.96), "25.0"),
        (marks.number(-3.2, signed=True), "-3.2"),
        (marks.number(1.6e30), "2e+30"),
        (marks.number(24.96, stale=True), "25.0*"),
        (marks.clock(754.5), "12:34.5"),
        (marks.clock(3661.0), "1:01:01.0"),
        (marks.clock(-1.0), "-0:01.0"),
        (marks.clock(None), "--"),
        (marks.bar(0.5, 8, "").plain, "████····"),
        (marks.bar(0.5 + 1 / 64, 8, "").plain, "████▏···"),
        (marks.bar(7.0, 4, "").plain, "████"),
        (marks.bar(-1.0, 4, "").plain, "····"),
        (marks.bar(None, 4, "").plain, "····"),
        (parse_time("90"), 90.0),
        (parse_time("1:30"), 90.0),
        (parse_time("0:01:30.5"), 90.5),
        (parse_time(""), None),
        (parse_time("x"), None),
        (parse_time("-3"), None),
        (parse_time("nan"), None),
    ]
    assert [(found, expected) for found, expected in cases if found != expected] == []


def test_a_rotor_line_fills_its_width_whatever_it_shows() -> None:
    rotor = RotorView(12, "lower", 0.648, 3499.0, 0.65, 28.9, 0.92, 77.9)
    full = RotorView(6, "lower", 1.0, 5400.0, 1.0, 77.9, 2.1, 77.9, "max")
    for width in (28, 30, 36, 46, 56, 90):
        line = words.rotor_line(rotor, width, stale=False)
        assert line.cell_len == width
        assert line.plain.startswith("▼12 ") and "28.9 N" in line.plain and "65 %" in line.plain
        bound = words.rotor_line(full, width, stale=False)
        assert bound.plain.startswith("▼6! ") and bound.cell_len == width
        assert ("at max" if width >= 46 else "MA") in bound.plain
    absurd = RotorView(1, "upper", 1e9, 5.4e12, 1.0, 5.6e19, 1e18, 78.4)
    assert words.rotor_line(absurd, 36, stale=False).cell_len <= 40


def test_split_of_an_arm_is_a_hundred_together() -> None:
    arm = look(heartbeat(), servo()).arms[0]
    assert arm.upper_share is not None and arm.ideal_share is not None
    top, best = round(100 * arm.upper_share), round(100 * arm.ideal_share)
    expected = f"{arm.thrust_N:.1f} N  {top} : {100 - top} %  ideal {best} : {100 - best}"
    assert words.arm_split(arm).plain == expected
    assert words.arm_split(arm, room=28).plain == expected.split("N  ")[1]
    assert "--" in words.arm_split(look(heartbeat()).arms[0]).plain


def test_head_says_waiting_live_lost_and_armed() -> None:
    assert "waiting for a heartbeat at udpin:0.0.0.0:14550" in words.head(look(), 80).plain
    live = words.head(look(heartbeat()), 80).plain
    assert "ARMED" in live and "Position" in live and "live" in live and len(live) == 80
    assert "disarmed" in words.head(look(heartbeat(armed=False)), 80).plain
    lost = look(heartbeat(), later_s=20.0)
    assert "lost" in words.head(lost, 80).plain
    assert "LINK LOST" in words.notes(lost).plain
    assert "udpin" in words.head(look(heartbeat()), 120).plain


def test_every_stale_number_carries_a_mark_and_no_fresh_one_does() -> None:
    sent = (heartbeat(), servo(), attitude(), position(), battery(), escs(0, [2381] * 4))

    def panels(view: Moment) -> str:
        old = words.speeds_old(view)
        texts = [words.balance(view), words.vehicle(view), words.weight_and_split(view)]
        for arm in view.arms:
            texts += [words.arm_body(arm, 46, old), words.arm_split(arm, old)]
            texts.append(words.arm_title(arm, view.escs_stale or old))
        return "\n".join(t.plain for t in texts)

    fresh, lost = panels(look(*sent)), panels(look(*sent, later_s=20.0))
    # numbers; rotors' own stand behind their triangle
    numbers = r"(?<![\d▲▼.])[+-]?\d+(?:\.\d+)?(?!\.?\d)"
    assert len(re.findall(numbers, fresh)) > 50 and marks.STALE not in fresh
    assert re.findall(numbers + r"(?!\*)", lost) == []
    assert len(re.findall(numbers, lost)) == len(re.findall(numbers, fresh))
    assert "battery ok*" in lost
    assert "marked *" in words.notes(look(*sent, later_s=20.0)).plain


def test_battery_in_a_word_with_minutes() -> None:
    pack = battery()
    assert words.battery_words(look(heartbeat(), pack)).plain == "battery ok"
    pack.time_remaining, pack.charge_state = 250, 3
    reported = words.battery_words(look(heartbeat(), pack))
    assert reported.plain == "CRITICAL, 4 min left" and marks.BAD in str(reported.style) + str(reported.spans)
    assert words.battery_words(look(heartbeat())).plain == "charge not reported"


def test_summary_is_complete() -> None:
    text = words.summary(look(heartbeat(), servo())).plain
    for part in ("front right", "rear left", "thrust", "SERVO_OUTPUT_RAW", "table on board", "not read yet"):
        assert part in text


def test_texts_have_times_and_severities_newest_first() -> None:
    first = mavlink.MAVLink_statustext_message(6, b"Takeoff detected")
    low = mavlink.MAVLink_statustext_message(4, b"low battery")
    view = look(heartbeat(), attitude(boot_ms=61500), first, low, later_s=2.0)
    lines = words.reported(view, datetime(2026, 1, 1, 12, 0, 2)).plain.split("\n")
    assert lines[0].split() == ["1:01.5", "12:00:00", "warning", "low", "battery"]
    assert lines[1].split()[2:] == ["info", "Takeoff", "detected"] and len(lines) == 2
    assert "12:" not in words.reported(view, None).plain
    assert words.reported(look(heartbeat()), None).plain == "no message yet"


def test_the_table_s_parameters_stand_in_columns_below_the_command_that_writes() -> None:
    view = look(heartbeat(), **px4_table(46.95, 69.89), BAT_LOW_THR=0.15)
    lines = parameter_words(view, 76).plain.split("\n")
    assert "coaxlink upload TABLE --connect udpin:0.0.0.0:14550 --dry-run" in lines[1]
    assert all(len(line) <= 76 for line in lines)
    shown = dict(re.findall(r"([A-Z]\w+) +(-?[\d.]+)", "\n".join(lines[3:])))
    assert len(shown) == 4 + 8 * 8 and shown["CA_ROTOR4_CT"] == "69.89" and "BAT_LOW_THR" not in shown
    assert "none of them was read yet" in parameter_words(look(), 76).plain


# -- plots -------------------------------------------------------------------------------------------------


def test_history_runs_on_the_vehicles_clock_and_starts_anew_after_a_reboot() -> None:
    scene, history = Scene(), History(span_s=10.0)
    for k in range(30):
        history = history.extended(scene.look(*hover(boot_ms=1000 * k)))
    assert [p.time_s for p in history.points] == [float(t) for t in range(19, 30)]
    assert history.extended(scene.look(*hover(boot_ms=29000))) is history
    stale = scene.look(later_s=2.0)
    assert history.extended(stale) is history
    rebooted = history.extended(scene.look(*hover(boot_ms=500)))
    assert [p.time_s for p in rebooted.points] == [0.5]


def test_a_window_is_moved_and_zoomed_inside_the_history() -> None:
    points = tuple(Point(float(t), (0.4, None), (0.45,), (0.1 * t, 0.5, -0.5, 0.0)) for t in range(600))
    history = History(600.0, points)
    assert history.range_s(Window(60.0)) == (539.0, 599.0)
    assert history.range_s(Window(60.0).moved(1.0, history)) == (479.0, 539.0)
    assert Window(60.0).moved(99.0, history).back_s == history.length_s - 60.0
    assert Window(60.0).moved(-1.0, history).back_s == 0.0
    assert Window(60.0).zoomed(0.5).span_s == 30.0 and Window(60.0).zoomed(99.0).span_s == 600.0
    assert shares(points[:2], 0) == ((0.0, 40.0), (1.0, 40.0)) and shares(points, 1) == ()
    assert errors(points[10:11], 0) == ((10.0, 1.0),)


def test_a_line_is_not_drawn_across_a_gap() -> None:
    line = tuple((float(t), 0.0) for t in (0, 1, 2, 9, 10))
    assert [len(p) for p in parts(line, 3.0)] == [3, 2] and [len(p) for p in parts(line, 8.0)] == [5]
    assert parts((), 3.0) == []


def test_ranges_hold_the_data() -> None:
    assert share_range([]) == (40.0, 60.0)
    assert share_range([51.0, 52.0]) == (45.0, 55.0)
    assert share_range([33.0, 61.0]) == (30.0, 65.0)
    assert around_zero([], 0.1) == pytest.approx((-0.1, 0.1))
    low, high = around_zero([3.0, 61.0], 0.1)
    assert low <= -0.1 and 61.0 <= high < 75.0


def test_numbers_beside_a_plot_are_round_and_apart() -> None:
    wrong = []
    for rows in range(2, 60):
        for low, high in ((40.0, 60.0), (45.0, 65.0), (30.0, 65.0), (0.0, 100.0), (40.0, 50.0)):
            found = ticks(rows, low, high)
            cells = [(t - low) / (high - low) * (rows - 1) for t in found]
            apart = all(b - a >= 2.99 for a, b in pairwise(cells)) or len(found) == 2
            if (found[0], found[-1]) != (low, high) or any(t % 5.0 for t in found) or not apart:
                wrong.append((rows, low, high, found))
    assert wrong == []
