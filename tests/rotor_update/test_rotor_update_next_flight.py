"""The flight that would tell most: what it is made of, what it is worth, and that it tells what it says."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from coaxlink.airframe import Airframe
from coaxlink.cli import main
from coaxlink.data import read_flight_log
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.fly.limits import PLAN_TILT_DEG, FlightLimits, plan_faults
from coaxlink.fly.plans import peaks, plan_of
from coaxlink.fly.trajectory import planned_flight
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.rotor.model import RotorModel, save_rotor_model
from coaxlink.rotor_update.coefficients import coefficients_from_flights
from coaxlink.rotor_update.next_flight import (
    FASTEST_M_S,
    REACH_M,
    RISE_M,
    candidates,
    next_flight,
)
from coaxlink.rotor_update.regressors import unit_loads
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Vehicle, load_vehicle
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.quick.plans import PLANS
from sim.vehicle import read_vehicle

FRAME, ROTORS = example("x8_demo.toml"), example("rotor_paper.toml")


@pytest.fixture(scope="module")
def hovered(tmp_path_factory):
    """(vehicle with a prior 15 % off, log of a hover on the true pair's table, what it told)."""
    vehicle = load_vehicle(FRAME, ROTORS)
    true = vehicle.rotors
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(true.terms().items(), (1.15, 0.85, 0.85, 1.15), strict=True)
    }
    prior = RotorModel.from_terms(true.form, true.speed_max_rpm, terms)
    path = tmp_path_factory.mktemp("flights") / "hover.csv"
    fly(path, "hover", 40.0, report_px4(vehicle, "fitted").params)
    update = coefficients_from_flights([read_flight_log(path)], vehicle.declared, prior)
    return Vehicle(vehicle.declared, prior), path, update


def fly(path, plan, seconds, table):
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), table)
    flown, log = fly_quick(made, FlightWorld((), 3, plan, seconds), 8)
    write_flight(path, log)
    return flown


@pytest.fixture(scope="module")
def planned(hovered):
    vehicle, _, update = hovered
    return next_flight(update, vehicle.airframe)


@pytest.mark.slow
def test_the_plan_fills_its_time_within_its_box(planned):
    assert planned.seconds == 60.0 and len(planned.pieces) == 5
    plan = planned_flight(planned.document())
    assert plan_faults(plan, FlightLimits()) == []
    found = peaks(plan)
    assert found["radius_m"] <= REACH_M + 1e-6 and found["speed_m_s"] <= FASTEST_M_S + 1e-6
    assert found["highest_m"] - found["lowest_m"] <= RISE_M + 0.01 and found["tilt_deg"] < PLAN_TILT_DEG
    assert any(
        piece.cycles for piece in planned.pieces
    )  # behind a hover nothing more of a hover is worth most


def test_it_is_worth_more_than_a_hover_and_no_coefficient_is_forgotten(planned, hovered):
    update = hovered[2]
    assert (planned.after < planned.before).all() and (planned.after < planned.hover).any()
    names = [(c.load, c.term) for c in update.coefficients]
    assert [(c.load, c.term) for c in planned.coefficients] == names
    for known, expected in zip(update.coefficients, planned.coefficients, strict=True):
        assert expected.now == pytest.approx(known.sd)
        assert expected.after <= known.sd * (1 + 1e-9) and expected.hover <= known.sd * (1 + 1e-9)


def test_no_other_choice_of_a_piece_is_better_than_the_last_one(planned, hovered):
    """Greedy: exchanging the last piece for any candidate leaves no less of the criterion."""
    from coaxlink.rotor_update import next_flight as room

    vehicle, _, update = hovered
    model = replace(update.model, effects=())
    law = FittedLaw(Vehicle(vehicle.airframe, model))
    options = candidates(4.0, 1.0)
    frame = replace(update.known.frame, model=model)
    design = room.Design(frame, update.known, True, 4.0, 36.0, planned.table, options, law)
    pieces, left = design.chosen()
    tried = 0
    for other in options:
        try:
            cost = planned.table.cost(design.posterior([*pieces[:-1], other]))
        except InputError:
            continue
        tried += 1
        assert cost >= left * (1 - 1e-9)
    assert tried > 5


