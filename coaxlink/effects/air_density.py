"""Air density: thrust and torque are proportional to the density of the air.

Source: blade element theory; ideal gas. Torque may go by another power than thrust: profile drag has a
Reynolds number too. Either is written about the density at which the nuisance model holds, to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.constants import (
    GAS_CONSTANT_J_KG_K,
    STANDARD_PRESSURE_PA,
    STANDARD_TEMPERATURE_K,
    ZERO_CELSIUS_K,
)
from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import MOST_OF_THRUST, LiveView, Part, nothing
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_LOADS, StandFrame
from coaxlink.signals import without_row_noise

AIR = (0.1, 2.0)  # kg/m^3, at 20 km and in the deepest frost: what reads anything else is no barometer
OVER = (-0.12, -0.06, 0.0, 0.06, 0.12)  # of the log's median density: where a given model holds


def density(frame: StandFrame) -> Array | None:
    """(rows,) air density in kg/m^3 from temperature and pressure; a missing one is the standard's.

    The air of a room changes slower than rows come: what trembles from row to row is the sensors' own.
    """
    t, p = (_calm(frame, name) for name in ("air_temperature_C", "air_pressure_Pa"))
    if t is None and p is None:
        return None
    celsius = STANDARD_TEMPERATURE_K - ZERO_CELSIUS_K if t is None else t
    return np.broadcast_to(
        density_of(STANDARD_PRESSURE_PA if p is None else p, celsius), (len(frame.time_s),)
    )


def _calm(frame: StandFrame, name: str) -> Array | None:
    values, log = frame.context(name), frame.context("log")
    if values is None:
        return None
    ends = (0, *(() if log is None else np.flatnonzero(np.diff(log)) + 1), len(values))
    return _calmed(np.asarray(values, float).tobytes(), tuple(map(int, ends)))


@lru_cache(maxsize=8)
def _calmed(values: bytes, ends: tuple[int, ...]) -> Array:
    """(rows,) of each log's own rows; read-only: a search asks for the same air again and again."""
    own = np.frombuffer(values)
    out = np.concatenate([without_row_noise(own[a:b]) for a, b in pairwise(ends)])
    out.setflags(write=False)
    return out


def density_of(pressure_Pa: ArrayLike, temperature_C: ArrayLike) -> Array:
    """Density of dry air, kg/m^3."""
    kelvin = np.asarray(temperature_C, float) + ZERO_CELSIUS_K
    return np.asarray(np.asarray(pressure_Pa, float) / (GAS_CONSTANT_J_KG_K * kelvin))


def load_gains(p: Numbers, density: ArrayLike) -> tuple[Array, Array]:
    """Thrust and torque over those at the density where the nuisance model holds."""
    over = (1.0 + p.get("over", 0.0)) * (np.asarray(density) / p["reference_density_kg_m3"] - 1.0)
    thrust = p["density_exponent"]
    return np.asarray(1.0 + thrust * over), np.asarray(1.0 + p.get("torque_exponent", thrust) * over)


def _no_air(frame: StandFrame) -> str | None:
    rho = density(frame)
    if rho is None:
        return "neither air_temperature_C nor air_pressure_Pa is in the log"
    middle = float(np.median(rho))
    if not AIR[0] < middle < AIR[1]:
        return f"the air's density reads {middle:.2g} kg/m3: no air has that"
    spread = float(np.ptp(np.quantile(rho, [0.02, 0.98])) / middle)
    return None if spread > 0.004 else f"the air's density moves by only {100 * spread:.1f} %"


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    if why := _no_air(frame):
        raise NotShown(why)
    places: Sequence[Numbers] = [{}] if frame.free_nuisance else [{"over": o} for o in OVER]
    return [{"density_exponent": 1.0, **place} for place in places]


def _further(_: StandFrame, p: Numbers) -> Sequence[Numbers]:
    """Torque by a power of its own: profile drag has a Reynolds number too."""
    return [] if "torque_exponent" in p else [{**p, "torque_exponent": p["density_exponent"]}]


def _known_density(frame: StandFrame) -> Array:
    rho = density(frame)
    assert rho is not None
    return rho


def _adds(frame: StandFrame, p: Numbers) -> Array:
    out = np.zeros((len(frame.time_s), 6))
    for k, gain in enumerate(load_gains(p, _known_density(frame))):
        out[:, k:4:2] = frame.predicted[:, k:4:2] * (gain - 1.0)[:, None]
    return out


def _reference(frame: StandFrame, p: Numbers) -> float:
    """Where the nuisance model holds."""
    return float(np.median(_known_density(frame))) * (1.0 + p.get("over", 0.0))


STAND: Tracing[StandFrame] = Tracing(
    needs=("air_temperature_C", "air_pressure_Pa"),
    channels=STAND_LOADS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, *_: ("air density, kg/m3", _known_density(frame)),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    if "reference_density_kg_m3" not in p:
        raise LeftOut(_NO_REFERENCE)
    rho = vehicle.at.air_density_kg_m3
    if rho is None:
        raise LeftOut(_NEEDS_DENSITY)
    thrust, torque = load_gains(p, rho)
    vehicle.thrust *= thrust
    vehicle.torque *= torque
    return f"thrust {100 * float(thrust - 1.0):+.1f} % in air of {rho:.3f} kg/m3"


def _live(view: LiveView, p: Numbers) -> Part:
    if "reference_density_kg_m3" not in p:
        raise LeftOut(_NO_REFERENCE)

    def part(speeds: Sequence[float]) -> Array:
        pressure, heard = view.reading("pressure"), view.reading("air")
        celsius = view.air_temperature_C if heard is None else heard
        if pressure is None or celsius is None:
            return nothing()
        if not (PRESSURE_PA[0] < pressure < PRESSURE_PA[1] and AIR_C[0] < celsius < AIR_C[1]):
            return nothing()
        gains = load_gains(p, density_of(pressure, celsius))
        more = [min(max(float(gain) - 1.0, -MOST_OF_THRUST), MOST_OF_THRUST) for gain in gains]
        thrust, torque = view.loads(speeds)
        return view.wrench_of(more[0] * thrust, more[1] * torque)

    return part


PRESSURE_PA, AIR_C = (30e3, 115e3), (-60.0, 60.0)  # where vehicles fly: beyond, a sensor is broken
_NO_REFERENCE = "the file does not say at which density its base holds"
_NEEDS_DENSITY = (
    "loads follow the air's density: a static mixer needs it stated (`air_density_kg_m3`), live mixing takes "
    "it from the barometer and an air temperature"
)
EFFECT = PhysicalEffect(
    name="air_density",
    stage=Stage.AIR,
    physics="thrust and torque are proportional to the density of the air",
    source="blade element theory; ideal gas",
    parameters=(
        *(Parameter(name, "1", 0.3, 1.8, (1.0, 0.1), amount=True,
            source="blade element theory: 1; 0.1 is assumed for what Reynolds number does")
          for name in ("density_exponent", "torque_exponent")),
        Parameter("over", "1", -0.25, 0.25, (0.0, 0.1), moves=True,
            source="standard atmosphere: 1000 m of height or 30 K between the stand and the log are 10 %"),
        Parameter("reference_density_kg_m3", "kg/m3", 0.3, 1.8, (1.2, 0.1), follows=_reference,
            source="standard atmosphere (ISO 2533): 1.1 to 1.3 from 0 to 1000 m and from 0 to 35 C"),
    ),
    stand=STAND,
    static=_static,
    live=_live,
    required=("density_exponent",),
    messages={"SCALED_PRESSURE": 1.0, "HIGHRES_IMU": 50.0},
)  # fmt: skip
