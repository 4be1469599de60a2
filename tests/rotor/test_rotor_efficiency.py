"""Eq. 5: from a log whose watts are known, and from a model whose splits can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rotor_bench import TRUTH

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.rotor import RotorModel
from coaxlink.rotor.efficiency import measured_efficiency, shaft_power, split_curves


def model(*terms: dict[str, float]) -> RotorModel:
    return RotorModel.from_terms("crm", 3000.0, dict(zip(TRUTH, terms, strict=True)))


def log(**more: list[float]) -> Samples:
    """A row that works and one at rest."""
    columns = {
        "upper_rpm": [3000, 0],
        "lower_rpm": [1500, 0],
        "upper_thrust_N": [20, 0],
        "lower_thrust_N": [10, 0],
    }
    torques = {"upper_torque_Nm": [0.5, 0.0], "lower_torque_Nm": [0.4, 0.0]}
    return Samples({k: np.array(v, float) for k, v in {**columns, **torques, **more}.items()}, "log.csv")


def test_measured_efficiency_by_hand() -> None:
    volts = {"voltage_V": [20.0, 20.0], "lower_voltage_V": [10.0, 20.0]}
    found = measured_efficiency(log(**volts, upper_current_A=[10.0, 0], lower_current_A=[8.0, 0]))
    shaft = 0.5 * 100 * math.pi + 0.4 * 50 * math.pi
    assert found.propeller[0] == pytest.approx(30 / shaft)
    assert found.motor is not None and found.motor[0] == pytest.approx(shaft / 280)
    assert found.overall is not None and found.overall[0] == pytest.approx(30 / 280)
    assert np.isnan(found.propeller[1]) and np.isnan(found.overall[1])


def test_without_current_only_the_propeller_is_known() -> None:
    found = measured_efficiency(log(voltage_V=[20.0, 20.0]))
    assert found.motor is None and found.overall is None and found.propeller[0] > 0
    with pytest.raises(InputError, match="lower_torque_Nm"):
        measured_efficiency(
            Samples({k: c for k, c in log().columns.items() if k != "lower_torque_Nm"}, "log.csv")
        )


def test_two_equal_rotors_that_do_not_meet_share_equally() -> None:
    """f = k u^2 and tau = c u^2 each: power goes with u^3, least at equal speeds, which are equal thrusts."""
    same = model({"u_u^2": 50.0}, {"u_u^2": 1.0}, {"u_l^2": 50.0}, {"u_l^2": 1.0})
    for split in split_curves(same, [25.0, 64.0]):
        np.testing.assert_allclose(split.upper, np.sqrt(np.array([25.0, 64.0]) / 100), rtol=1e-3)
        np.testing.assert_allclose(split.lower, split.upper, rtol=1e-3)
        u = 0.8
        assert split.propeller[1] == pytest.approx(64 / (2 * u**3 * 100 * math.pi), rel=1e-5)


def test_splits_give_the_thrust_and_least_power_is_least() -> None:
    pair = model(*TRUTH.values())
    thrust = np.linspace(20, 75, 6)
    equal, halves, least = split_curves(pair, thrust)
    for split in (equal, halves, least):
        loads = pair.loads(split.upper, split.lower)
        np.testing.assert_allclose(loads.upper_thrust + loads.lower_thrust, thrust, rtol=1e-6)
    np.testing.assert_allclose(equal.upper, equal.lower)
    loads = pair.loads(halves.upper, halves.lower)
    np.testing.assert_allclose(loads.upper_thrust, loads.lower_thrust, rtol=1e-6)
    power = [shaft_power(pair, s.upper, s.lower) for s in (equal, halves, least)]
    assert (power[2] <= power[0]).all() and (power[2] <= power[1] + 1e-6).all()
    grid = np.linspace(0.02, 1, 300)
    u, v = np.meshgrid(grid, grid)
    loads = pair.loads(u, v)
    near = np.abs(loads.upper_thrust + loads.lower_thrust - thrust[3]) < 0.2
    assert shaft_power(pair, u, v)[near].min() > 0.985 * power[2][3]


def test_hover_of_the_paper_needs_the_least_power_split() -> None:
    """49.05 N a pair: u = 0.441 / 0.648 by an independent solver (SLSQP); 500 N cannot be had."""
    least = split_curves(model(*TRUTH.values()), [49.05, 500.0])[2]
    np.testing.assert_allclose((least.upper[0], least.lower[0]), (0.441, 0.648), atol=0.01)
    assert np.isnan((least.upper[1], least.lower[1], least.propeller[1])).all()
