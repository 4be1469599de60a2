"""A flight's answer held to its own numbers: slow forces are no sudden mass, what is nil is not named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.effects import flight_effects
from coaxlink.effects.wind import apart
from coaxlink.residual import refine
from coaxlink.residual.channels.flight import flight_frame
from coaxlink.residual.checks.posterior_check import nil, spoils
from coaxlink.residual.regression.blocks import accumulate, folds_of
from coaxlink.rotor import load_rotor_model

HIDDEN = {"clean": {}, "sagging": {"battery": 0.12}, "sagging and heavy": {"battery": 0.12, "mass": 0.08}}
EFFECTS = {e.name: e for e in flight_effects()}


@pytest.fixture(scope="module")
def flights():
    return dict(zip(HIDDEN, fly(list(HIDDEN.values()), seconds=56.0, seed=7), strict=True))


def ask(log, inertia=(1.0, 1.0, 1.0)):
    declared = load_airframe(files.example("x8_paper.toml"))
    moments = tuple(np.multiply(declared.inertia_kg_m2, inertia).tolist())
    airframe = replace(declared, motor_lag_s=0.02, inertia_kg_m2=moments)
    return refine(Samples(log, "flight"), airframe, load_rotor_model(files.example("rotor_paper.toml")))


@pytest.mark.slow
def test_a_sag_that_was_not_logged_is_no_mass_that_changes(flights):
    answer = ask({k: v for k, v in flights["sagging"].items() if k != "voltage_V"})
    assert answer.effects == ()
    assert "force_z" in [u.channel for u in answer.unexplained]
    assert any("voltage_V is not in the log" in note for note in answer.notes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_a_force_that_wanders_is_no_mass_that_changes(flights, seed):
    log = flights["clean"]
    steps = np.random.default_rng(seed).standard_normal(len(log["time_s"]) + 400)
    smooth = np.convolve(steps, np.hanning(401), mode="valid")[: len(log["time_s"])]
    wander = 0.35 * (smooth - smooth.mean()) / smooth.std()
    answer = ask(log | {"accel_z_m_s2": log["accel_z_m_s2"] + wander})
    assert answer.effects == () and answer.ambiguous == ()
    assert "force_z" in [u.channel for u in answer.unexplained]


@pytest.mark.slow
def test_a_mass_does_not_hide_behind_the_reference_voltage(flights):
    answer = ask(flights["sagging and heavy"])
    assert sorted(e.name for e in answer.effects) == ["battery_voltage", "mass_change"]
    (mass,) = [p for e in answer.effects for p in e.parameters if p.name == "mass_kg"]
    assert mass.value == pytest.approx(21.6, abs=0.4)


@pytest.mark.slow
def test_a_sagging_battery_alone_brings_no_mass(flights):
    assert [e.name for e in ask(flights["sagging"]).effects] == ["battery_voltage"]


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "scale"), [("x", 1.25), ("z", 0.8)])
def test_a_gyro_of_a_wrong_scale_is_named_with_its_factor(flights, axis, scale):
    column = f"gyro_{axis}_rad_s"
    answer = ask(flights["clean"] | {column: scale * flights["clean"][column]})
    assert [s.column for s in answer.suspect_data] == [column]
    assert f"{scale:.2f} times" in answer.suspect_data[0].why
    assert answer.effects == ()


def test_an_axis_that_never_worked_is_named(flights):
    log = flights["clean"]
    answer = ask(log | {"accel_y_m_s2": np.zeros(len(log["time_s"]))})
    assert [s.column for s in answer.suspect_data] == ["accel_y_m_s2"]
    assert answer.effects == ()


@pytest.mark.parametrize(("spread", "gone"), [(2.0, True), (0.2, False)])
def test_a_drag_that_may_be_none_is_nil(spread, gone):
    effect = EFFECTS["rotor_drag"]

    def named(k, values):
        return effect.parameters(None, dict.fromkeys(("drag_per_speed_N_s_m", "moment_share"), 1.0), values)

    member = SimpleNamespace(effect=effect, parameters=lambda frame: named(0, np.array([1.0, 40.0])))
    joint = SimpleNamespace(members=[member], problem=SimpleNamespace(frame=None), named=named)
    draws = np.random.default_rng(0).normal([1.0, 40.0], [spread, 5.0], size=(200, 2))
    assert (nil(joint, 0, draws) is not None) == gone


def test_torque_without_thrust_is_no_failing_rotor():
    refuse = EFFECTS["degraded_rotor"].refuse
    assert refuse({"rotor": 8.0, "thrust_loss": 0.001, "torque_loss": -0.09})
    assert refuse({"rotor": 8.0, "thrust_loss": 0.1, "torque_loss": -0.1}) is None


def test_a_wind_and_rotor_drag_of_its_own_add_up_to_the_wind_that_held_both(flights):
    airframe, model = (
        load_airframe(files.example("x8_paper.toml")),
        load_rotor_model(files.example("rotor_paper.toml")),
    )
    frame = flight_frame([Samples(flights["clean"], "flight")], airframe, model)
    whole = {"drag_per_speed_N_s_m": 0.6, "wind_north_m_s": 4.0, "wind_east_m_s": -2.0}
    whole |= {"moment_N_s_m": 0.5, "body_drag_kg_m": 0.1, "body_drag_kg_s": 0.2}
    wind, drag = apart(whole)
    both = EFFECTS["wind"].contribution(frame, wind) + EFFECTS["rotor_drag"].contribution(frame, drag)
    assert both == pytest.approx(EFFECTS["wind"].contribution(frame, whole), abs=1e-9)
    assert np.abs(EFFECTS["rotor_drag"].contribution(frame, drag)).max() > 0.1


@pytest.mark.parametrize(("shared", "gone"), [(0.0, True), (1.0, False)])
def test_what_takes_from_one_channel_and_adds_as_much_to_another_is_worth_nothing(shared, gone):
    """A force of 30 that goes with the height, and a column that has a little of it in both channels."""
    rng = np.random.default_rng(2)
    z, block = rng.standard_normal(480), np.arange(480) // 20
    residual = np.stack([10.0 * z + 30.0 * rng.standard_normal(480), 10.0 * shared * z], axis=1)
    residual[:, 1] += 0.5 * rng.standard_normal(480)
    design = np.stack([z, z], axis=1)[:, :, None]
    blocks = accumulate(design, residual, block, folds_of(24), np.array([np.inf]))
    option = SimpleNamespace(columns=np.array([0]))
    nuisance = np.zeros(0, np.intp)
    problem = SimpleNamespace(nuisance=nuisance, blocks=blocks, sigma=np.ones(2), options=(option,))
    assert (spoils(SimpleNamespace(problem=problem), 0) is not None) == gone
