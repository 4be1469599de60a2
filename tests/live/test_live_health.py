"""Rotors' health beside the live mixer, told the messages of a simulated flight under the exact law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from case_table import case_table
from live_line import Session
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.files import example
from coaxlink.health.sequential import Suspicion, Verdict
from coaxlink.live import health_watch, weighed
from coaxlink.live.guard import LIVE, RAMP
from coaxlink.live.health_watch import HealthWatch
from coaxlink.live.in_air import InAir, weakened
from coaxlink.mixer import make_law
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

FRAME, ROTORS = Path(example("x8_demo.toml")), Path(example("rotor_paper.toml"))
ONSETS = {3: 12.0, 8: 19.0}
BEAT = mavlink.MAVLink_heartbeat_message(14, 12, 128, 0, 4, 3)
CHARGED = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 25000, -1, 95, 0, 0, 0, 0, 0, 0)
FLYING, LANDED = (mavlink.MAVLink_extended_sys_state_message(0, state) for state in (2, 1))


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle(FRAME, ROTORS)


@pytest.fixture(scope="module")
def log(vehicle):
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)
    weak = [HiddenEffect("degraded_rotor", 0.12, at, {"rotor": float(n)}) for n, at in ONSETS.items()]
    return fly_quick(made, FlightWorld(tuple(weak), 4, "wander", 19.0), 8)[1]


def mixer(vehicle, dry_run=False, state=LIVE):
    core = SimpleNamespace(vehicle=vehicle, count=8, last_us=None, sent=[0.0] * 8)
    return SimpleNamespace(session=Session(), core=core, guard=SimpleNamespace(state=state), dry_run=dry_run)


def fly(live, watch, log):
    """Everything the autopilot says, at 50 Hz, each judged at once."""
    watch.listen()
    for message in (BEAT, FLYING, CHARGED):
        live.session.hear(message)
    for k, t in enumerate(log["time_s"].tolist()):
        stamp = round(1e6 * t) + 1_000_000
        live.core.sent, live.core.last_us = [float(log[f"motor{i + 1}"][k]) for i in range(8)], stamp
        rates = [float(log[f"gyro_{a}_rad_s"][k]) for a in "xyz"]
        accel = [float(log[f"accel_{a}_m_s2"][k]) for a in "xyz"]
        live.session.hear(mavlink.MAVLink_highres_imu_message(stamp, *accel, *rates, *[0.0] * 7, 0x3F, 0))
        watch.work()


@pytest.mark.slow
def test_rotors_are_called_one_after_the_other_and_said_to_the_vehicle(vehicle, log):
    live, reported = mixer(vehicle), []
    watch = HealthWatch(live, reported.append)
    fly(live, watch, log)
    calls = watch.account()["calls"]
    assert not watch.problem and [c["rotor"] for c in calls] == list(ONSETS)
    for call, onset in zip(calls, ONSETS.values(), strict=True):
        assert 0.0 < call["time_s"] - 1.0 - onset < 2.0 and call["loss"] == pytest.approx(0.12, abs=0.04)
    assert [text.split()[1] for text in reported] == list("3388")  # again once the size is settled
    texts = [m for m in live.session.texts if m.get_type() == "STATUSTEXT"]
    assert [m.severity for m in texts] == [mavlink.MAV_SEVERITY_CRITICAL] * 4
    assert texts[0].text.startswith("rotor 3 loses thrust") and len(texts[1].text) <= 50


def guessed(vehicle, **changed):
    sources = {"inertia_kg_m2": "estimated", "motor_lag_s": "default"}
    return replace(vehicle, declared=replace(vehicle.declared, sources=sources, **changed))


@pytest.mark.slow
def test_what_hangs_on_a_guess_or_on_another_vehicle_is_no_call(vehicle, log, monkeypatch):
    """Every premise agrees on rotor 3; where one does not, or where outputs are exchanged, it is no call."""
    body = vehicle.declared
    twice = {**log, "motor1": log["motor6"], "motor6": log["motor1"]}
    holds = weighed.Premised.holds
    blind = lambda determined, *asked: "2 times" not in determined.words and holds(determined, *asked)  # noqa: E731
    with case_table() as case:
        for name, flown, rows, sees, words in (
            ("guessed, and it does not matter", guessed(vehicle), log, holds, "rotor 3 lost"),
            ("guessed, and it matters", guessed(vehicle), log, blind, "cannot judge, measure inertia_kg_m2"),
            ("outputs exchanged", vehicle, twice, holds, "not this vehicle (outputs)"),
            ("a fifth lighter", guessed(vehicle, mass_kg=0.8 * body.mass_kg), log, holds, "vehicle (lift)"),
        ):
            with case(name):
                monkeypatch.setattr(weighed.Premised, "holds", sees)
                live, reported = mixer(flown), []
                watch = HealthWatch(live, reported.append)
                fly(live, watch, rows)
                texts = [m.text for m in live.session.texts if m.get_type() == "STATUSTEXT"]
                assert any(words in text for text in texts), texts
                calls = [c["rotor"] for c in watch.account()["calls"]]
                assert bool(calls) == ("lost" in words) and set(calls) <= set(ONSETS)


@pytest.mark.slow
@pytest.mark.parametrize(("dry_run", "state"), [(True, LIVE), (False, RAMP)])
def test_what_our_commands_did_not_do_is_not_judged(vehicle, log, dry_run, state):
    live = mixer(vehicle, dry_run, state)
    watch = HealthWatch(live, lambda _: None)
    fly(live, watch, log)
    assert watch.account()["word"] is None and not live.session.texts


def in_its_thread(live, monkeypatch, heard):
    """Say one message to a watch whose test does what `heard` does, and wait until its thread has ended."""
    monkeypatch.setattr(InAir, "heard", heard)
    monkeypatch.setattr(health_watch, "ASK_AFTER_S", 0.0)
    reported = []
    with HealthWatch(live, reported.append) as watch:
        live.session.hear(BEAT)
        watch._thread.join(60.0)
    assert not live.session.listeners
    return watch, reported


def test_an_error_in_the_test_ends_the_test_alone(vehicle, monkeypatch):
    watch, _ = in_its_thread(mixer(vehicle), monkeypatch, lambda *_: 1 / 0)
    assert "division" in watch.account()["why"]


def test_a_size_that_was_being_settled_at_the_landing_holds_up_no_call_of_the_next_flight(vehicle):
    def verdict(time_s, rotor):
        s = Suspicion(rotor, 0.99, 0.2, 0.02, False)
        return Verdict(time_s, True, (s,), 0.0, s), s

    in_air = InAir(vehicle)
    for state in (FLYING, LANDED, FLYING):
        for message in (BEAT, state):
            in_air.heard(message)
        if not in_air.calls:
            assert in_air._judged(*verdict(1500.0, 3)).rotor == 3
    call = in_air._judged(*verdict(5.0, 4))  # the vehicle was switched off and on again
    assert call is not None and [c.rotor for c in in_air.calls] == [3, 4]


def test_a_weakened_vehicle_is_flown_by_the_law_with_that_rotor_faster(vehicle):
    hover = [9.80665 * vehicle.airframe.mass_kg, 0, 0, 0]
    weak = weakened(vehicle, 3, 0.2)
    law = make_law("exact", weak)
    speeds = law.speeds(hover)
    assert [r.thrust_gain for r in weak.airframe.rotors] == [1, 1, 0.8, 1, 1, 1, 1, 1] and not law.dropped
    frame = weak.airframe
    assert frame.wrench(*frame.loads(vehicle.model, speeds)) == pytest.approx(hover, abs=1e-6)
    assert abs(speeds - make_law("exact", vehicle).speeds(hover)).max() > 0.005
