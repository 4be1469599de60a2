"""The fitted table: what PX4's own law makes of it follows the rotors, at near least power."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import Airframe, load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer.fitted import FittedTable, fit_table, px4_columns
from coaxlink.rotor.model import RotorModel, load_rotor_model
from coaxlink.vehicle import Vehicle
from firmware_params import ardupilot as ap
from firmware_params import px4

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
# mean thrust error to be had, N; a Y6 asks more of one curve
CLOSE = {"x8_paper": 0.05, "coax_tilted": 0.05, "y6": 0.25}


@lru_cache
def fitted(name: str) -> tuple[Airframe, FittedTable]:
    airframe = load_airframe(EXAMPLES / f"{name}.toml")
    return airframe, fit_table(Vehicle(airframe, CRM))


def fresh_wrenches(airframe: Airframe) -> np.ndarray:
    """Wrenches the fit has not seen, in the paper's envelope scaled to the vehicle."""
    scale = airframe.mass_kg / 20.0
    arm = max(float(np.hypot(*r.position_m[:2])) for r in airframe.rotors) / 0.2556
    turn = 4 * scale * arm
    rng = np.random.default_rng(77)
    return rng.uniform([150 * scale, -turn, -turn, -turn / 4], [260 * scale, turn, turn, turn / 4], (150, 4))


@pytest.mark.parametrize("name", CLOSE)
def test_px4s_own_law_delivers_the_wrench(name: str) -> None:
    airframe, table = fitted(name)
    stored = px4.table_to_params(px4_columns(airframe, table))  # as the float32 parameters hold it
    mix = px4.realise(stored)
    assert not mix.warnings
    errors = []
    for thrust, roll, pitch, yaw in fresh_wrenches(airframe):
        control = np.array([roll, pitch, yaw, 0, 0, -thrust]) * mix.scale
        u = mix.throttle(mix.setpoints(control))
        loads = airframe.loads(CRM, u)
        errors.append(airframe.wrench(*loads) - [thrust, roll, pitch, yaw])
    mean = np.abs(errors).mean(axis=0)
    assert mean[0] <= CLOSE[name]
    assert mean[1:3].max() < 0.1
    assert mean[3] < 0.02


def test_on_the_papers_vehicle_it_costs_next_to_no_power_and_keeps_its_ceiling() -> None:
    _, table = fitted("x8_paper")
    assert abs(table.chosen.power_excess) < 0.002
    assert table.chosen.ceiling_N > 400.0
    assert 0.7 < table.curve < 0.75
    shares = [t.share for t in table.trade]
    power = [t.power_excess for t in table.trade]
    assert shares == sorted(shares)
    assert power[-1] > 0.04  # equal columns: what an equal split costs


def test_single_rotors_beside_pairs_are_not_fitted_at_the_price_of_power() -> None:
    table = fit_table(Vehicle(load_airframe(EXAMPLES / "mixed_hexa.toml"), CRM))
    assert table.chosen.error[0] < 0.25
    assert abs(table.chosen.power_excess) < 0.03


@pytest.mark.parametrize(
    "factors",
    [(0.976, 0.960, 0.993, 1.013), (0.971, 1.048, 1.006, 0.948), (1.0, 0.956, 1.058, 1.033)],
    ids=["thrust", "torque", "lower"],
)
def test_a_model_a_little_off_has_as_good_a_table(factors: tuple[float, ...]) -> None:
    # a model updated by flights moves by per cents; its table on itself must not jump
    airframe = load_airframe(EXAMPLES / "y6.toml")
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(CRM.terms().items(), factors, strict=True)
    }
    model = RotorModel.from_terms(CRM.form, CRM.speed_max_rpm, terms)
    thrust, roll, pitch, _ = fit_table(Vehicle(airframe, model)).chosen.error
    assert thrust < 0.3 and max(roll, pitch) < 0.07


def test_ardupilots_own_law_delivers_it_too() -> None:
    airframe = load_airframe(EXAMPLES / "x8_paper.toml")
    table = fit_table(Vehicle(airframe, CRM), spin_min=0.05)
    x, y = np.array([r.position_m[:2] for r in airframe.rotors]).T
    matrix = np.stack([-y * table.ct, x * table.ct, table.yaw, table.ct])
    columns = np.linalg.pinv(matrix)
    top = np.abs(columns).max(axis=0) / [0.5, 0.5, 0.5, 1.0]
    factors = tuple(map(tuple, (columns / top).tolist()))
    motor = ap.MotorParameters(thst_expo=table.curve, spin_min=0.05, spin_max=1.0, spin_arm=0.03)
    mix = ap.realise(ap.ApTable(15, factors, motor, 0))
    errors = []
    for thrust, roll, pitch, yaw in fresh_wrenches(airframe):
        demand = ap.Demand(*(np.array([roll, pitch, yaw, thrust]) * top).tolist())
        u = mix.output(demand).actuator
        errors.append(airframe.wrench(*airframe.loads(CRM, u)) - [thrust, roll, pitch, yaw])
    mean = np.abs(errors).mean(axis=0)
    assert mean[0] < 0.15  # the spin range bends the curve a little more than one factor can follow
    assert mean[1:].max() < 0.05


def test_an_envelope_out_of_reach_is_said() -> None:
    airframe = load_airframe(EXAMPLES / "x8_paper.toml")
    with pytest.raises(InputError, match="cannot fly its envelope"):
        fit_table(Vehicle(airframe, CRM), wrenches=np.array([[900.0, 0, 0, 0]]))
