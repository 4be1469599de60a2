"""Real logs (not part of the repository): flights of real firmware, steps of a real stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import read_flight_log, read_stand_log
from coaxlink.residual import refine, refine_stand
from coaxlink.rotor import load_rotor_model

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
FLIGHTS = DATA / "flights"
pytestmark = [
    pytest.mark.shared_data,
    pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the real logs are not beside the repository"),
]


def answer(name: str, lag_s: float = 0.02):
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=lag_s)
    return refine(
        read_flight_log(FLIGHTS / name), airframe, load_rotor_model(files.example("rotor_paper.toml"))
    )


@pytest.mark.parametrize("name", ["px4_null_fitted.ulg", "ap_null.bin"])
def test_a_flight_without_effects_gives_none(name):
    result = answer(name)
    assert result.effects == () and result.ambiguous == () and result.unexplained == ()


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("px4_null_fitted.ulg", ["rotor_lag"]),
        ("ap_null.bin", ["rotor_lag"]),
        ("px4_rotor_drag.ulg", ["rotor_drag", "rotor_lag"]),
    ],
)
def test_a_lag_that_was_not_declared_is_named(name, found):
    result = answer(name, lag_s=0.0)
    assert sorted(e.name for e in result.effects) == found
    assert result.ambiguous == () and result.unexplained == ()
    lag = {p.name: p.value for e in result.effects if e.name == "rotor_lag" for p in e.parameters}["lag_s"]
    assert lag == pytest.approx(0.02, abs=0.008)  # and a few ms of what the firmware takes


def test_rotor_drag_is_found_alone_and_down_to_what_the_true_form_leaves():
    result = answer("px4_rotor_drag.ulg")
    assert [e.name for e in result.effects] == ["rotor_drag"]
    assert result.ambiguous == () and result.unexplained == ()
    before = [result.channels[c].rmse_before for c in ("force_x", "force_y")]
    after = [result.channels[c].rmse_after for c in ("force_x", "force_y")]
    assert before == pytest.approx([6.5, 5.7], rel=0.1)
    assert after[0] < 0.32 and after[1] < 0.30  # the true form leaves 0.29 and 0.25


@pytest.mark.parametrize("name", ["xNova-SR-steps.csv", "xNova-MR-steps.csv"])
def test_steps_of_a_real_motor_show_its_lag_and_flag_nobody(name):
    result = refine_stand(read_stand_log(DATA / "single" / name))
    numbers = {e.name: {p.name: p.value for p in e.parameters} for e in result.effects}
    assert result.suspect_data == ()
    assert numbers["rotor_lag"]["lag_s"] == pytest.approx(0.15, abs=0.02)
    assert numbers["rotor_inertia_torque"]["rotor_inertia_kg_m2"] == pytest.approx(1.9e-5, rel=0.15)
