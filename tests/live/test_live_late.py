"""Late demands: none older than 20 ms is answered, whatever the line does; a jumped clock is not late.

A vehicle and a line in memory: its demands, its answers to TIMESYNC and our questions each have a way of
their own, and what was answered is judged by the vehicle's true clock.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest
from case_table import case_table
from live_line import Session, mixer_on
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer

PERIOD_S = 0.004
OLDEST_S = Timing.oldest_s
FLOWN_S = 4.0
Delay = Callable[[float], float]  # seconds at a time from the start on


@dataclass
class Outcome:
    """Of the demands that arrived."""

    came: int = 0
    fresh: int = 0  # no older than 20 ms on arrival
    answered: int = 0
    oldest_s: float = 0.0  # of those answered


class Vehicle(Session):
    """Sends demands at 250 Hz for `FLOWN_S`, over a line with these delays."""

    def __init__(
        self, demands: Delay, answers: Delay, questions: Delay, *, syncs: bool = True, waits: bool = True
    ) -> None:
        super().__init__()
        self.start, self.syncs = self.clock.now, syncs
        self.demands, self.answers, self.questions = demands, answers, questions
        self.jump_s = 0.0
        self.outcome = Outcome()
        timing = Timing(sync_s=Timing.sync_s if waits else 0.0)
        self.mixer: LiveMixer = mixer_on(self, "standard", timing=timing, witness=False)
        self._due = 0.0  # first in, first out
        for k in range(round(FLOWN_S / PERIOD_S)):
            self.clock.later(k * PERIOD_S, self._say_demand)

    @property
    def vehicle_s(self) -> float:
        return self.clock.now - self.start + 900.0 + self.jump_s

    def send(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC" or message.tc1 or not self.syncs:
            return

        def there() -> None:
            answer = mavlink.MAVLink_timesync_message(round(self.vehicle_s * 1e9), message.ts1)
            self.clock.later(self.answers(self.clock.now - self.start), lambda: self.hear(answer))

        self.clock.later(self.questions(self.clock.now - self.start), there)

    def _say_demand(self) -> None:
        reported, stamp = self.clock.now, round(self.vehicle_s * 1e6)
        self._due = max(self._due, reported + self.demands(reported - self.start))

        def here() -> None:
            o, cycles = self.outcome, self.mixer.core.counters.cycles
            self.demand(stamp)
            age = self.clock.now - reported
            o.came += 1
            o.fresh += age <= OLDEST_S
            if self.mixer.core.counters.cycles > cycles:
                o.answered += 1
                o.oldest_s = max(o.oldest_s, age)

        self.clock.later(self._due - reported, here)

    def fly(self) -> Outcome:
        """Until the last demand came."""
        self.clock.sleep(FLOWN_S + 2.5)
        return self.outcome


def steady(seconds: float) -> Delay:
    return lambda t: seconds


def growing(seconds: float) -> Delay:
    return lambda t: seconds * t / FLOWN_S


def bursts(seconds: float) -> Delay:
    """All of so long comes at once, at the end of it."""
    return lambda t: (-t) % seconds if seconds else 0.0


def begins(seconds: float) -> Delay:
    return lambda t: seconds if t > FLOWN_S / 2 else 0.0


def jitters(seconds: float) -> Delay:
    draw = random.Random(1)
    return lambda t: draw.uniform(0.0, seconds)


SHAPES = {"steady": steady, "growing": growing, "in bursts": bursts, "half-way": begins, "jitter": jitters}
DELAYS_MS = (0, 10, 21, 100, 2000)
QUICK: Delay = steady(0.0005)
# what else is as late as the demands
LINES: dict[str, Callable[[Delay], tuple[Delay, Delay, Delay]]] = {
    "demands": lambda late: (late, QUICK, QUICK),
    "all that it says": lambda late: (late, late, QUICK),
    "both ways": lambda late: (late, late, late),
}


def flown(shape: str, line: str, delay_ms: float, **options: bool) -> Outcome:
    return Vehicle(*LINES[line](SHAPES[shape](delay_ms / 1000)), **options).fly()


@pytest.mark.slow
def test_no_demand_older_than_20_ms_is_answered_and_a_younger_one_is() -> None:
    with case_table() as case:
        for shape in SHAPES:
            for line in LINES:
                for delay in DELAYS_MS:
                    with case(f"{shape}, {line}, {delay} ms"):
                        o = flown(shape, line, delay)
                        assert o.came == round(FLOWN_S / PERIOD_S)
                        assert o.oldest_s <= OLDEST_S
                        if delay <= 15 and line != "both ways":
                            assert o.answered >= o.came - 10


@pytest.mark.slow
def test_without_timesync_no_demand_20_ms_later_than_the_quickest_is_answered() -> None:
    with case_table() as case:
        for shape in ("growing", "in bursts", "half-way"):
            for delay in DELAYS_MS:
                with case(f"{shape}, {delay} ms"):
                    o = flown(shape, "demands", delay, syncs=False, waits=False)
                    assert o.oldest_s <= OLDEST_S + 1e-3  # and the drift of seconds
                    assert delay > 15 or o.answered >= o.came - 10


def test_a_silent_timesync_is_waited_for() -> None:
    v = Vehicle(QUICK, QUICK, QUICK, syncs=False)
    assert v.fly().answered == 0 and v.mixer.summary()["unanswered"]["settling"] == v.outcome.came


def test_a_clock_that_jumps_is_believed_by_timesync() -> None:
    with case_table() as case:
        for jump_s in (3600.0, 0.5, -0.5, -30.0, -899.0):
            with case(f"{jump_s}"):
                v = Vehicle(QUICK, QUICK, QUICK)
                v.clock.later(2.0, partial(setattr, v, "jump_s", jump_s))
                o = v.fly()
                assert o.came - o.answered <= 3 + 2 and v.mixer.summary()["hand_overs"] == 0