@pytest.mark.slow
def test_what_is_expected_is_what_the_flight_leaves(planned, hovered, tmp_path, monkeypatch):
    """Flown by the world on the table that is asked for; each coefficient's interval as it was promised."""
    vehicle, path, update = hovered
    plan = planned_flight(planned.document())

    def goals(times, seed):
        rows = []
        for t in times:
            p = plan.at(max(float(t), 0.0))[1]
            rows.append([*p.position_m, *p.velocity_m_s, *p.acceleration_m_s2, p.yaw_rad, 0.0])
        return np.array(rows)

    monkeypatch.setitem(PLANS, "planned", goals)
    flies = Vehicle(vehicle.airframe, update.model)
    second = tmp_path / "second.csv"
    flown = fly(second, "planned", 60.0, report_px4(flies, "fitted").params)
    assert flown.saturated == 0.0 and not flown.failsafe
    logs = [read_flight_log(p) for p in (path, second)]
    after = coefficients_from_flights(logs, vehicle.airframe, vehicle.model)
    ratio = [e.after / c.sd for e, c in zip(planned.coefficients, after.coefficients, strict=True)]
    assert 0.8 < np.median(ratio) < 1.25
    assert min(ratio) > 0.5 and max(ratio) < 2.0


def test_pieces_are_sized_to_the_vehicle_and_to_the_box():
    for piece in candidates(3.0, 0.8):
        w = 2.0 * np.pi * piece.cycles / piece.seconds
        far = np.hypot(piece.north_m or 0.0, piece.east_m or 0.0)
        up = (piece.height_m or 3.0) - 3.0
        assert far <= REACH_M + 1e-9 and 0.0 <= up <= RISE_M
        assert 0.5 * w * np.hypot(far, up) <= FASTEST_M_S + 1e-9
        assert 0.5 * w**2 * np.radians(piece.yaw_deg or 0.0) <= 0.8 * 1.01
    assert not any(p.yaw_deg for p in candidates(3.0, 0.0))  # a vehicle that has no yaw to spare


def test_what_cannot_be_planned_is_refused(hovered):
    vehicle, _, update = hovered
    heavy: Airframe = replace(vehicle.airframe, mass_kg=60.0)
    with pytest.raises(InputError, match="cannot fly"):
        next_flight(update, heavy)


def test_a_unit_of_each_coefficient_adds_up_to_the_model():
    vehicle = load_vehicle(FRAME, ROTORS)
    body, model = vehicle.declared, vehicle.rotors
    names = [(load, term) for load, own in model.terms().items() for term in own]
    values = np.array([model.terms()[load][term] for load, term in names])
    u = np.random.default_rng(1).uniform(0.3, 0.8, (5, len(body.rotors)))
    for own, whole in zip(unit_loads(body, u, names), body.loads(model, u), strict=True):
        assert own @ values == pytest.approx(whole)


@pytest.mark.slow
def test_the_verb_hands_its_plan_to_fly(hovered, tmp_path, capsys):
    vehicle, path, _ = hovered
    prior, plan, report = tmp_path / "prior.toml", tmp_path / "next.toml", tmp_path / "i.json"
    save_rotor_model(prior, vehicle.model)
    call = ["identify", path, "--airframe", FRAME, "--rotor", prior, "--json", report, "--next", plan]
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in call])
    assert not ended.value.code
    flown = plan_of(str(plan), 9.0, 9.0)
    assert flown.duration_s == pytest.approx(64.0) and plan_faults(flown, FlightLimits()) == []
    reported = capsys.readouterr()
    assert "next flight" in reported.out
    assert "the most informative flight, 60 s within 2 m of the take-off" in reported.err
    assert f"coaxlink fly --plan {plan}" in reported.err
    found = json.loads(report.read_text())["next"]
    assert found["plan"] == tomllib.loads(plan.read_text())
    assert len(found["coefficients"]) == len(json.loads(report.read_text())["told"])
    # without --next nothing is planned, and it is said how
    with pytest.raises(SystemExit):
        main([str(a) for a in call[:-2]])
    assert "--next PLAN.toml plans the most informative flight" in capsys.readouterr().err
    assert "next" not in json.loads(report.read_text())


@pytest.mark.slow
def test_a_vehicle_without_a_plan_keeps_what_its_flight_told(hovered, tmp_path, capsys, monkeypatch):
    def nothing(update, airframe):
        raise InputError("next flight", "", "no piece of a plan keeps these rotors within their range")

    monkeypatch.setattr("coaxlink.rotor_update.next_flight.next_flight", nothing)
    vehicle, path, _ = hovered
    prior, after, plan = (tmp_path / f"{name}.toml" for name in ("prior", "after", "next"))
    save_rotor_model(prior, vehicle.model)
    call = ["identify", path, "--airframe", FRAME, "--rotor", prior, "--out", after, "--next", plan]
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in call])
    assert ended.value.code == 2
    assert after.is_file() and not plan.exists()
    assert capsys.readouterr().err.splitlines()[-1].endswith("keeps these rotors within their range")
