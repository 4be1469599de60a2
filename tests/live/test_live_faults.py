"""The fault matrix of docs/live.md, flown on the stand-in in memory and judged by the world's own account.

A process that is stopped or killed is in test_live_real.py, a second companion at ArduPilot's bridge in
test_live_bridge.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from live_flight import HEIGHT_M, Companion, Flight, demand
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from sim.px4.autopilot import Mode
from sim.px4.cascade import Goal

SILENT_S = 0.080  # coaxlink's last word after the last good demand
AUTOPILOT_S = 0.100  # its own timeout
GRAIN_S = 0.012  # ticks of the world and of the loop

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight()


class Live:
    """A companion that mixes, and the vehicle under it."""

    def __init__(self, flight: Flight, law: Any = "exact", component: int = 191) -> None:
        self.flight = flight
        self.companion = Companion(flight, component)
        self.line = self.companion.line
        self.mixer: LiveMixer = self.companion.mix(law)

    def own_after(self, since_s: float, seconds: float = 0.5) -> float:
        """Fly on; when the autopilot's own mixer had the vehicle for good."""
        self.flight.fly(seconds)
        handed = self.flight.own_since(since_s)
        assert handed is not None
        return handed

    def taken_again_after(self) -> float:
        took = self.flight.fly(1.0, until=lambda: self.flight.driven)
        self.companion.until_live(self.mixer)
        return took

    def ends_well(self) -> None:
        self.companion.session.tap = None
        self.flight.stays_up()


@pytest.fixture
def live(flight: Flight) -> Iterator[Live]:
    flight.autopilot.go_to((0.0, 0.0, -HEIGHT_M), 0.0)
    flight.fly(2.0)
    one = Live(flight)
    one.companion.until_live(one.mixer)
    yield one
    one.companion.close()
    flight.fly(0.2)


def with_controls(values: list[float]) -> Any:
    return lambda message: demand(message.time_usec, values + [0.0] * 4)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda message: None, id="demand stops"),
        pytest.param(with_controls([math.nan, 0.0, 0.0, 0.3]), id="demand turns NaN"),
        pytest.param(with_controls([0.0, math.inf, 0.0, 0.3]), id="demand turns infinite"),
        pytest.param(with_controls([1e9, -1e30, 0.0, 0.3]), id="demand turns absurd"),
    ],
)
def test_without_a_sane_demand_the_vehicle_is_handed_back_and_taken_again(live: Live, change: Any) -> None:
    before = live.mixer.summary()["hand_overs"]
    live.line.change = change
    assert SILENT_S < live.own_after(live.flight.clock.now) < SILENT_S + AUTOPILOT_S + GRAIN_S
    assert live.mixer.state == "silent"
    # the law's lower rotors turn faster than its upper ones, the own mixer's alike: the outputs do not jump
    u = np.array([row.commands for row in live.flight.rows])
    step = np.abs(u[-1] - u[0]).max()
    assert step > 0.05 and np.abs(np.diff(u, axis=0)).max() < 0.75 * step
    live.line.change = None
    assert live.taken_again_after() < 0.02
    assert live.mixer.summary()["hand_overs"] == before + 1
    live.ends_well()


def test_a_link_that_dies_and_returns(live: Live) -> None:
    live.line.dead = True
    assert live.own_after(live.flight.clock.now) < AUTOPILOT_S + GRAIN_S
    assert live.mixer.state == "silent"
    live.line.dead = False
    assert live.taken_again_after() < 0.02
    live.ends_well()


def test_a_demand_out_of_reach_gets_bounded_outputs_and_is_owned_up_to(live: Live) -> None:
    left = iter(range(8))

    def reach(message: Any) -> Any:
        out = demand(message.time_usec, [0.0, 0.0, 1.0, 1.0] + [0.0] * 4)
        return out if next(left, None) is not None else message

    live.line.change = reach
    live.flight.fly(0.3)
    summary = live.mixer.summary()
    assert live.mixer.state == "live"
    assert max(summary["allocation_error"]["max"]) > 1.0 and summary["axes_given_up"] == 8
    live.ends_well()


@pytest.mark.parametrize("jump_s", [3600.0, -2.0, -30.0])
def test_the_vehicles_clock_jumps(live: Live, jump_s: float) -> None:
    live.line.clock_us = round(jump_s * 1e6)
    live.flight.fly(0.4)
    assert all(row.driven for row in live.flight.rows) and live.mixer.state == "live"
    left = live.mixer.summary()["unanswered"]
    assert 1 <= left["clock_jumps"] + left["stale"] <= 3  # until TIMESYNC, asked at once, has the new clock
    live.ends_well()


def test_a_single_stray_stamp_is_not_answered_and_the_right_ones_still_are(live: Live) -> None:
    stray = iter([2**63, 17])
    live.line.change = lambda m: demand(next(stray, m.time_usec), list(m.controls))
    before = live.mixer.core.counters.cycles
    live.flight.fly(0.4)
    assert all(row.driven for row in live.flight.rows) and live.mixer.state == "live"
    assert live.mixer.core.counters.cycles - before == 98
    live.ends_well()


