"""Flights that weigh tables: where the law matters, where it does not, where the fitted one is the worse."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.rotor.model import load_rotor_model
from coaxlink.tables.px4 import px4_table
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from sim.effects import Gusts
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.trial_flight import Outcome, fly_trial, shape_error, steady
from sim.trials import TRIALS, Draw
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
AIRFRAME = EXAMPLES / "x8_demo.toml"


@functools.cache
def _params(law: str) -> dict[str, float]:
    frame, model = load_airframe(AIRFRAME), load_rotor_model(EXAMPLES / "rotor_paper.toml")
    return dict(px4.table_to_params(px4_table(Vehicle(frame, model), law)))


@functools.cache
def _flown(trial: str, law: str) -> Outcome:
    return fly_trial(TRIALS[trial], AIRFRAME, _params(law), seed=1)


def test_in_calm_hover_nobody_sees_the_law_but_the_battery() -> None:
    standard, fitted = _flown("hover", "standard"), _flown("hover", "fitted")
    assert fitted.height_rms_m == pytest.approx(standard.height_rms_m, abs=2e-3)
    assert fitted.level_rms_m == pytest.approx(standard.level_rms_m, abs=2e-3)
    assert fitted.yaw_rms_deg == pytest.approx(standard.yaw_rms_deg, abs=0.02)
    assert 1.0 - fitted.shaft_W / standard.shaft_W == pytest.approx(0.049, abs=0.003)


def test_a_hard_turn_costs_the_standard_table_height_and_the_fitted_one_none() -> None:
    calm, standard, fitted = (
        _flown(*f) for f in (("hover", "fitted"), ("yaw steps", "standard"), ("yaw steps", "fitted"))
    )
    assert standard.height_rms_m > 2.0 * fitted.height_rms_m
    assert fitted.height_rms_m == pytest.approx(calm.height_rms_m, abs=3e-3)
    assert fitted.shape[0] < 0.3 < 5.0 < standard.shape[0]
    # and it is the slower one to turn: less yaw authority
    assert fitted.yaw_rms_deg > standard.yaw_rms_deg


def test_near_full_thrust_the_fitted_table_sinks_where_the_standard_one_climbs() -> None:
    standard, fitted = _flown("near full", "standard"), _flown("near full", "fitted")
    assert standard.sunk_m < 0.1
    assert fitted.sunk_m > 1.0 and fitted.saturated > standard.saturated + 0.2


def test_the_same_seed_is_the_same_flight() -> None:
    again = fly_trial(TRIALS["hover"], AIRFRAME, _params("fitted"), seed=1)
    assert again == _flown("hover", "fitted")
    assert fly_trial(TRIALS["hover"], AIRFRAME, _params("fitted"), seed=2) != again


def test_gusts_are_the_seeds_own() -> None:
    def blown(seed: int) -> np.ndarray:
        plant = Plant(read_vehicle(AIRFRAME), read_pair(EXAMPLES / "rotor_paper.toml"))
        gusts = Gusts(2.0, "", seed)
        gusts.start(plant)
        plant.steps = 1000
        gusts.blow(plant)
        wind = plant.index.WIND
        return plant.parameters[wind : wind + 3].copy()

    assert (blown(1) == blown(1)).all() and (blown(1) != blown(2)).any()


def test_eight_seeds_weaken_every_rotor_once() -> None:
    assert sorted(Draw.of(seed, 8).rotor for seed in range(8)) == list(range(1, 9))


def test_what_a_constant_gain_leaves_is_what_has_another_shape() -> None:
    t = np.linspace(0.0, 1.0, 400)[:, None]
    demands = np.hstack([0.5 + 0.1 * np.sin(7 * t + k) for k in range(4)])
    assert shape_error(demands, 300.0 * demands) == pytest.approx([0.0] * 4, abs=1e-9)
    hysteretic = 300.0 * demands + np.array([0.0, 1.0, 0.0, 2.0]) * np.sign(np.sin(50 * t))
    left = shape_error(demands, hysteretic)
    assert left == pytest.approx([0.0, 1.0, 0.0, 2.0], abs=0.05)


def test_steady_loads_are_the_plants_own_at_rest() -> None:
    plant = Plant(read_vehicle(AIRFRAME), read_pair(EXAMPLES / "rotor_paper.toml"))
    plant.state[2] = -100.0
    u = np.linspace(0.4, 0.7, 8)
    plant.advance(u, 400)  # twenty lags: the speeds are there, the vehicle has hardly begun to move
    thrust, roll, pitch, yaw = steady(plant, u[None])[0]
    v = plant.vehicle
    assert thrust == pytest.approx(plant.thrust.sum(), rel=1e-4)
    assert roll == pytest.approx(-(v.position_m[:, 1] @ plant.thrust), rel=1e-3)
    assert pitch == pytest.approx(v.position_m[:, 0] @ plant.thrust, rel=1e-3)
    assert yaw == pytest.approx(v.spin @ plant.torque, rel=1e-3)
