"""Flights through the switch: what is there is named, a clean flight says nothing, a loop is no effect.

The world is that of tests/residual and shares nothing with coaxlink.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "residual"))
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.diagnosis.feedback import feedback, in_step
from coaxlink.diagnosis.reducing import reducing
from coaxlink.effects.onset import since
from coaxlink.errors import InputError
from coaxlink.residual import refine
from coaxlink.residual.channels.flight import flight_frame, reduce_columns
from coaxlink.rotor import load_rotor_model
from coaxlink.signals import low_pass

HIDDEN = {"clean": ({}, []), "dropped": ({"dropped": 0.05, "onset": 30.0}, ["mass_change"])}


@pytest.fixture(scope="module")
def flights():
    logs = fly([effects for effects, _ in HIDDEN.values()], seconds=56.0, seed=4)
    return {name: Samples(log, name) for name, log in zip(HIDDEN, logs, strict=True)}


@pytest.fixture(scope="module")
def vehicle():
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    return airframe, load_rotor_model(files.example("rotor_paper.toml"))


@pytest.mark.parametrize("name", list(HIDDEN))
def test_what_is_there_is_named(name, flights, vehicle):
    answer = refine(flights[name], *vehicle)
    assert sorted(e.name for e in answer.effects) == HIDDEN[name][1]
    assert answer.ambiguous == () and answer.suspect_data == () and answer.unexplained == ()
    for effect in answer.effects:
        assert effect.evidence["probability"] > 0.99
        numbers = {p.name: p.value for p in effect.parameters}
        middle = numbers["onset_s"] + 0.5 * numbers.get("over_s", 0.0)
        assert middle == pytest.approx(30.0, abs=0.5) and numbers.get("over_s", 0.0) < 2.0


def test_the_low_pass_as_a_matrix_is_the_filter(flights, vehicle):
    frame = flight_frame([flights["clean"]], *vehicle)
    columns = np.random.default_rng(0).normal(size=(len(frame.time_s), 6, 2)).cumsum(axis=0)
    columns[:, 2] = 0.0
    mine, usual = reducing(frame)(columns), reduce_columns(frame, columns)
    assert np.max(np.abs(mine - usual)) < 1e-4 * np.std(usual)


def test_what_comes_gradually_takes_its_time(flights, vehicle):
    frame = flight_frame([flights["clean"]], *vehicle)
    step = since(frame, {"onset_s": 20.0})
    ramp = since(frame, {"onset_s": 20.0, "over_s": 10.0})
    at = np.searchsorted(frame.time_s, [19.0, 25.0, 31.0])
    assert np.allclose(step[at], [0.0, 1.0, 1.0])
    assert np.allclose(ramp[at], [0.0, 0.5, 1.0], atol=0.01)


@pytest.mark.parametrize("share", [0.1, 0.4, 0.65])
def test_a_disturbance_that_is_answered_is_partly_in_step(share):
    random = np.random.default_rng(3)
    answered = random.normal(size=200_000)
    disturbance = share * (-share * answered + np.sqrt(1.0 - share**2) * random.normal(size=200_000))
    slope = disturbance @ answered / (answered @ answered)
    beside = float(np.std(disturbance - slope * answered))
    assert in_step(2.0 * beside, 2.0) == pytest.approx(abs(slope) * 2.0, rel=0.05)


def test_what_comes_back_is_weighed_octave_by_octave(flights, vehicle):
    """Fast gusts that nothing answers leave the slow part of the model as sure as it was."""
    frame = flight_frame([flights["clean"]], *vehicle)
    fast = np.sin(2.0 * np.pi * 1.6 * frame.time_s) * np.random.default_rng(5).normal(size=len(frame.time_s))
    gusty = frame.measured.copy()
    gusty[:, 4] += 10.0 * np.std(frame.predicted[:, 4]) * (fast - low_pass(fast, frame.rate_hz, 1.2))
    calm, gusts = (
        next(b for b in feedback(f, reducing(f)) if b.name == "feedback 4").deviation
        for f in (frame, replace(frame, measured=gusty))
    )
    assert gusts[6] > 10.0 * calm[6]  # 1.2 to 2.4 Hz
    assert gusts[0] < 2.0 * calm[0]  # below 0.3 Hz


def test_a_supply_that_no_column_tells_is_no_mass(vehicle):
    log = fly([{"battery": 0.12}], seconds=40.0, seed=5)[0]
    answer = refine(Samples({k: v for k, v in log.items() if k != "voltage_V"}, "unlogged"), *vehicle)
    assert answer.effects == ()
    doubts = [set(a.names) for a in answer.ambiguous]
    open_ends = [(u.channel, u.depends_on) for u in answer.unexplained]
    assert doubts == [{"mass_change", "battery_voltage"}] or open_ends == [("force_z", ("time_s",))]


@pytest.mark.parametrize("harm", ["stuck", "zero"])
def test_a_damaged_log_gives_an_answer_or_one_line(harm, flights, vehicle):
    log = flights["clean"]
    values = log["gyro_x_rad_s"].copy()
    if harm == "stuck":
        values[:] = 0.3
    else:
        values[:] = 0.0
        log = log.with_columns(accel_z_m_s2=np.zeros(len(values)))
    try:
        answer = refine(log.with_columns(gyro_x_rad_s=values), *vehicle)
    except InputError as error:
        assert error.source
    else:
        assert np.all(np.isfinite([c.rmse_after for c in answer.channels.values()]))
