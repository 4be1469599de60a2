"""Motor heating: a warm winding has more resistance, and its motor turns slower at the same throttle.

Source: copper's temperature coefficient in the first-order motor model (Drela, First-Order DC Electric Motor
Model, 2007). Heat that was not logged is worked out from the throttle: a first-order answer to its cube.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drivable, drive, loaded, turn
from coaxlink.effects.static import LeftOut, StaticBench
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_CHANNELS, StandFrame

HEAT_S = (30.0, 100.0, 300.0, 1000.0)


def _heat(frame: StandFrame, shape: Shape) -> Array:
    """(rows,) winding temperature over 25 C in 100 K, or a first-order answer to u^3 if none was logged."""
    if "memory_s" not in shape:
        logged = frame.context("motor_temperature_C")
        assert logged is not None
        return (logged - 25.0) / 100.0
    from scipy.signal import lfilter

    power = np.sum(drive(frame) ** 3, axis=1)
    step = float(np.median(np.diff(frame.time_s)))
    share = 1.0 - np.exp(-step / shape["memory_s"])
    return np.asarray(lfilter([share], [1.0, share - 1.0], power))


def _no_heat(frame: StandFrame) -> str | None:
    logged = frame.context("motor_temperature_C")
    if logged is not None and np.ptp(logged) < 3.0:
        return f"motor_temperature_C moves by only {np.ptp(logged):.1f} K"
    # heat that was not logged is worked out from the throttle
    return None if logged is not None else drivable(frame)


def _heat_shapes(frame: StandFrame) -> Sequence[Shape]:
    if frame.context("motor_temperature_C") is not None:
        return [{}]
    span = float(np.ptp(frame.time_s))
    return [{"memory_s": s} for s in HEAT_S if s < span] or [{"memory_s": HEAT_S[0]}]


def _felt(p: Numbers, heat: Array) -> Array:
    """Of heat in 100 K over 25 C: resistance in series, each kelvin tells less."""
    return np.asarray(heat / (1.0 + p.get("fading", 0.0) * heat))


def _heat_columns(frame: StandFrame, shape: Shape) -> Array:
    felt = _felt(shape, _heat(frame, shape))
    return frame.slowed(-loaded(drive(frame), shape) * felt[:, None])[..., None]


def _heat_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    return {"load": LOAD, "fading": (-0.5, 2.0)} if "load" in shape else {}


def _heat_finer(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    return [] if "load" in shape else [({**shape, "load": 0.1, "fading": 0.1}, c)]


STAND: Tracing[StandFrame] = Tracing(
    name="motor_heating",
    stage=1,
    physics="a warm winding has more resistance and its motor turns slower at the same throttle",
    source="copper's temperature coefficient in the first-order motor model (Drela 2007)",
    needs=("motor_temperature_C",),
    channels=STAND_CHANNELS,
    units={"speed_loss_per_100K": "1", "memory_s": "s", "load": "1", "fading": "1"},
    missing=_no_heat,
    shapes=_heat_shapes,
    columns=_heat_columns,
    parameters=lambda _, shape, c: {"speed_loss_per_100K": float(c[0]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k in ("memory_s", "load", "fading")},
        np.array([p["speed_loss_per_100K"]]),
    ),
    refuse=lambda p: outside("speed_loss_per_100K", p["speed_loss_per_100K"], 0.0, 1.0),
    cause=lambda frame, shape, _: (
        "heat put in" if "memory_s" in shape else "motor_temperature_C",
        _heat(frame, shape) if "memory_s" in shape else 25.0 + 100.0 * _heat(frame, shape),
    ),
    free=_heat_free,
    finer=_heat_finer,
)


def _static(bench: StaticBench, p: Numbers) -> str:
    degrees = bench.at.motor_temperature_C
    if degrees is None or "memory_s" in p:
        raise LeftOut(_NOT_TOLD)
    felt = float(_felt(p, np.array((degrees - 25.0) / 100.0)))
    factor = 1.0 - p["speed_loss_per_100K"] * felt
    turn(bench, factor, p, "motor_temperature_C", degrees)
    return f"commands for windings at {degrees:.0f} C, where rotors turn at {factor:.3f} of them"


_NOT_TOLD = "speed follows the winding's temperature, which no mixer knows"
EFFECT = PhysicalEffect(
    name="motor_heating",
    stage=Stage.DRIVE,
    parameters=(
        Parameter("speed_loss_per_100K", "1", 0.0, 1.0, (0.05, 0.05),
            source="39 % more resistance of copper for 100 K, times the tenth of the voltage assumed to "
                   "fall over it"),
        Parameter("memory_s", "s", 1.0, 10_000.0,
            source="wide: any value between the bounds; windings warm within a minute, cases within a "
                   "quarter of an hour"),
        Parameter("load", "1", *LOAD,
            source="wide: any value between the bounds; how resistance and load share the fall of speed "
                   "goes with the motor"),
        Parameter("fading", "1", -0.5, 2.0,
            source="wide: any value between the bounds; current falls with the speed, and heat with it"),
    ),
    stand=STAND,
    static=_static,
    required=("speed_loss_per_100K",),
    no_static=_NOT_TOLD,
    no_live=_NOT_TOLD,
)  # fmt: skip
