"""Motor heating: a warm winding has more resistance, and its motor turns slower at the same throttle.

Source: copper's temperature coefficient in the first-order motor model (Drela, First-Order DC Electric Motor
Model, 2007). Heat that was not logged is worked out from the throttle: a first-order answer to its cube.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.drive import LOAD, drivable, drive, loaded, turn
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_CHANNELS, StandFrame

HEAT_S = (30.0, 100.0, 300.0, 1000.0)
# of speed in 100 K: remanence falls by 0.12 % a kelvin (NdFeB) to 0.2 % (ferrite; IEC 60404-8-1), and speed
# without load goes with its inverse; a case is cooler than what is inside by up to a third (judgement)
MAGNETS = (-0.3, 0.0)


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


def magnet_shapes(frame: StandFrame) -> Sequence[Shape]:
    """Magnets that weaken with heat more than windings resist: a warm motor turns faster."""
    return [{"magnets": 1.0}] if frame.context("motor_temperature_C") is not None else []


def one_motor_shapes(frame: StandFrame) -> Sequence[Shape]:
    """One motor of the pair that warms up, a worn bearing's or a short one's: 0 the upper, 1 the lower."""
    return [{**shape, "side": float(side)} for shape in _heat_shapes(frame) for side in (0, 1)]


LOSSES = ("speed_loss_per_100K", "own_speed_loss")
OWN_S = (20.0, 60.0, 180.0)  # starts of the fit: windings of motors of 0.1 to 1 kg (judgement)


def winding_shapes(frame: StandFrame) -> Sequence[Shape]:
    """Windings above the case that carries the thermometer, each motor's by its own power.

    Two nodes, winding and case (Mellor, Roberts and Turner 1991).
    """
    if frame.context("motor_temperature_C") is None:
        return []
    return [{"own_s": s} for s in OWN_S]


def _own_heat(frame: StandFrame, memory_s: float) -> Array:
    """(rows, 2) what each motor is above the case, of the most at full throttle: lags behind its power, u^3.

    Between runs, a gap in time, it falls to nothing as fast.
    """
    power, step = drive(frame) ** 3, np.diff(frame.time_s, prepend=frame.time_s[:1])
    usual = float(np.median(step))
    keep = np.exp(-np.maximum(step, 0.0) / memory_s)
    took = 1.0 - np.exp(-np.clip(step, 0.0, 2.0 * usual) / memory_s)
    out = np.empty_like(power)
    for side in (0, 1):  # by plain numbers: a search asks for it hundreds of times
        now, states = 0.0, []
        for k, added in zip(keep.tolist(), (took * power[:, side]).tolist(), strict=True):
            now = now * k + added
            states.append(now)
        out[:, side] = states
    return out


def _heat_cause(frame: StandFrame, shape: Shape, channel: str) -> tuple[str, Array]:
    if "memory_s" in shape:
        return "heat put in", _heat(frame, shape)
    if "own_s" in shape:
        own = _own_heat(frame, shape["own_s"])
        return "motor_temperature_C", own[:, 1 if channel.startswith("lower") else 0]
    return "motor_temperature_C", 25.0 + 100.0 * _heat(frame, shape)


def _heat_refuse(p: Mapping[str, float]) -> str | None:
    # windings and magnets, of a motor and of its case, which shows the mean of both: of either sign
    low, high = (MAGNETS[0], 1.0) if "own_s" in p else MAGNETS if "magnets" in p else (0.0, 1.0)
    return outside("speed_loss_per_100K", p["speed_loss_per_100K"], low, high) or outside(
        "own_speed_loss", p.get("own_speed_loss", 0.0), low, high
    )


def _felt(p: Numbers, heat: Array) -> Array:
    """Of heat in 100 K over 25 C: resistance in series, each kelvin tells less."""
    return np.asarray(heat / (1.0 + p.get("fading", 0.0) * heat))


def _heat_columns(frame: StandFrame, shape: Shape) -> Array:
    if "own_s" in shape:
        heat = [_heat(frame, {})[:, None], _own_heat(frame, shape["own_s"])]
        felt_at = loaded(drive(frame), shape)
        return np.stack([frame.slowed(-felt_at * h) for h in heat], axis=-1)
    felt = np.tile(_felt(shape, _heat(frame, shape))[:, None], 2)
    if "side" in shape:
        felt[:, 1 - round(shape["side"])] = 0.0
    return frame.slowed(-loaded(drive(frame), shape) * felt)[..., None]


def _heat_free(_: StandFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    if "own_s" in shape:
        return {"own_s": (5.0, 1000.0)} | ({"load": LOAD} if "load" in shape else {})
    return {"load": LOAD, "fading": (-0.5, 2.0)} if "load" in shape else {}


def _heat_variants(_: StandFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    if "own_s" in shape:
        return [] if "load" in shape else [({**shape, "load": 0.1}, c)]
    return [] if "load" in shape else [({**shape, "load": 0.1, "fading": 0.1}, c)]


STAND: Tracing[StandFrame] = Tracing(
    name="motor_heating",
    stage=1,
    physics="a warm winding has more resistance and its motor turns slower at the same throttle",
    source="copper's temperature coefficient in the first-order motor model (Drela 2007)",
    needs=("motor_temperature_C",),
    channels=STAND_CHANNELS,
    units={"speed_loss_per_100K": "1", "memory_s": "s", "load": "1", "fading": "1", "magnets": "1"}
    | {"own_s": "s", "own_speed_loss": "1", "side": "1"},
    missing=_no_heat,
    shapes=lambda frame: [
        *_heat_shapes(frame),
        *magnet_shapes(frame),
        *winding_shapes(frame),
        *one_motor_shapes(frame),
    ],
    columns=_heat_columns,
    parameters=lambda _, shape, c: {**dict(zip(LOSSES, map(float, c), strict=False)), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k not in LOSSES},
        np.array([p[name] for name in LOSSES if name in p]),
    ),
    refuse=_heat_refuse,
    cause=_heat_cause,
    free=_heat_free,
    variants=_heat_variants,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    degrees = vehicle.at.motor_temperature_C
    if degrees is None or "memory_s" in p:
        raise LeftOut(_TEMPERATURE_UNKNOWN)
    if "side" in p:
        raise LeftOut(_ONE_MOTOR)
    felt = float(_felt(p, np.array((degrees - 25.0) / 100.0)))
    factor = 1.0 - p["speed_loss_per_100K"] * felt
    turn(vehicle, factor, p, "motor_temperature_C", degrees)
    return f"commands for windings at {degrees:.0f} C, where rotors turn at {factor:.3f} of them"


_ONE_MOTOR = "one motor of the stand's pair is hot: a fault of that motor, not of its kind"
_TEMPERATURE_UNKNOWN = "speed follows the winding's temperature, which no mixer knows"
EFFECT = PhysicalEffect(
    name="motor_heating",
    stage=Stage.DRIVE,
    parameters=(
        Parameter("speed_loss_per_100K", "1", MAGNETS[0], 1.0, (0.05, 0.05),
            source="39 % more resistance of copper for 100 K, times the tenth of the voltage assumed to "
                   "fall over it; less than nothing where magnets weaken more (IEC 60404-8-1)"),
        Parameter("own_s", "s", 5.0, 1000.0,
            source="wide: any value between the bounds; windings follow their current within minutes"),
        Parameter("own_speed_loss", "1", MAGNETS[0], 1.0, (0.0, 0.05),
            source="as for the case, of a winding at most 100 K above it"),
        Parameter("magnets", "1", 0.0, 1.0,
            source="a switch, 0 or 1: magnets weaken more than windings resist"),
        Parameter("side", "1", 0.0, 1.0,
            source="a number of the pair's rotors (0 upper, 1 lower), each as likely"),
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
    no_static=_TEMPERATURE_UNKNOWN,
    no_live=_TEMPERATURE_UNKNOWN,
)  # fmt: skip
