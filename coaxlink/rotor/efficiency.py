"""Efficiency of a coaxial pair over its thrust (Berra, Trujillo and Heredia 2024, eq. 5 and Fig. 5).

propeller   f / (tau_u w_u + tau_l w_l)                     N per shaft watt
motor       (tau_u w_u + tau_l w_l) / (V_u I_u + V_l I_l)   shaft watt per electrical watt
overall     f / (V_u I_u + V_l I_l)                         N per electrical watt

f the coaxial thrust, w the speeds in rad/s. Measured from a stand log where it has the columns; from a rotor
model for ways to split a thrust between the rotors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data import Samples
from coaxlink.load import Load
from coaxlink.rotor.model import RotorModel

Array = NDArray[np.float64]
SPLITS = ("equal speeds", "equal thrusts", "least power")
OUT_OF_REACH_W = 1e12  # what a split costs that cannot give the thrust
LEAST_W = 1.0  # below this a watt reading is the instrument's zero


@dataclass(frozen=True)
class Measured:
    """Efficiencies of a stand log's rows; NaN where nothing is driven."""

    thrust_N: Array  # (rows,)
    propeller: Array  # (rows,) N/W
    motor: Array | None  # (rows,) 1, None without voltage and current
    overall: Array | None  # (rows,) N/W, None without voltage and current


@dataclass(frozen=True)
class Split:
    """How one way of sharing a thrust does, by the model."""

    name: str
    thrust_N: Array  # (n,)
    upper: Array  # (n,) normalised speed, NaN where the thrust cannot be had
    lower: Array  # (n,)
    propeller: Array  # (n,) N per shaft watt


def measured_efficiency(samples: Samples) -> Measured:
    """Eq. 5 from the log's own columns. Raises InputError naming a missing speed, thrust or torque."""
    sides = ("upper", "lower")
    samples.require(*(f"{s}_{w}" for s in sides for w in ("rpm", "thrust_N", "torque_Nm")))
    thrust = samples[Load.UPPER_THRUST.column] + samples[Load.LOWER_THRUST.column]
    each = (samples[f"{s}_rpm"] * samples[f"{s}_torque_Nm"] for s in sides)
    shaft = RAD_S_PER_RPM * sum(each, np.zeros(samples.rows))
    upper, lower = (electrical_power(samples, s) for s in sides)
    if upper is None or lower is None:
        return Measured(thrust, _over(thrust, shaft), None, None)
    return Measured(thrust, _over(thrust, shaft), _over(shaft, upper + lower), _over(thrust, upper + lower))


def electrical_power(samples: Samples, side: str) -> Array | None:
    """(rows,) watts into a motor, None where its voltage or current was not measured."""
    volts = next((n for n in (f"{side}_voltage_V", "voltage_V") if samples.has(n)), None)
    if volts is None or not samples.has(f"{side}_current_A"):
        return None
    return np.asarray(samples[volts] * samples[f"{side}_current_A"])


def _over(gain: Array, cost: Array) -> Array:
    spent = cost > LEAST_W
    return np.where(spent, gain / np.where(spent, cost, 1.0), np.nan)


def split_curves(model: RotorModel, thrust_N: ArrayLike) -> tuple[Split, ...]:
    """Each way of SPLITS over coaxial thrusts (n,), within speeds 0..1 of the model."""
    wanted = np.asarray(thrust_N, float)
    finders: dict[str, Callable[[float], tuple[float, float]]] = {
        "equal speeds": lambda f: _on_ray(model, f, 1.0),
        "equal thrusts": lambda f: _equal_thrusts(model, f),
        "least power": lambda f: _least_power(model, f),
    }
    splits = []
    for name in SPLITS:
        speeds = np.array([finders[name](float(f)) for f in wanted]).reshape(-1, 2)
        upper, lower = speeds.T
        efficiency = _over(wanted, shaft_power(model, upper, lower))
        splits.append(Split(name, wanted, upper, lower, efficiency))
    return tuple(splits)


def shaft_power(model: RotorModel, upper: ArrayLike, lower: ArrayLike) -> Array:
    """Watts at both shafts at normalised speeds, broadcast."""
    loads = model.loads(upper, lower)
    u, v = np.asarray(upper, float), np.asarray(lower, float)
    return np.asarray(RAD_S_PER_RPM * model.speed_max_rpm * (loads.upper_torque * u + loads.lower_torque * v))


def _thrust(model: RotorModel, upper: float, lower: float) -> float:
    loads = model.loads(upper, lower)
    return float(loads.upper_thrust + loads.lower_thrust)


def _on_ray(model: RotorModel, thrust: float, ratio: float) -> tuple[float, float]:
    """Speeds with upper = ratio x lower that give the thrust; NaN when speeds up to 1 do not."""
    from scipy.optimize import brentq

    fastest = min(1.0, 1.0 / ratio) if ratio > 0 else 1.0
    if not _thrust(model, 0.0, 0.0) <= thrust <= _thrust(model, ratio * fastest, fastest):
        return math.nan, math.nan
    lower = float(brentq(lambda v: _thrust(model, ratio * v, v) - thrust, 0.0, fastest))
    return ratio * lower, lower


def _equal_thrusts(model: RotorModel, thrust: float) -> tuple[float, float]:
    """Each rotor carries half: what Algorithm 1's pseudo-inverse demands in hover."""
    from scipy.optimize import brentq

    half = thrust / 2
    if not float(model.upper_thrust(0.0)) <= half <= float(model.upper_thrust(1.0)):
        return math.nan, math.nan
    upper = float(brentq(lambda u: float(model.upper_thrust(u)) - half, 0.0, 1.0))
    if not float(model.lower_thrust(upper, 0.0)) <= half <= float(model.lower_thrust(upper, 1.0)):
        return math.nan, math.nan
    return upper, float(brentq(lambda v: float(model.lower_thrust(upper, v)) - half, 0.0, 1.0))


def _least_power(model: RotorModel, thrust: float) -> tuple[float, float]:
    """The split of least shaft power, by the ratio of the speeds."""
    from scipy.optimize import minimize_scalar

    def power(ratio: float) -> float:
        speeds = _on_ray(model, thrust, ratio)
        return OUT_OF_REACH_W if math.isnan(speeds[0]) else float(shaft_power(model, *speeds))

    ratios = np.linspace(0.2, 1.8, 17)
    costs = np.array([power(r) for r in ratios])
    if costs.min() >= OUT_OF_REACH_W:
        return math.nan, math.nan
    best = int(np.argmin(costs))
    low, high = ratios[max(best - 1, 0)], ratios[min(best + 1, len(ratios) - 1)]
    found = minimize_scalar(power, bounds=(low, high), method="bounded", options={"xatol": 1e-5})
    ratio = float(found.x) if found.fun <= costs[best] else float(ratios[best])
    return _on_ray(model, thrust, ratio)
