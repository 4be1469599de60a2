"""How many commands never arrived: by the bridge's count, by the outputs, by questions on the same way."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest
from case_table import case_table
from hypothesis import given
from hypothesis import strategies as st
from live_line import Session
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live import arrival
from coaxlink.live.arrival import Arrival, Count
from coaxlink.live.timesync import TimeSync
from coaxlink.live.witness import Witness


@given(st.lists(st.integers(0, 500), max_size=60), st.integers(0, 65535))
def test_a_count_that_wraps_is_added_up(steps: list[int], first: int) -> None:
    count = Count(65536)
    value = first
    count.hear(float(value))
    for step in steps:
        value = (value + step) % 65536
        count.hear(float(value))
    assert count.total == sum(steps)
    assert count.moved is any(steps)


def test_a_count_that_begins_anew_or_is_none_adds_nothing() -> None:
    count = Count(65536)
    for value in (100.0, 140.0, 0.0, 30.0, float("nan"), -1.0, 1e30, 30.5, 32.0):
        count.hear(value)
    assert count.total == 40 + 30 + 2


def test_what_the_bridge_counted_is_what_arrived() -> None:
    with case_table() as case:
        for lost in (0.0, 0.05, 0.8):
            with case(f"{lost}"):
                draw, taken, arrived = random.Random(3), Count(65536), 0
                taken.hear(0.0)
                for _ in range(5000):
                    arrived += draw.random() >= lost
                    taken.hear(float(arrived))
                found = arrival.by_bridge(5000, taken, True)
                assert found is not None
                assert abs(found.never - (5000 - arrived)) <= arrival.IN_FLIGHT
                assert found.noteworthy is (lost > 0.1)


def test_an_older_script_that_follows_but_does_not_count_says_nothing() -> None:
    taken = Count(65536)
    for _ in range(100):
        taken.hear(0.0)
    assert arrival.by_bridge(1000, taken, True) is None
    alone = arrival.by_bridge(1000, taken, False)  # it never followed us: none of them came
    assert alone is not None
    assert alone.share == pytest.approx(1.0, abs=0.01)


class Line(Session):
    """A vehicle that answers TIMESYNC, and a line that loses some of it on the way there and back."""

    def __init__(self, lost_there: float, lost_back: float) -> None:
        super().__init__()
        self._draw = random.Random(11)
        self._there, self._back = lost_there, lost_back

    def send(self, message: Any) -> None:
        if self._draw.random() >= self._there and self._draw.random() >= self._back:
            self.hear(mavlink.MAVLink_timesync_message(5, message.ts1))


def test_questions_tell_the_loss_on_the_way_there_alone() -> None:
    for there, back in ((0.0, 0.0), (0.0, 0.4), (0.8, 0.0), (0.3, 0.3)):
        line = Line(there, back)
        sync = TimeSync(line)  # type: ignore[arg-type]
        for _ in range(10_000):
            line.clock.sleep(0.2001)
            sync.tick(True)
        found = arrival.by_questions(10_000, sync.requested, sync.answered, back)
        assert found.share == pytest.approx(there, abs=0.02)
        assert found.noteworthy is (there > 0.1)


def test_questions_of_a_time_when_nobody_was_flown_do_not_count() -> None:
    line = Line(1.0, 0.0)
    sync = TimeSync(line)  # type: ignore[arg-type]
    for _ in range(100):
        line.clock.sleep(0.3)
        sync.tick(False)
    assert (sync.requested, sync.answered) == (0, 0)


def test_of_two_losses_the_larger_is_told_and_a_few_samples_are_none() -> None:
    def of(reports: int, strangers: int, requested: int, answered: int) -> Any:
        witness: Any = SimpleNamespace(reports=reports, strangers=strangers)
        sync: Any = SimpleNamespace(requested=requested, answered=answered)
        return arrival.by_vehicle(1000, witness, sync, 0.0)

    assert (of(100, 0, 100, 20).never, of(100, 0, 100, 20).by) == (800, "timesync")
    assert (of(100, 60, 100, 100).never, of(100, 60, 100, 100).by) == (600, "outputs")
    assert of(5, 5, 5, 1) is None
    assert of(100, 0, 100, 0).by == "outputs"  # one that answers no TIMESYNC at all
    assert not Arrival(1000, 30, 4, "outputs").noteworthy  # 13 % of 30 may be chance
    assert Arrival(1000, 1000, 130, "outputs").noteworthy


def test_reports_that_are_not_ours_are_counted() -> None:
    witness, ours, others = Witness(8), [0.5] * 8, [1000.0 + 600.0] * 8
    for n in range(200):
        witness.sent(0.004 * n, ours)
        if n >= 100 and n % 5 == 0:
            witness.reported(0.004 * n, others if n >= 150 else [1500.0] * 8)
    assert (witness.reports, witness.strangers) == (20, 10)
