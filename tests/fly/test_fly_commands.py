"""A vehicle that gives the plan up is noticed: its errors would be read as those of a mixer."""

from contextlib import contextmanager
from queue import SimpleQueue
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.fly.commands import PlanAbandoned, Vehicle
from coaxlink.fly.trajectory import Hold, Plan

OFFBOARD, HOLD = 6 << 16, 4 << 16 | 3 << 24


class Session:
    """A PX4 whose clock runs 20 ms a position, and which holds from `gives_up_s` on."""

    address = "nowhere"
    armed = True
    identity = SimpleNamespace(is_ardupilot=False, system=1, component=1)

    def __init__(self, gives_up_s):
        self.now_ms, self.gives_up_ms, self.sent = 0, 1e3 * gives_up_s, 0

    @contextmanager
    def listen(self, _):
        yield SimpleQueue()

    def take(self, *_):
        self.now_ms += 20
        return mavlink.MAVLink_local_position_ned_message(self.now_ms, 0, 0, -3, 0, 0, 0)

    def command(self, *_):
        return mavlink.MAV_RESULT_ACCEPTED

    def send(self, _):
        self.sent += 1

    def latest(self, _):
        mode = HOLD if self.now_ms < 500 or self.now_ms > self.gives_up_ms else OFFBOARD
        return mavlink.MAVLink_heartbeat_message(2, 12, 0, mode, 4, 3)


PLAN = Plan((Hold("hover", (0.0, 0.0, -3.0), 4.0),))


def test_a_plan_is_flown_to_its_end():
    session = Session(60.0)
    track = Vehicle(session).follow(PLAN)
    assert len(track.time_s) > 190
    assert session.sent >= len(track.time_s)


def test_a_vehicle_that_leaves_the_mode_ends_the_plan():
    with pytest.raises(PlanAbandoned, match="2 of 4 s"):
        Vehicle(Session(2.5)).follow(PLAN)
