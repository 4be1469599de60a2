"""The loop's live way, flown in lock-step: what is found does not depend on how busy the machine is."""

import time
from dataclasses import replace

import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.errors import CheckFailed
from coaxlink.fly.trajectory import FlightPlan, Hold, Swing
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor.model import EffectEntry as Effect
from coaxlink.studies import allocation, flights
from coaxlink.studies import loop as closed_loop
from coaxlink.vehicle import Vehicle

AIRFRAME = load_airframe(files.example("x8_demo.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))
VEHICLE = Vehicle(AIRFRAME, MODEL)
HOVER, NORTH, UP = (0.0, 0.0, -3.0), (1.0, 0.0, -3.0), (0.0, 0.0, -4.2)
PLAN = FlightPlan(
    (Hold("hover", HOVER, 3.0), Swing("to and fro", HOVER, NORTH, 7.5, 3), Swing("up", HOVER, UP, 6.0, 3))
)
# the world's own law is another: thrust times 1 - r / (1 + |r|), r = 4 V / (u 105 m/s)
INFLOW = Effect("axial_inflow", {"thrust_per_climb_N_s_m": 2.5, "by_thrust": 1.0, "levelling_s_m": 0.05})
STALL_S = 1.0


def fly(tmp_path, model, watch=lambda *_: None):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "axial_inflow"\nsize = 4.0\n')
    hidden = ["--airframe", str(files.example("x8_demo.toml")), "--truth", str(truth)]
    world = closed_loop.World(hidden, 1, 30.0, tmp_path, PLAN, watch=watch)
    return closed_loop._fly_live(world, 1, Vehicle(AIRFRAME, model, measured_live=True), "live")


def errors(flown):
    flight, demands = flown
    d = allocation.errors_of_live(flight, VEHICLE, demands).allocation
    return [d.thrust_error_N, *d.torque_error_Nm]


@pytest.mark.timeout(1800)
def test_an_inflow_is_taken_out_live_though_the_companion_sleeps_a_second(tmp_path):
    before = errors(fly(tmp_path, MODEL))
    slept = []

    def watch(segment, t):
        if t > 6.0 and not slept:  # 30 s of the vehicle's time, were it not to wait
            slept.append(t)
            time.sleep(STALL_S)

    after = errors(fly(tmp_path, replace(MODEL, effects=(INFLOW,)), watch))
    assert slept
    assert before[0] > 1.5 and before[2] > 0.05  # the plan upsets thrust and pitch
    assert after[0] < 0.5 * before[0] and after[2] < 0.5 * before[2], (before, after)


def test_a_flight_that_was_not_the_mixers_is_not_weighed(monkeypatch, tmp_path):
    world = closed_loop.World([], 1, 10.0, tmp_path, PLAN)
    planned = round(250 * PLAN.duration_s)
    for cycles, hand_overs in ((0.6 * planned, 1), (planned, 5)):
        account = {"cycles": cycles, "hand_overs": hand_overs}
        monkeypatch.setattr(flights, "fly_live", lambda *_, a=account, **__: ("flown", flights.Demands(), a))
        with pytest.raises(CheckFailed, match="not the mixer's flight"):
            closed_loop._fly_live(world, 1, VEHICLE, "before")
    account = {"cycles": planned, "hand_overs": 1}
    monkeypatch.setattr(flights, "fly_live", lambda *_, **__: ("flown", flights.Demands(), account))
    assert closed_loop._fly_live(world, 1, VEHICLE, "before")[0] == "flown"
