"""A stop of our own: what waited meanwhile is not answered, and nobody counts as lost for it."""

from __future__ import annotations

from typing import Any

import pytest
from case_table import case_table
from live_line import HOVER, Session, mixer_on
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.guard import Timing
from coaxlink.live.stall import Absence
from coaxlink.mavlink.line import MOST_WAITING, read_waiting

PERIOD_S = 0.004


class Rhythm:
    """Demands at 250 Hz to a mixer that may be stopped."""

    def __init__(self) -> None:
        self.session = Session()
        self.session.booted_s = self.session.clock.now - 50.0
        self.mixer = mixer_on(self.session, timing=Timing(), witness=False)
        self.stamp = 50_000_000

    def waiting(self, count: int, period_s: float = PERIOD_S) -> list[bytes]:
        """The next demands."""
        frames = []
        for _ in range(count):
            self.stamp += round(1e6 * period_s)
            message = mavlink.MAVLink_actuator_control_target_message(self.stamp, 0, HOVER)
            frames.append(self.session.frame(message))
        return frames

    def take(self, chunks: list[bytes]) -> list[Any]:
        before = len(self.session.sent)
        self.mixer.take(chunks)
        return self.session.sent[before:]

    def fly(self, count: int) -> int:
        """Demands in their rhythm, awake: how many were answered."""
        answered = 0
        for _ in range(count):
            self.session.clock.sleep(PERIOD_S)
            answered += len(self.take(self.waiting(1)))
        return answered


def test_after_any_stop_the_third_fresh_demand_is_answered_and_none_that_waited() -> None:
    with case_table() as case:
        for stopped_s in (0.3, 3.0, 30.0):
            with case(f"{stopped_s}"):
                rhythm = Rhythm()
                # the first comes before the vehicle's clock is known, two settle
                assert rhythm.fly(200) == 197 and rhythm.mixer.state == "live"
                rhythm.session.clock.sleep(stopped_s)
                # the kernel kept the first quarter of a second of what came, in order
                frames = rhythm.waiting(60)
                rhythm.stamp += round(1e6 * (stopped_s - 60 * PERIOD_S))
                assert rhythm.take(frames) == []
                assert [rhythm.fly(1) for _ in range(4)] == [0, 0, 1, 1]
                assert rhythm.mixer.state == "fading" and rhythm.session.sent[-1].time_usec == rhythm.stamp
                assert rhythm.fly(100) == 100 and rhythm.mixer.state == "live"
                summary = rhythm.mixer.summary()
                assert summary["stalls"] == {"count": 1, "longest_s": pytest.approx(stopped_s, abs=0.01)}
                assert (summary["unanswered"]["superseded"], summary["unanswered"]["stale"]) == (59, 1)
                assert not rhythm.mixer.failed.is_set()


def test_a_demand_that_is_fresh_after_a_stop_counts_though_older_ones_waited() -> None:
    rhythm = Rhythm()
    rhythm.fly(200)
    rhythm.session.clock.sleep(0.2)
    assert rhythm.take(rhythm.waiting(50)) == []  # the newest of them counts, as the first of three
    assert rhythm.fly(2) == 1
    assert rhythm.mixer.summary()["unanswered"]["superseded"] == 49


def test_a_silence_counts_only_while_somebody_was_there_to_hear_it() -> None:
    absence = Absence(10.0, 0.2)
    assert absence.silent_s(10.2, 10.1) == pytest.approx(0.1)
    assert absence.silent_s(13.5, 10.1) == 0.0  # stopped for 3.3 s
    assert absence.slept_s == pytest.approx(3.3)
    now = 13.5
    for _ in range(40):
        now += 0.2
        silent = absence.silent_s(now, 10.1)
        assert absence.slept_s == 0.0
    assert silent == pytest.approx(8.0)  # awake all along: the vehicle is what is missing
    assert absence.silent_s(now + 0.2, now) == pytest.approx(0.2)


class Queue:
    def __init__(self, waiting: int) -> None:
        self.waiting, self.timeouts = [(b"%d" % k, "there") for k in range(waiting)], []

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        self.timeouts.append(timeout_s)
        return self.waiting.pop(0) if self.waiting else (b"", None)


def test_all_that_waits_is_read_in_order_and_only_the_first_is_waited_for() -> None:
    line: Any = Queue(3)
    assert [data for data, _ in read_waiting(line, 0.05)] == [b"0", b"1", b"2"]
    assert line.timeouts == [0.05, 0.0, 0.0, 0.0]
    assert read_waiting(line, 0.05) == []
    assert len(read_waiting(Queue(2 * MOST_WAITING), 0.05)) == MOST_WAITING  # type: ignore[arg-type]