def test_our_own_wall_clock_jumps(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() - 86400.0)
    live.flight.fly(0.3)
    assert all(row.driven for row in live.flight.rows) and live.mixer.state == "live"


def test_a_law_that_fails_in_flight(live: Live) -> None:
    class Broken:
        name, dropped = "broken", ()

        def speeds(self, wrench: Any) -> Any:
            raise FloatingPointError("singular")

    live.mixer.core.law = Broken()
    assert live.own_after(live.flight.clock.now) < AUTOPILOT_S + GRAIN_S
    assert live.mixer.failed.is_set()
    live.flight.stays_up()


def test_anothers_motor_commands_on_the_line(live: Live) -> None:
    rival = mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8)
    frame = bytes(rival.pack(mavlink.MAVLink(None, 1, 192)))
    live.flight.net.send(frame, live.flight.addresses[0], live.companion.address)
    assert live.own_after(live.flight.clock.now) < AUTOPILOT_S + GRAIN_S
    assert isinstance(live.mixer.error, SafetyRefusal) and "another companion" in str(live.mixer.error)
    live.flight.stays_up()


@pytest.mark.parametrize("newcomer_last", [False, True])
def test_of_two_companions_the_one_whose_words_are_overridden_lets_go_and_says_why(
    live: Live, newcomer_last: bool
) -> None:
    flight = live.flight
    live.line.late_s = 0.0 if newcomer_last else 0.001  # of two answers to a demand the last one counts
    flight.fly(0.8)  # long enough for the first to have seen its outputs on the motors
    assert live.mixer.summary()["outputs_confirmed"]
    second = Live(flight, "standard", component=192)
    gone, stays = (live, second) if newcomer_last else (second, live)
    took = flight.fly(4.0, until=gone.mixer.failed.is_set)
    assert took < 3.0 and "another companion" in str(gone.mixer.error)
    flight.fly(0.3)
    assert flight.driven and not stays.mixer.failed.is_set()
    second.companion.close()
    live.ends_well()


def test_nothing_from_another_address_is_answered_or_stops_it(live: Live) -> None:
    """A hundred times a second, under the vehicle's own ids: heartbeats, demands, motor commands, junk."""
    flight, heard = live.flight, []
    forger = flight.net.address()
    flight.net.bind(forger, lambda data, source: heard.append(data))
    packer = mavlink.MAVLink(None, 1, 1)
    junk = [
        mavlink.MAVLink_heartbeat_message(14, 12, 0, 0, 4, 3),
        demand(10**9, [0.0, 0.0, 0.0, 0.9] + [0.0] * 4),
        mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8),
    ]
    for _ in range(200):
        for data in [*(bytes(m.pack(packer)) for m in junk), b"\xfd\xff\0"]:
            flight.net.send(data, forger, live.companion.address)
        flight.fly(0.01)
    assert all(row.driven for row in flight.rows) and not live.mixer.failed.is_set()
    assert live.mixer.summary()["not_believed"] >= 600
    parser = mavlink.MAVLink(None)
    reported = {m.get_type() for data in heard for m in parser.parse_buffer(data) or []}
    assert reported == {"COMMAND_LONG"}  # it was asked who it is, and got no motor command
    live.ends_well()


def test_stopped_on_purpose_it_fades_to_the_autopilots_own_mixer(live: Live) -> None:
    live.mixer.stop()
    assert live.mixer.state == "silent" and live.companion.session.tap is None
    live.flight.fly(0.2)
    assert not live.flight.driven
    live.flight.stays_up()


def test_what_the_rotors_deliver_is_what_the_autopilot_asked_for() -> None:
    """Hover and a part of the paper's circle, motors without lag: desired against the world's own rotors."""
    flight = Flight(airframe="x8_paper.toml")
    a, companion = flight.autopilot, Companion(flight)
    vehicle = a.plant.vehicle
    live = companion.mix("exact", timing=Timing(hold_after_s=1.0, ramp_after_s=2.0))
    companion.until_live(live)
    errors = []
    for k in range(1000):
        angle = 2 * math.pi * 0.1 * k * 0.004
        where, speed = (2 * math.cos(angle), 2 * math.sin(angle), -HEIGHT_M), 2 * 2 * math.pi * 0.1
        how_fast = (-speed * math.sin(angle), speed * math.cos(angle), 0.0)
        a.offboard(Goal(where, how_fast, (0.0, 0.0, 0.0), 0.0))
        if k == 0:
            a.set_mode(Mode.OFFBOARD)
        asked = a.demand
        flight.fly(0.004)
        force = a.plant.thrust[:, None] * vehicle.axis
        moment = np.cross(vehicle.position_m, force) - (vehicle.spin * a.plant.torque)[:, None] * vehicle.axis
        got = np.concatenate([[-force[:, 2].sum()], moment.sum(axis=0)])
        errors.append(got - live.core.scale.wrench([asked.roll, asked.pitch, asked.yaw, asked.thrust]))
    mean = np.abs(errors[50:]).mean(axis=0)
    assert live.error is None
    assert mean[0] < 0.1 and mean[1:].max() < 0.012  # outputs in steps of 1/1000 alone make 0.0088
