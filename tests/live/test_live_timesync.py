"""TIMESYNC: what is asked is answered, the vehicle's clock is found, nonsense changes nothing."""

from __future__ import annotations

from typing import Any

import pytest
from live_line import Session
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.timesync import TimeSync


class Line(Session):
    def __init__(self) -> None:
        super().__init__()
        self.reported: list[tuple[int, int]] = []

    def send(self, message: Any) -> None:
        self.reported.append((message.tc1, message.ts1))

    @property
    def now_ns(self) -> int:
        return round(1e9 * self.clock.now)

    def answer(self, tc1: int, ts1: int) -> None:
        self.hear(mavlink.MAVLink_timesync_message(tc1, ts1))


def test_a_request_is_answered_with_our_time_and_its_own() -> None:
    line = Line()
    TimeSync(line)  # type: ignore[arg-type]
    line.answer(0, 12345)
    assert line.reported == [(line.now_ns, 12345)]


def ask(line: Line, sync: TimeSync, ahead_ns: int, there: float, back: float) -> None:
    sync.tick()
    sent_at = line.reported[-1][1]
    line.clock.sleep(there)
    vehicle = line.now_ns + ahead_ns
    line.clock.sleep(back)
    line.answer(vehicle, sent_at)
    line.answer(vehicle + 10**9, sent_at)  # twice: not believed
    line.clock.sleep(1.0)


def test_the_quickest_ways_there_and_back_bound_the_vehicles_clock() -> None:
    line = Line()
    sync = TimeSync(line)  # type: ignore[arg-type]
    ahead = 77_000_000_000  # of ours
    assert sync.age_s(1, 1.0) is None and sync.oldest_s(1, 1.0) is None
    for there, back in ((0.003, 0.001), (0.001, 2.0), (0.020, 0.009)):
        ask(line, sync, ahead, there, back)
    stamp_us = (line.now_ns + ahead) // 1000
    drift = 4e-4  # of four seconds
    assert sync.round_trip_s == pytest.approx(0.004)
    assert sync.age_s(stamp_us, line.clock.now + 0.015) == pytest.approx(0.015, abs=drift)
    oldest = sync.oldest_s(stamp_us, line.clock.now + 0.015)
    assert oldest == pytest.approx(0.015 + 0.001, abs=drift) and oldest > 0.016
    line.answer(1, 999)  # not ours
    sync.tick()
    line.clock.sleep(15.0)
    line.answer(1, line.reported[-1][1])  # too late
    assert sync.jumps == 0
    sync.close()
    assert not line.listeners


def test_an_answer_that_contradicts_the_clock_is_another_clock() -> None:
    line = Line()
    sync = TimeSync(line)  # type: ignore[arg-type]
    for ahead in (77_000_000_000, -900_000_000_000, -896_000_000_000):
        ask(line, sync, ahead, 0.001, 0.001)
        stamp_us = (line.now_ns + ahead) // 1000
        assert sync.age_s(stamp_us, line.clock.now) == pytest.approx(0.0, abs=2e-4)
    assert sync.jumps == 2


def test_it_asks_five_times_a_second() -> None:
    line = Line()
    sync = TimeSync(line)  # type: ignore[arg-type]
    for _ in range(500):
        sync.tick()
        line.clock.sleep(0.01)
    assert len(line.reported) in (24, 25)
