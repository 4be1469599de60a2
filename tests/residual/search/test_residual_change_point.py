"""What begins in mid-flight, a weak motor, a mass that a level of thrust may be: by another world's laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual import refine
from coaxlink.residual.channels.flight import flight_frame
from coaxlink.rotor import RotorModel, load_rotor_model

HIDDEN = {
    "chipped": {"weak": (3, 0.15), "onset": 33.3},
    "slow": {"slow": (2, 0.07)},  # an upper rotor: the lower one feels less wake
    "dropped": {"dropped": 0.05, "onset": 30.0},
    "heavy": {"mass": 0.03},
    "clean": {},
    "chipped and late": {"weak": (6, 0.12), "onset": 27.7, "lag": 0.05},
    "sliding": {"cg": (0.02, -0.015), "onset": 12.0, "over": 30.0},
    "icing": {"weak": (5, 0.15), "onset": 15.0, "over": 25.0},
    "spraying": {"dropped": 0.12, "onset": 10.0, "over": 36.0},
    "sagging": {"battery": 0.12},
}


@pytest.fixture(scope="module")
def flights():
    logs = fly(list(HIDDEN.values()), seconds=56.0, seed=4)
    return {name: Samples(log, name) for name, log in zip(HIDDEN, logs, strict=True)}


def x8():
    return replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)


def with_thrust(level: float) -> RotorModel:
    """The true model with every thrust off by one share."""
    exact = load_rotor_model(files.example("rotor_paper.toml"))
    terms = {
        load: {t: c * (level if "thrust" in load else 1.0) for t, c in named.items()}
        for load, named in exact.terms().items()
    }
    return RotorModel.from_terms("crm", exact.speed_max_rpm, terms)


def found(log: Samples):
    return refine(log, x8(), load_rotor_model(files.example("rotor_paper.toml")))


def numbers(answer, name):
    return next({p.name: p.value for p in e.parameters} for e in answer.effects if e.name == name)


@pytest.mark.slow
@pytest.mark.parametrize("clock", [False, True])
def test_a_blade_that_chips_in_mid_flight_is_found_with_its_moment(flights, clock):
    log = flights["chipped"]
    if clock:  # a simulated battery falls with the clock: no explanation of a step
        log = log.with_columns(voltage_V=25.0 - 0.03 * log["time_s"])
    answer = found(log)
    assert [e.name for e in answer.effects] == ["degraded_rotor"]
    assert answer.ambiguous == ()
    got = numbers(answer, "degraded_rotor")
    assert got["rotor"] == 3
    assert got["thrust_loss"] == pytest.approx(0.15, abs=0.01)
    assert got["onset_s"] == pytest.approx(33.3, abs=0.2)
    assert answer.channels["torque_x"].rmse_after < 1.4 * answer.channels["torque_x"].noise_floor
    # the vehicle as it landed: the model does not know when
    assert "onset_s" not in answer.model.effects[0].parameters


@pytest.mark.slow
def test_a_weak_motor_is_told_from_a_bad_blade_by_its_partner(flights):
    answer = found(flights["slow"])
    assert [e.name for e in answer.effects] == ["degraded_rotor"]
    got = numbers(answer, "degraded_rotor")
    assert (got["rotor"], got["speed_loss"]) == (2, pytest.approx(0.07, abs=0.004))
    assert got["thrust_loss"] == pytest.approx(1 - 0.93**2, abs=0.01)


@pytest.mark.slow
def test_a_payload_that_falls_is_a_mass(flights):
    answer = found(flights["dropped"])
    assert [e.name for e in answer.effects] == ["mass_change"]
    got = numbers(answer, "mass_change")
    assert got["onset_s"] == pytest.approx(30.0, abs=0.3)
    assert got["mass_kg"] == pytest.approx(19.0, abs=0.1)


@pytest.mark.slow
def test_a_little_more_mass_is_told_from_thrust_by_the_torques(flights):
    answer = found(flights["heavy"])
    assert [e.name for e in answer.effects] == ["mass_change"]
    assert answer.ambiguous == ()
    assert numbers(answer, "mass_change")["mass_kg"] == pytest.approx(20.6, abs=0.15)


@pytest.mark.slow
def test_with_the_inertia_in_doubt_it_may_be_a_level_of_thrust(flights):
    airframe = x8()
    ix, iy, iz = airframe.inertia_kg_m2
    wrong = replace(airframe, inertia_kg_m2=(1.05 * ix, 0.96 * iy, iz))
    answer = refine(flights["heavy"], wrong, load_rotor_model(files.example("rotor_paper.toml")))
    assert answer.effects == ()
    (doubt,) = answer.ambiguous
    assert doubt.names == ("mass_change", "thrust_level")
    said = float(doubt.separate_by.split("weigh it. ")[1].split(" kg")[0])
    assert said == pytest.approx(20.6, abs=0.15)


@pytest.mark.slow
def test_a_level_of_thrust_moves_the_torques_with_the_lift(flights):
    answer = refine(flights["clean"], x8(), with_thrust(1.03))
    assert answer.effects == ()
    (doubt,) = answer.ambiguous
    assert doubt.names == ("mass_change", "thrust_level")
    assert "level of thrust is likelier" in doubt.separate_by


@pytest.mark.slow
@pytest.mark.parametrize(("level", "share"), [(0.98, 1.08), (1.02, 0.92)])
def test_a_stand_two_per_cent_off_and_a_rough_inertia_are_no_mass(flights, level, share):
    airframe = x8()
    ix, iy, iz = airframe.inertia_kg_m2
    wrong = replace(airframe, inertia_kg_m2=(share * ix, iy / share, iz))
    answer = refine(flights["clean"], wrong, with_thrust(level))
    assert answer.effects == () and answer.ambiguous == ()


@pytest.mark.slow
def test_rows_whose_commands_jump_between_two_rows_are_not_judged(flights):
    log = flights["heavy"]
    jumped = np.clip(log["motor1"] + 0.3 * (np.arange(log.rows) == log.rows // 2), 0, 1)
    answer = found(log.with_columns(motor1=jumped))
    assert any("commands jump" in note for note in answer.notes)


@pytest.mark.slow
def test_rows_about_a_command_at_its_limit_are_not_judged(flights):
    log = flights["heavy"]
    full = log["motor1"].copy()
    full[log.rows // 2 : log.rows // 2 + 5] = 1.0
    answer = found(log.with_columns(motor1=full))
    assert any("a command is at its limit" in note for note in answer.notes)
    assert [e.name for e in answer.effects] == ["mass_change"]


@pytest.mark.slow
def test_hours_of_flight_are_judged_in_stretches(flights, monkeypatch):
    monkeypatch.setattr("coaxlink.residual.channels.flight.MANY_ROWS", 1600)
    monkeypatch.setattr("coaxlink.residual.channels.flight.STRETCH_S", 8.0)
    answer = found(flights["slow"])
    assert [e.name for e in answer.effects] == ["degraded_rotor"]
    assert any("one stretch of 8 s in 2 is judged" in note for note in answer.notes)
    assert answer.channels["force_z"].held_out_rows < 300


def test_hours_of_flight_in_fragments_are_judged_too(flights, monkeypatch):
    """Fragments of 5 s with rows missing in each: whole ones, however few rows they have."""
    monkeypatch.setattr("coaxlink.residual.channels.flight.MANY_ROWS", 400)
    log = flights["slow"]
    time = log["time_s"] - log["time_s"][0]
    kept = (time % 5.5 < 5.0) & ~((time % 5.5 > 2.0) & (time % 0.25 < 0.2) & (time % 5.5 < 4.5))
    holes = np.where(kept, log["roll_rad"], np.nan)
    frame = flight_frame([log.with_columns(roll_rad=holes)], x8(), with_thrust(1.0))
    assert any("one stretch" in note for note in frame.notes)
    assert len(set(frame.stretch)) > 1


def test_nothing_is_judged_right_behind_a_step_of_the_commands(flights):
    log = flights["clean"]
    time, kicked = log["time_s"], log["motor1"].copy()
    kicked[(time >= 20.0) & (time < 22.0)] += 0.25
    frame = flight_frame([log.with_columns(motor1=kicked)], x8(), with_thrust(1.0))
    judged = frame.time_s[frame.keep]
    for step in (20.0, 22.0):
        assert not np.any((judged > step) & (judged < step + 0.35))
        assert np.any((judged > step - 0.5) & (judged < step - 0.1))
        assert np.any((judged > step + 0.5) & (judged < step + 0.8))
