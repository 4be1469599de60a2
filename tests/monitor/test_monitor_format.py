"""Words, bars and plots: what a reader sees for given values."""

from __future__ import annotations

import math
from typing import Any

import pytest
from monitor_messages import Sender, attitude, heartbeat, servo

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.monitor import format as words
from coaxlink.monitor.history import History, SplitPoint
from coaxlink.monitor.plot import braille, nice_range
from coaxlink.monitor.readings import Collector
from coaxlink.monitor.state import RotorView, View, observe
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle

AIRFRAME = load_airframe(files.example("x8_paper.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))


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
    assert words.number(value, digits, signed) == text


def test_bar_lengths() -> None:
    assert words.bar(0.5, 8, "").plain == "████····"
    assert words.bar(0.5 + 1 / 64, 8, "").plain == "████▏···"
    assert words.bar(7.0, 4, "").plain == "████"
    assert words.bar(-1.0, 4, "").plain == "····"
    assert words.bar(None, 4, "").plain == "····"


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


def test_notes_tell_why_there_is_no_error_and_stale_is_said() -> None:
    assert "needs the table on board" in words.notes(view_of(heartbeat(), servo())).plain
    view = view_of(heartbeat(), servo(), attitude(), now=3.9)
    assert "stale roll" in words.vehicle(view).plain
    assert "stale SERVO_OUTPUT_RAW" in words.vehicle(view).plain


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
    assert "stand still" in words.split_plot(history, 60, 5).plain


def test_plot_shows_range_and_every_row_fits() -> None:
    points = tuple(SplitPoint(float(t), (0.40 + 0.001 * t, None)) for t in range(60))
    lines = words.split_plot(History(60.0, points), 70, 6).plain.split("\n")
    assert len(lines) == 6 and all(len(line) == 70 for line in lines)
    assert lines[0].startswith(" 50%") and lines[-1].startswith(" 40%")
