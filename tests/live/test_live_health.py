"""Rotors' health beside the live mixer, told the messages of a simulated flight under the exact law."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.files import example
from coaxlink.health.sequential import Suspicion, Verdict
from coaxlink.live.guard import LIVE, RAMP
from coaxlink.live.health_watch import WAITING, HealthWatch
from coaxlink.live.in_air import Call, InAir, weakened
from coaxlink.mixer import make_law
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

FRAME, ROTORS = Path(example("x8_demo.toml")), Path(example("rotor_paper.toml"))
ONSETS = {3: 12.0, 8: 19.0}


@pytest.fixture(scope="module")
def flight():
    vehicle = load_vehicle(FRAME, ROTORS)
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)
    weak = [HiddenEffect("degraded_rotor", 0.12, at, {"rotor": float(n)}) for n, at in ONSETS.items()]
    return vehicle, fly_quick(made, FlightWorld(tuple(weak), 4, "wander", 19.0), 8)[1]


class Line:
    """A session that only hears and keeps what is sent."""

    def __init__(self):
        self.sent, self.callbacks, self.requested = [], [], []

    def subscribe(self, callback):
        self.callbacks.append(callback)
        return lambda: self.callbacks.remove(callback)

    def latest(self, name):
        return None

    def request_stream(self, number, rate_hz):
        self.requested.append(number)
        return True

    def send(self, message):
        self.sent.append(message)


def mixer(vehicle, dry_run=False):
    core = SimpleNamespace(vehicle=vehicle, count=8, last_us=None, sent=[0.0] * 8)
    return SimpleNamespace(session=Line(), core=core, guard=SimpleNamespace(state=LIVE), dry_run=dry_run)


def fly(live, watch, log, state=LIVE):
    """Everything the autopilot says, at 50 Hz; never faster than the watch fetches it."""
    live.guard.state = state
    say = [
        mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3),
        mavlink.MAVLink_extended_sys_state_message(0, 2),
    ]
    for message in say:
        for callback in live.session.callbacks:
            callback(message)
    for k, t in enumerate(log["time_s"].tolist()):
        stamp = round(1e6 * t) + 1_000_000
        live.core.sent, live.core.last_us = [float(log[f"motor{i + 1}"][k]) for i in range(8)], stamp
        rates = [float(log[f"gyro_{a}_rad_s"][k]) for a in "xyz"]
        imu = mavlink.MAVLink_highres_imu_message(
            stamp, *[float(log[f"accel_{a}_m_s2"][k]) for a in "xyz"], *rates, *[0.0] * 7, 0x3F, 0
        )
        for callback in live.session.callbacks:
            callback(imu)
        end = time.monotonic() + 600.0
        while len(watch._queue) > WAITING // 2 and time.monotonic() < end:
            time.sleep(0.002)
    end = time.monotonic() + 600.0
    while watch._queue and time.monotonic() < end:
        time.sleep(0.002)


def test_rotors_are_called_one_after_the_other_and_said_to_both_sides(flight):
    vehicle, log = flight
    live, ground, said = mixer(vehicle), Line(), []
    with HealthWatch(live, said.append, ground) as watch:
        fly(live, watch, log)
    assert not watch.problem and not live.session.callbacks
    result = watch.account()
    assert [c["rotor"] for c in result["calls"]] == list(ONSETS)
    for call, onset in zip(result["calls"], ONSETS.values(), strict=True):
        assert 0.0 < call["time_s"] - 1.0 - onset < 2.0 and call["loss"] == pytest.approx(0.12, abs=0.04)
    assert [c.rotor for c in said] == [3, 3, 8, 8]  # again once the size is settled
    for line in (live.session, ground):
        texts = [m for m in line.sent if m.get_type() == "STATUSTEXT"]
        assert [m.severity for m in texts] == [mavlink.MAV_SEVERITY_CRITICAL] * 4
        assert texts[0].text.startswith("rotor 3 loses thrust") and len(texts[1].text) <= 50


@pytest.mark.parametrize(("dry_run", "state"), [(True, LIVE), (False, RAMP)])
def test_what_our_commands_did_not_do_is_not_judged(flight, dry_run, state):
    vehicle, log = flight
    live = mixer(vehicle, dry_run)
    with HealthWatch(live, lambda _: None) as watch:
        fly(live, watch, log, state)
    assert watch.account()["word"] is None and not live.session.sent


def test_an_error_in_the_test_ends_the_test_alone(flight, monkeypatch):
    live = mixer(flight[0])
    monkeypatch.setattr(InAir, "heard", lambda *_: 1 / 0)
    with HealthWatch(live, lambda _: None) as watch:
        live.session.callbacks[0](mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3))
        watch._thread.join(60.0)
    assert "division" in watch.account()["why"]


def test_a_rotor_is_told_also_where_no_other_law_can_be_made(flight, monkeypatch):
    live, said = mixer(flight[0]), []
    live.session.identity = SimpleNamespace(is_px4=False)
    stopped = Call(3, 5.0, 0.9, 1.0, 0.0, True, True, stopped=True, flown_without=True)
    monkeypatch.setattr(InAir, "heard", lambda *_: stopped)
    with HealthWatch(live, said.append, None, SimpleNamespace(answer=lambda *_: 1 / 0, done=())) as watch:
        live.session.callbacks[0](mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3))
        watch._thread.join(60.0)
    assert [c.text for c in said] == ["rotor 3 stopped: land"] and "division" in watch.problem
    assert live.session.sent[-1].text == "rotor 3 stopped: land"


def test_a_size_that_was_being_settled_at_the_landing_holds_up_no_call_of_the_next_flight(flight):
    def verdict(time_s, rotor):
        s = Suspicion(rotor, 0.99, 0.2, 0.02, False)
        return Verdict(time_s, True, (s,), 0.0, s)

    in_air = InAir(flight[0])
    flying = mavlink.MAVLink_extended_sys_state_message(0, 2)
    for state in (flying, mavlink.MAVLink_extended_sys_state_message(0, 1), flying):
        for message in (mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3), state):
            in_air.heard(message)
        if not in_air.calls:
            assert in_air._judged(verdict(1500.0, 3)).rotor == 3
    call = in_air._judged(verdict(5.0, 4))  # the vehicle was switched off and on again
    assert call is not None and call.rotor == 4
    assert [c.rotor for c in in_air.calls] == [3, 4]


def test_a_weakened_vehicle_is_flown_by_the_law_with_that_rotor_faster(flight):
    vehicle, _ = flight
    weight = 9.80665 * vehicle.airframe.mass_kg
    sound = make_law("exact", vehicle).speeds([weight, 0, 0, 0])
    law = make_law("exact", weakened(vehicle, 3, 0.2))
    speeds = law.speeds([weight, 0, 0, 0])
    gains = [r.thrust_gain for r in weakened(vehicle, 3, 0.2).airframe.rotors]
    assert gains == [1, 1, 0.8, 1, 1, 1, 1, 1] and not law.dropped
    # the wrench is delivered by rotors of which one is weak
    frame = weakened(vehicle, 3, 0.2).airframe
    got = frame.wrench(*frame.loads(vehicle.model, speeds))
    assert got == pytest.approx([weight, 0, 0, 0], abs=1e-6)
    assert abs(speeds - sound).max() > 0.005
