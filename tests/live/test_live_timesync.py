"""TIMESYNC: what is asked is answered, the vehicle's clock is found, nonsense changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.timesync import TimeSync


class Line:
    def __init__(self) -> None:
        self.now, self.sent = 5_000_000_000, []  # type: ignore[var-annotated]
        self.callback: Callable[[Any], None] | None = None

    def subscribe(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        self.callback = callback

        def leave() -> None:
            self.callback = None

        return leave

    def send(self, message: Any) -> None:
        self.sent.append((message.tc1, message.ts1))

    def hear(self, tc1: int, ts1: int) -> None:
        assert self.callback is not None
        self.callback(mavlink.MAVLink_timesync_message(tc1, ts1))


@pytest.fixture
def line() -> Line:
    return Line()


def test_a_request_is_answered_with_our_time_and_its_own(line: Line) -> None:
    TimeSync(line, lambda: line.now)  # type: ignore[arg-type]
    line.hear(0, 12345)
    assert line.sent == [(5_000_000_000, 12345)]


def test_the_vehicles_clock_is_the_one_of_the_shortest_round_trip(line: Line) -> None:
    sync = TimeSync(line, lambda: line.now)  # type: ignore[arg-type]
    ahead = 77_000_000_000  # of ours
    assert sync.age_s(1, 1.0) is None
    for there, back in ((3_000_000, 9_000_000), (1_000_000, 1_000_000), (20_000_000, 1_000_000)):
        sync.tick()
        sent_at = line.now
        assert line.sent[-1] == (0, sent_at)
        line.now += there
        vehicle = line.now + ahead
        line.now += back
        line.hear(vehicle, sent_at)
        line.hear(vehicle + 10**9, sent_at)  # twice: not believed
        line.now += 1_000_000_000
    assert sync.round_trip_s == pytest.approx(0.002)
    stamp_us = (line.now + ahead) // 1000
    assert sync.age_s(stamp_us, line.now / 1e9 + 0.015) == pytest.approx(0.015, abs=1e-6)
    line.hear(1, 999)  # not ours
    sync.tick()
    line.now += 5_000_000_000
    line.hear(1, line.sent[-1][1])  # too late
    assert sync.round_trip_s == pytest.approx(0.002)
    sync.close()
    assert line.callback is None


def test_it_asks_five_times_a_second(line: Line) -> None:
    sync = TimeSync(line, lambda: line.now)  # type: ignore[arg-type]
    for _ in range(500):
        sync.tick()
        line.now += 10_000_000
    assert len(line.sent) == 25
