"""Words, bars and plots: what a reader sees for given values."""

from __future__ import annotations

import math
import re
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from monitor_messages import EscStatus, Sender, attitude, battery, heartbeat, position, servo
from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.monitor.screen import format as words
from coaxlink.monitor.screen import marks
from coaxlink.monitor.screen.history import History, Point, Window
from coaxlink.monitor.screen.plot import braille, nice_range
from coaxlink.monitor.screen.plots import error_plot, split_plot, ticks
from coaxlink.monitor.screen.themes import PALETTES, dress
from coaxlink.monitor.state import RotorView, View, observe
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle

AIRFRAME = load_airframe(files.example("x8_paper.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))
ARMS = observe(Collector().readings(0.0), Vehicle(AIRFRAME, MODEL), 0.0).arms


def view_of(*messages: Any, at: float = 1.0, now: float = 1.0) -> View:
    collector, sender = Collector(), Sender()
    for message in messages:
        collector.take(sender(message), at)
    return observe(collector.readings(now), Vehicle(AIRFRAME, MODEL), now, address="udpin:0.0.0.0:14550")


@pytest.mark.parametrize(
    ("value", "digits", "signed", "text"),
    [
        (None, 1, False, "--"),
        (math.nan, 1, False, "--"),
        (math.inf, 1, False, "--"),
        (-0.001, 1, False, "0.0"),
        (-0.001, 1, True, "+0.0"),
        (24.96, 1, False, "25.0"),
        (-3.2, 1, True, "-3.2"),
        (1.6e30, 1, False, "2e+30"),
    ],
)
def test_numbers(value: float | None, digits: int, signed: bool, text: str) -> None:
    assert marks.number(value, digits, signed) == text


def test_bar_lengths() -> None:
    assert marks.bar(0.5, 8, "").plain == "████····"
    assert marks.bar(0.5 + 1 / 64, 8, "").plain == "████▏···"
    assert marks.bar(7.0, 4, "").plain == "████"
    assert marks.bar(-1.0, 4, "").plain == "····"
    assert marks.bar(None, 4, "").plain == "····"


@pytest.mark.parametrize("width", [30, 36, 46, 56, 90])
def test_a_rotor_line_fills_its_width(width: int) -> None:
    rotor = RotorView(12, "lower", 0.648, 3499.0, 0.65, 28.9, 0.92, 77.9)
    line = words.rotor_line(rotor, width, stale=False)
    assert line.cell_len == width
    assert line.plain.startswith("▼12 ") and "28.9 N" in line.plain and "65 %" in line.plain


def test_absurd_values_do_not_burst_the_lines() -> None:
    rotor = RotorView(1, "upper", 1e9, 5.4e12, 1.0, 5.6e19, 1e18, 78.4)
    assert words.rotor_line(rotor, 36, stale=False).cell_len <= 40


def test_split_of_an_arm() -> None:
    arm = view_of(heartbeat(), servo()).arms[0]
    assert arm.upper_share is not None
    top = round(100 * arm.upper_share)
    assert words.arm_split(arm).plain == f"{arm.thrust_N:.1f} N  {top} : {100 - top} %"
    assert "--" in words.arm_split(view_of(heartbeat()).arms[0]).plain


def test_head_says_waiting_live_lost_and_armed() -> None:
    assert "waiting for a heartbeat at udpin:0.0.0.0:14550" in words.head(view_of(), 80).plain
    live = words.head(view_of(heartbeat()), 80).plain
    assert "ARMED" in live and "Position" in live and "live" in live and len(live) == 80
    assert "disarmed" in words.head(view_of(heartbeat(armed=False)), 80).plain
    lost = view_of(heartbeat(), now=20.0)
    assert "lost" in words.head(lost, 80).plain
    assert "LINK LOST" in words.notes(lost).plain


def test_notes_tell_why_there_is_no_error() -> None:
    assert "needs the table on board" in words.notes(view_of(heartbeat(), servo())).plain


def test_every_stale_number_carries_a_mark_and_no_fresh_one_does() -> None:
    sent = (heartbeat(), servo(), attitude(), position(), battery(), EscStatus(0, [2381] * 4))

    def panels(view: View) -> str:
        old = words.speeds_old(view)
        texts = [words.balance(view), words.vehicle(view), words.weight_and_split(view)]
        for arm in view.arms:
            texts += [words.arm_body(arm, 46, old), words.arm_split(arm, old)]
            texts.append(words.arm_title(arm, view.escs_stale or old))
        return "\n".join(t.plain for t in texts)

    fresh, lost = panels(view_of(*sent)), panels(view_of(*sent, now=20.0))
    # numbers; rotors' own stand behind their triangle
    numbers = r"(?<![\d▲▼.])[+-]?\d+(?:\.\d+)?(?!\.?\d)"
    assert len(re.findall(numbers, fresh)) > 50 and marks.STALE not in fresh
    assert re.findall(numbers + r"(?!\*)", lost) == []
    assert len(re.findall(numbers, lost)) == len(re.findall(numbers, fresh))
    assert "battery ok*" in lost
    assert "marked *" in words.notes(view_of(*sent, now=20.0)).plain


@pytest.mark.parametrize(("width", "word"), [(36, "MAX"), (60, "at max")])
def test_a_motor_at_its_bound_has_a_mark_and_a_word(width: int, word: str) -> None:
    full = RotorView(6, "lower", 1.0, 5400.0, 1.0, 77.9, 2.1, 77.9, "max")
    line = words.rotor_line(full, width, stale=False)
    assert line.plain.startswith("▼6! ") and word in line.plain and line.cell_len == width
    assert "!" not in words.rotor_line(RotorView(6, "lower", *[0.5] * 5, 77.9), width, False).plain


def test_battery_in_a_word_with_minutes() -> None:
    pack = battery()
    assert words.battery_words(view_of(heartbeat(), pack)).plain == "battery ok"
    pack.time_remaining, pack.charge_state = 250, 3
    said = words.battery_words(view_of(heartbeat(), pack))
    assert said.plain == "CRITICAL, 4 min left" and "bad" in str(said.style) + str(said.spans)
    assert words.battery_words(view_of(heartbeat())).plain == "charge not told"


def test_themes_know_every_style_name_and_none_has_no_colour() -> None:
    names = {*marks.ARMS, marks.UPPER, marks.LOWER, marks.GOOD, marks.BAD, marks.WARN, marks.DIM}
    for palette in PALETTES.values():
        assert set(palette) == names
    text = dress(words.summary(view_of(heartbeat(), servo())), PALETTES["none"])
    assert not any("#" in str(span.style) for span in text.spans)


def test_summary_is_complete_and_plain() -> None:
    text = words.summary(view_of(heartbeat(), servo())).plain
    for part in ("front right", "rear left", "thrust", "SERVO_OUTPUT_RAW", "table on board", "not read yet"):
        assert part in text


def test_braille_draws_a_falling_line() -> None:
    cells = braille([[(0.0, 1.0), (1.0, 0.0)]], 2, 1, (0.0, 1.0), (0.0, 1.0))
    # four columns, four rows, the diagonal: dots 1, 5 in the first cell and 3, 8 in the second
    assert [c for c, _ in cells[0]] == [chr(0x2800 + 0x01 + 0x10), chr(0x2800 + 0x04 + 0x80)]


def test_braille_leaves_gaps_and_clips() -> None:
    points = [(0.0, 0.5), (10.0, 0.5)]
    joined = braille([points], 6, 1, (0.0, 10.0), (0.0, 1.0))
    apart = braille([points], 6, 1, (0.0, 10.0), (0.0, 1.0), gap=5.0)
    assert all(c != " " for c, _ in joined[0])
    assert [c != " " for c, _ in apart[0]] == [True, False, False, False, False, True]
    high = braille([[(5.0, 99.0)], [(50.0, 0.5)]], 6, 2, (0.0, 10.0), (0.0, 1.0))
    assert sum(c != " " for line in high for c, _ in line) == 1
    assert any(c != " " for c, _ in high[0])


@pytest.mark.parametrize("rows", range(2, 60))
@pytest.mark.parametrize(
    ("low", "high"), [(40.0, 60.0), (45.0, 65.0), (30.0, 65.0), (0.0, 100.0), (40.0, 50.0)]
)
def test_numbers_beside_a_plot_are_round_evenly_spaced_and_where_they_belong(
    rows: int, low: float, high: float
) -> None:
    found = ticks(rows, low, high)
    assert found[0] == high and found[rows - 1] == low
    for row, share in found.items():
        assert share % 5.0 == 0.0
        assert abs(high - (high - low) * row / (rows - 1) - share) <= (high - low) / (rows - 1) / 2 + 1e-9
    between = list(found.values())[1:-1]
    assert len(set(np.diff(between))) <= 1
    assert len(found) > 2 or (high - low) / (rows - 1) > 1.0


def test_a_stale_height_leaves_its_source_out_and_fits_80_columns() -> None:
    fresh, old = (view_of(heartbeat(), position(), now=now) for now in (1.0, 60.0))
    line = [words.vehicle(view).plain.splitlines()[-1] for view in (fresh, old)]
    assert line[0].endswith(" m local") and line[1] == "height 3.02* m"


def test_nice_range() -> None:
    assert nice_range([], 10.0, 5.0) == (0.0, 10.0)
    assert nice_range([51.0, 52.0], 10.0, 5.0) == (45.0, 55.0)
    assert nice_range([33.0, 61.0], 10.0, 5.0) == (30.0, 65.0)


def test_history_runs_on_the_vehicles_clock_and_starts_anew_after_a_reboot() -> None:
    history = History(span_s=10.0)
    for k in range(30):
        history = history.extended(view_of(heartbeat(), servo(), attitude(boot_ms=1000 * k)), float(k) / 10)
    assert [p.time_s for p in history.points] == [float(t) for t in range(19, 30)]
    same = history.extended(view_of(heartbeat(), servo(), attitude(boot_ms=29000)), 99.0)
    assert same is history
    rebooted = history.extended(view_of(heartbeat(), servo(), attitude(boot_ms=500)), 99.0)
    assert [p.time_s for p in rebooted.points] == [0.5]


def test_history_takes_nothing_stale() -> None:
    history = History().extended(view_of(heartbeat(), servo(), now=3.9), 3.9)
    assert history.points == ()
    assert "stand still" in split_plot(history, ARMS, Window(), 60, 5).plain


@pytest.mark.parametrize("width", [70, 40, 21])
def test_arms_of_one_split_are_told_apart(width: int) -> None:
    points = tuple(Point(float(t), (0.42,) * 4, (0.45,) * 4) for t in range(60))
    lines = split_plot(History(60.0, points), ARMS, Window(), width, 6).plain.split("\n")
    assert len(lines) == 6 and lines[1].startswith(" 50%") and lines[-1].startswith(" 40%")
    shown = min(4, (width - 4) // 8)
    names = (
        ("front right", "front left", "rear left", "rear right") if width == 70 else ("FR", "FL", "RL", "RR")
    )
    assert [name in lines[0] for name in names] == [k < shown for k in range(4)]
    room = (width - 5 - (shown - 1)) // shown
    for k in range(shown):  # a line of its own for each, all the way
        part = [line[5 + k * (room + 1) :][:room] for line in lines[1:]]
        assert all(any(row[x] != " " for row in part) for x in range(room))


def test_error_over_time_has_four_axes_and_can_be_moved_and_zoomed() -> None:
    points = tuple(Point(float(t), (), (), (0.1 * t, 0.5, -0.5, 0.0)) for t in range(600))
    history = History(600.0, points)
    lines = error_plot(history, Window(60.0), 76, 17).plain.split("\n")
    assert len(lines) == 17 and all(len(line) == 76 for line in lines)
    assert [line.split()[0] for line in lines[:16:4]] == ["thrust", "roll", "pitch", "yaw"]
    assert lines[-1].split() == ["8:59.0", "9:59.0"]
    assert lines[0].split()[1].startswith("+60")
    earlier = Window(60.0).moved(1.0, history)
    assert error_plot(history, earlier, 76, 17).plain.split("\n")[-1].split() == ["7:59.0", "8:59.0"]
    assert Window(60.0).moved(99.0, history).back_s == history.length_s - 60.0
    assert Window(60.0).moved(-1.0, history).back_s == 0.0
    assert Window(60.0).zoomed(0.5).span_s == 30.0 and Window(60.0).zoomed(99.0).span_s == 600.0
    assert "no allocation error" in error_plot(History(), Window(), 76, 17).plain


def test_texts_have_times_and_severities_newest_first() -> None:
    first = mavlink.MAVLink_statustext_message(6, b"Takeoff detected")
    long = [mavlink.MAVLink_statustext_message(4, b"x" * 50, 7, k) for k in range(2)]
    view = view_of(heartbeat(), attitude(boot_ms=61500), first, *long, now=3.0)
    lines = words.said(view, datetime(2026, 1, 1, 12, 0, 2)).plain.split("\n")
    assert lines[0].split() == ["1:01.5", "12:00:00", "warning", "x" * 100]
    assert lines[1].split()[2:] == ["info", "Takeoff", "detected"] and len(lines) == 2
    assert "12:" not in words.said(view, None).plain
    assert words.said(view_of(heartbeat()), None).plain == "no message yet"
