"""What flights say of a pair's coefficients: the world's pair is the truth, the prior is off."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from coaxlink.channels.flight import flight_frame
from coaxlink.constants import NORMAL_95, TURNING
from coaxlink.data import read_flight_log
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.rotor.model import RotorModel
from coaxlink.rotor_update.coefficients import (
    NO_PRIOR,
    _within,
    by_speed,
    coefficients_from_flights,
    prior_covariance,
)
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

FRAME, ROTORS = example("x8_demo.toml"), example("rotor_paper.toml")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """(vehicle, a way to fly it and read its log)."""
    vehicle = load_vehicle(FRAME, ROTORS)
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)

    def fly(plan, *effects):
        path = tmp_path_factory.mktemp("flights") / f"{plan}.csv"
        write_flight(path, fly_quick(made, FlightWorld(effects, 3, plan, 55.0), 8)[1])
        return read_flight_log(path)

    return vehicle, fly


def off(model, factors):
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(model.terms().items(), factors, strict=True)
    }
    return RotorModel.from_terms(model.form, model.speed_max_rpm, terms)


@pytest.mark.slow
@pytest.mark.parametrize("plan", ["hover", "wander"])
def test_speeds_follow_a_sagging_pack_and_a_hover_teaches_no_slope(flown, plan):
    vehicle, fly = flown
    log = fly(plan, HiddenEffect("battery_voltage", 0.5))
    top = vehicle.rotors.speed_max_rpm
    speeds = by_speed(log, vehicle.declared, vehicle.rotors)
    air = slice(250, -50)
    for n in (1, 8):
        command, true, found = (x[air] for x in (log[f"motor{n}"], log[f"rpm{n}"] / top, speeds[f"motor{n}"]))
        assert np.abs(command - true).mean() > 0.01  # what a command means has drifted
        assert abs(np.mean(found - true)) < 1e-3
        # what the motor's lag and the ESC's noise leave between a command and its speed, and no more
        assert np.std(found - true) < 0.01
        quick = np.diff(found) @ np.diff(command) / (np.diff(command) @ np.diff(command))
        assert quick == pytest.approx(np.mean(true / command), rel=0.12)


def test_damaged_commands_teach_no_speeds(flown):
    vehicle, fly = flown
    log = fly("wander")
    damaged = np.arange(log.rows) % 40 == 7
    harmed = log.with_columns(motor1=np.where(damaged, 37.0, log["motor1"]))
    sound, found = (by_speed(x, vehicle.declared, vehicle.rotors)["motor1"] for x in (log, harmed))
    assert not np.isfinite(found[damaged]).any()
    assert np.abs(found - sound)[~damaged].max() < 0.01


@pytest.mark.slow
def test_a_prior_15_percent_off_meets_the_pair_under_a_sagging_pack(flown):
    vehicle, fly = flown
    true = vehicle.rotors
    prior = off(true, (0.85, 1.15, 1.15, 0.85))
    logs = [
        fly("wander", HiddenEffect("battery_voltage", 0.5)),
        fly("circle", HiddenEffect("battery_voltage", 0.3)),
    ]
    update = coefficients_from_flights(logs, vehicle.declared, prior)
    assert update.measured_speeds
    u, v = (np.array([s]) for s in update.hover)
    ours, theirs, first = (m.upper_thrust(u, v) + m.lower_thrust(u, v) for m in (update.model, true, prior))
    assert abs(first / theirs - 1.0) > 0.02
    assert ours / theirs == pytest.approx(1.0, abs=0.01)


def test_rows_near_a_motors_end_are_left_out(flown):
    vehicle, fly = flown
    log = by_speed(fly("steps"), vehicle.declared, vehicle.rotors)
    frame = flight_frame([log], vehicle.declared, vehicle.rotors)
    kept = _within(frame, log)
    assert 50 < len(kept.keep) < 0.9 * len(frame.keep)
    assert frame.speeds[frame.keep].min() < TURNING <= kept.speeds[kept.keep].min()
    ends = log.with_columns(**{f"motor{n}": np.full(len(log["time_s"]), 0.99) for n in range(1, 9)})
    with pytest.raises(InputError, match=r"motors.*nearly never"):
        _within(flight_frame([ends], vehicle.declared, vehicle.rotors), ends)


def named(model):
    """(names, values) of a model's coefficients."""
    names = [(load, term) for load, own in model.terms().items() for term in own]
    return names, np.array([model.terms()[load][term] for load, term in names])


def test_a_prior_without_intervals_is_off_as_a_whole_too(flown):
    model = replace(flown[0].rotors, identified={})
    names, values = named(model)
    covariance, notes = prior_covariance(model, names, values)
    assert "of each load as a whole" in notes[0] and "no intervals" in notes[0]
    for load in model.terms():
        own = np.array([name == load for name, _ in names]) * values
        # a load at full speed is no better known than a load as a whole is
        assert np.sqrt(own @ covariance @ own) > NO_PRIOR * abs(own.sum())
    other = np.array([[a[0] != b[0] for b in names] for a in names])
    assert not covariance[other].any()


def test_intervals_of_a_file_are_its_prior_and_a_guess_beside_them_is_said(flown):
    model = flown[0].rotors
    names, values = named(model)
    (load, term), value = names[0], float(values[0])
    bounds = {a: {b: [v - 0.2, v + 0.2] for (c, b), v in zip(names, values, strict=True) if c == a}
              for a, _ in names}  # fmt: skip
    covariance, notes = prior_covariance(replace(model, identified={"intervals": bounds}), names, values)
    assert covariance == pytest.approx(np.eye(len(names)) * (0.2 / NORMAL_95) ** 2)
    assert notes == ("prior: its intervals",)
    del bounds[load][term]
    covariance, notes = prior_covariance(replace(model, identified={"intervals": bounds}), names, values)
    assert covariance[0, 0] == pytest.approx(2.0 * (NO_PRIOR * value) ** 2)
    assert f"has none (1 of {len(names)})" in notes[0]


@pytest.mark.slow
def test_loads_in_hover_are_inside_their_intervals_whichever_way_the_prior_is_off(flown):
    vehicle, fly = flown
    true = replace(vehicle.rotors, identified={})
    log = fly("wander", HiddenEffect("battery_voltage", 0.3))
    worst = []
    for signs in itertools.product((0.85, 1.15), repeat=4):
        update = coefficients_from_flights([log], vehicle.declared, off(true, signs))
        pair = true.loads(*(np.array([u]) for u in update.hover))
        off_by = [
            (value - float(getattr(pair, load.replace(".", "_").rsplit("_", 1)[0])[0])) / sd
            for load, (_, _, value, sd) in update.loads.items()
        ]
        worst.append(np.abs(off_by).max())
    assert max(worst) < NORMAL_95
