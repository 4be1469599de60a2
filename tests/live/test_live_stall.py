"""A stop of our own: what waited meanwhile is not answered, and nobody counts as lost for it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink
from test_live_mixer import CRM, HOVER, X8, ScriptedSession

from coaxlink.live import mixer as mixing
from coaxlink.live.stall import Absence, backlog
from coaxlink.vehicle import Vehicle

PERIOD_US = 4000


class Clock:
    """The loop's own clock and its line, both in the test's hands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.waiting = 100.0, 0
        fake = SimpleNamespace(
            perf_counter=lambda: self.now, monotonic=lambda: self.now, sleep=lambda s: None
        )
        monkeypatch.setattr(mixing, "time", fake)
        self.session = ScriptedSession()
        self.mixer = mixing.LiveMixer(
            self.session, Vehicle(X8, CRM), "coaxial", own_curve=1.0, witness=False  # type: ignore[arg-type]
        )  # fmt: skip
        self.mixer.start()
        self.mixer.inbox.line = SimpleNamespace(readable=lambda number: self.waiting > 0)  # type: ignore[assignment]
        self.stamp = 50_000_000

    def demand(self, stamp: int) -> list[Any]:
        """Hear one demand; what was answered."""
        before = len(self.session.sent)
        self.session.hear(mavlink.MAVLink_actuator_control_target_message(stamp, 0, HOVER))
        return self.session.sent[before:]

    def fly(self, count: int) -> list[bool]:
        """Demands in their rhythm, awake: which were answered."""
        answered = []
        for _ in range(count):
            self.now += PERIOD_US / 1e6
            self.stamp += PERIOD_US
            answered.append(bool(self.demand(self.stamp)))
        return answered


@pytest.mark.parametrize("stopped_s", [0.3, 3.0, 30.0])
def test_after_any_stop_the_third_fresh_demand_is_answered_and_none_that_waited(
    monkeypatch: pytest.MonkeyPatch, stopped_s: float
) -> None:
    clock = Clock(monkeypatch)
    assert sum(clock.fly(200)) == 198
    assert clock.mixer.state == "live"
    clock.now += stopped_s
    # the kernel kept the first quarter of a second of what came, in order
    stamps = [clock.stamp + PERIOD_US * (n + 1) for n in range(60)]
    for n, stamp in enumerate(stamps):
        clock.waiting = len(stamps) - 1 - n
        clock.now += 0.0002
        assert clock.demand(stamp) == []
    clock.stamp += round(stopped_s * 1e6)
    # one more where the gap looks like another clock
    assert clock.fly(4)[-1]
    assert clock.mixer.state == "fading"
    assert clock.session.sent[-1].time_usec == clock.stamp
    assert sum(clock.fly(100)) == 100
    assert clock.mixer.state == "live"
    assert not clock.mixer.failed.is_set()
    summary = clock.mixer.summary()
    assert summary["stalls"]["count"] == 1
    assert summary["stalls"]["longest_s"] == pytest.approx(stopped_s, abs=0.01)
    assert summary["unanswered"]["superseded"] >= 59


def test_a_demand_that_is_fresh_after_a_stop_counts_even_if_more_waits_behind_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock(monkeypatch)
    clock.fly(200)
    clock.now += 0.2
    clock.stamp += 200_000
    clock.waiting = 3  # a line that is never empty
    answers = []
    for _ in range(8):
        clock.now += 0.0045  # each waits out the patience with newer ones
        clock.stamp += 4500
        answers.append(bool(clock.demand(clock.stamp)))
    assert any(answers)
    assert clock.mixer.summary()["unanswered"]["superseded"] <= 5


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


def test_of_a_backlog_the_newest_demand_comes_first_and_nothing_else_is_lost() -> None:
    ours, other = ("127.0.0.1", 1), ("127.0.0.1", 2)
    waiting = [
        (b"d1", ours), (b"beat", ours), (b"d2", other), (b"d3", ours), (b"attitude", ours), (b"d4", ours),
        (b"imu", ours),
    ]  # fmt: skip
    came = iter(waiting)
    line = SimpleNamespace(read=lambda timeout_s: next(came, (b"", None)))

    def is_demand(data: bytes) -> bool:
        return data.startswith(b"d")

    found, left_out = backlog(line, ours, is_demand)  # type: ignore[arg-type]
    assert found[0] == (b"d4", ours)
    gone = [(b"d1", ours), (b"d3", ours), (b"d4", ours)]
    assert sorted(found[1:]) == sorted(w for w in waiting if w not in gone)
    assert left_out == 2
    assert backlog(line, ours, is_demand) == ([], 0)  # type: ignore[arg-type]
