"""What a mixer table can do about an effect, and what it cannot.

A PX4 table holds a thrust coefficient, a moment ratio and a place for every rotor (CA_ROTORn_CT, _KM, _PX,
_PY): a weak rotor, a shifted centre of mass and a sagged supply fit into it. What depends on speed, height or
time does not: that needs the live mixer or a controller.

A fitted table's coefficients are slopes of a pair, not thrusts of a rotor (the wake is in them). So each
moves by what the effects take from its rotor in the new hover, per unit of its set-point; the rest stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.residual.result import FoundEffect
from coaxlink.rotor import RotorModel
from firmware_params import px4

Array = NDArray[np.float64]

Table = dict[str, float | int]
ROUNDS = 12
CANNOT = {
    "rotor_drag": "drag follows the airspeed: no mixer table knows it; a controller's feed-forward can",
    "wind": "wind is no property of the vehicle; the position controller carries it",
    "axial_inflow": "thrust follows the climb speed: a static table cannot, a live mixer told the climb can",
    "ground_effect": "thrust follows the height: a static table cannot, a live mixer told the height can",
    "rotor_lag": "a table is static: only a lead filter or softer gains answer a slower rotor",
    "rotor_inertia_torque": "the reaction lasts only while speeds change: a static table cannot hold it",
}


@dataclass(frozen=True)
class Compensation:
    """A table and an airframe that know the effects they can, and the effects they cannot."""

    params: Table
    airframe: Airframe
    done: tuple[str, ...]
    cannot: Mapping[str, str]


@dataclass(frozen=True)
class _Gains:
    """What the effects make of every rotor: factors on speed, thrust and torque, each (N,)."""

    speed: Array
    thrust: Array
    torque: Array


def compensate(
    params: Mapping[str, float | int],
    airframe: Airframe,
    model: RotorModel,
    effects: Sequence[FoundEffect],
    *,
    voltage_V: float | None = None,  # what the pack gave on average in the log
) -> Compensation:
    """Put the effects into a PX4 table. Unknown effects are listed as not compensated."""
    table: Table = dict(params)
    count = len(airframe.rotors)
    gains = _Gains(np.ones(count), np.ones(count), np.ones(count))
    done: list[str] = []
    cannot: dict[str, str] = {}
    for effect in effects:
        numbers = {p.name: p.value for p in effect.parameters}
        if effect.name == "degraded_rotor":
            rotor = int(numbers["rotor"]) - 1
            gains.thrust[rotor] *= max(1.0 - numbers["thrust_loss"], 0.05)
            gains.torque[rotor] *= max(1.0 - numbers["torque_loss"], 0.05)
        elif effect.name == "cg_offset":
            shift = (numbers["offset_x_m"], numbers["offset_y_m"])
            _shift(table, count, shift)
            airframe = _moved(airframe, shift)
        elif effect.name == "mass_change":
            airframe = replace(airframe, mass_kg=numbers["mass_kg"])
        elif effect.name == "battery_voltage" and voltage_V is not None:
            gains.speed[:] *= (voltage_V / numbers["reference_voltage_V"]) ** numbers["speed_exponent"]
        else:
            cannot[effect.name] = CANNOT.get(effect.name, "a mixer table has no number for it")
            continue
        done.append(effect.name)
    if any(np.any(g != 1.0) for g in (gains.speed, gains.thrust, gains.torque)):
        table = _with_gains(table, params, airframe, model, gains)
    return Compensation(table, airframe, tuple(done), cannot)


def _with_gains(
    table: Table, original: Mapping[str, float | int], airframe: Airframe, model: RotorModel, gains: _Gains
) -> Table:
    """The table whose coefficients have lost what the effects take from each rotor in its hover."""
    count = len(airframe.rotors)
    ct, km = (np.array([float(original[f"CA_ROTOR{n}_{k}"]) for n in range(count)]) for k in ("CT", "KM"))
    out = dict(table)
    for _ in range(ROUNDS):  # the hover changes with the coefficients
        thrust, torque = _taken_per_setpoint(out, airframe, model, gains)
        new_ct = np.maximum(ct - thrust, 0.1 * ct)
        new_km = np.sign(km) * np.maximum(np.abs(km) * ct - torque, 0.0) / new_ct
        for n in range(count):
            out[f"CA_ROTOR{n}_CT"], out[f"CA_ROTOR{n}_KM"] = float(new_ct[n]), float(new_km[n])
    return out


def _taken_per_setpoint(
    table: Mapping[str, float | int], airframe: Airframe, model: RotorModel, gains: _Gains
) -> tuple[Array, Array]:
    """Thrust (N,) and torque (N,) that the effects take from every rotor per unit set-point, in hover."""
    mix = px4.realise(table)
    effectiveness, column = np.asarray(mix.effectiveness), np.asarray(mix.mix)[:, 5]
    lift = float(effectiveness[5] @ column)
    setpoint = np.clip(-airframe.mass_kg * 9.80665 / lift * column, 0.02, 1.0)
    factor = float(table.get("THR_MDL_FAC", 0.0))
    linear = 1.0 - factor
    root = np.sqrt(linear**2 + 4.0 * factor * setpoint)
    command = (root - linear) / (2.0 * factor) if factor > 1e-6 else setpoint
    thrust, torque = airframe.loads(model, command)
    slow_thrust, slow_torque = airframe.loads(model, command * gains.speed)
    taken = thrust - slow_thrust * gains.thrust, torque - slow_torque * gains.torque
    return taken[0] / setpoint, taken[1] / setpoint


def _shift(table: Table, rotors: int, shift: tuple[float, float]) -> None:
    for n in range(rotors):
        for axis, offset in zip("XY", shift, strict=True):
            table[f"CA_ROTOR{n}_P{axis}"] = table[f"CA_ROTOR{n}_P{axis}"] - offset


def _moved(airframe: Airframe, shift: tuple[float, float]) -> Airframe:
    rotors = tuple(
        replace(
            r,
            position_m=(r.position_m[0] - shift[0], r.position_m[1] - shift[1], r.position_m[2]),
        )
        for r in airframe.rotors
    )
    return replace(airframe, rotors=rotors)
