"""A table that knows an effect delivers what it means: weak rotor, shifted mass, sagged supply."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.link.tables import report_px4
from coaxlink.residual.compensate import compensate
from coaxlink.residual.result import FoundEffect, ParameterValue
from coaxlink.rotor import load_rotor_model
from firmware_params import px4


def found(name: str, **numbers: float) -> FoundEffect:
    values = tuple(ParameterValue(k, v, (v, v), "") for k, v in numbers.items())
    return FoundEffect(name, (), values, {}, {}, "")


@pytest.fixture(scope="module")
def vehicle():
    airframe = load_airframe(files.example("x8_demo.toml"))
    model = load_rotor_model(files.example("rotor_paper.toml"))
    return airframe, model, report_px4(airframe, model, "fitted").params


def miss(table, airframe, model, *, thrust=1.0, speed=1.0, shift=(0.0, 0.0)) -> np.ndarray:
    """|meant - delivered| [thrust, roll, pitch, yaw] in this table's own hover, the world bent as told."""
    effect = np.asarray(px4.realise(table).effectiveness)
    mix = np.asarray(px4.realise(table).mix)[:, 5]
    setpoint = -20 * 9.80665 / float(effect[5] @ mix) * mix
    f = table["THR_MDL_FAC"]
    u = (-(1 - f) + np.sqrt((1 - f) ** 2 + 4 * f * setpoint)) / (2 * f)
    pull, drag = airframe.loads(model, u * speed)
    pull = pull * thrust
    place = np.array([r.position_m for r in airframe.rotors])[:, :2] - shift
    spin = np.array([r.yaw_sign for r in airframe.rotors])
    got = np.array([pull.sum(), -place[:, 1] @ pull, place[:, 0] @ pull, spin @ drag])
    meant = effect @ setpoint
    return np.abs(got - np.array([-meant[5], *meant[:3]]))


def test_a_weak_rotor_is_allocated_around(vehicle):
    airframe, model, params = vehicle
    weak = np.ones(8)
    weak[2] = 0.7
    before = miss(params, airframe, model, thrust=weak)
    made = compensate(
        params, airframe, model, [found("degraded_rotor", rotor=3, thrust_loss=0.3, torque_loss=0.0)]
    )
    after = miss(made.params, airframe, model, thrust=weak)
    assert made.done == ("degraded_rotor",) and not made.cannot
    assert before[0] > 4.0 and before[1] > 0.7
    assert after[0] < 0.1 * before[0] and after[1] < 0.15 * before[1] and after[2] < 0.15 * before[2]


def test_a_shifted_mass_is_trimmed(vehicle):
    airframe, model, params = vehicle
    shift = (0.01, -0.006)
    before = miss(params, airframe, model, shift=shift)
    made = compensate(params, airframe, model, [found("cg_offset", offset_x_m=0.01, offset_y_m=-0.006)])
    after = miss(made.params, airframe, model, shift=shift)
    assert before[2] > 1.5 and after[2] < 0.1 * before[2] and after[1] < 0.1 * before[1]
    assert made.airframe.rotors[0].position_m[0] == pytest.approx(airframe.rotors[0].position_m[0] - 0.01)


def test_a_sagged_supply_is_met(vehicle):
    airframe, model, params = vehicle
    slow = (22.5 / 25.0) ** 0.6
    before = miss(params, airframe, model, speed=slow)
    effect = found("battery_voltage", speed_exponent=0.6, reference_voltage_V=25.0)
    made = compensate(params, airframe, model, [effect], voltage_V=22.5)
    assert miss(made.params, airframe, model, speed=slow)[0] < 0.1 * before[0]


def test_what_a_table_cannot_hold_is_said(vehicle):
    airframe, model, params = vehicle
    made = compensate(params, airframe, model, [found("rotor_drag"), found("ground_effect")])
    assert made.params == params and set(made.cannot) == {"rotor_drag", "ground_effect"}
