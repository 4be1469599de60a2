"""Ground effect: near the ground the rotors' inflow falls and the thrust at given speed grows.

Source: Cheeseman and Bennett 1955, T / T_inf = 1 / (1 - (R / 4 h)^2), for which (R / 4 h)^2 is the first
term; for multirotors the effective radius is larger than one rotor's (Sanchez-Cuevas, Heredia and Ollero
2017), and an exponential in height fits flights as well (He, Lee and Leang 2019). Both are tried, the
power of height being free between limits; each rotor feels the height of its own disc, which rights a tilted
vehicle. Close to the ground the gain g grows faster than its first term (Cheeseman's 1 / (1 - g)) or levels
off (Hayden 1976, whose power falls short): g / (1 + b g), b free, is either. Both laws end where the disc is
nearer than half a radius: below a height the gain may stop growing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside
from coaxlink.residual.frames import FlightFrame

SCALES_M = (0.15, 0.2, 0.27, 0.36, 0.48, 0.6, 0.75, 0.95, 1.2, 1.6)
LOWEST_M = 0.08


POWERS = (0.7, 5.0)
BENDS = {"levelling": (-2.5, 6.0), "flat_below_m": (LOWEST_M, 1.0)}


def _height(frame: FlightFrame) -> Array:
    assert frame.height is not None
    return np.maximum(frame.height, LOWEST_M)


def disc_heights(frame: FlightFrame) -> Array:
    """(rows, N) height of every rotor's disc above the ground, m."""
    roll, pitch = frame.attitude[:, 0], frame.attitude[:, 1]
    down = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)
    position = np.array([r.position_m for r in frame.airframe.rotors])
    return np.maximum(_height(frame)[:, None] - down @ position.T, LOWEST_M)


def _missing(frame: FlightFrame) -> str | None:
    if frame.height is None:
        return "height_m is not in the log"
    lowest = float(np.min(frame.height[frame.keep]))
    return None if lowest < 1.5 else f"never below {lowest:.1f} m"


def _shapes(_: FlightFrame) -> Sequence[Shape]:
    return [{"height_power": 2.0}, *({"height_scale_m": s} for s in SCALES_M)]


def _gain(frame: FlightFrame, shape: Shape) -> Array:
    h = np.maximum(disc_heights(frame), shape.get("flat_below_m", LOWEST_M))
    if "height_scale_m" in shape:
        return np.exp(-h / shape["height_scale_m"])
    return (0.25 / h) ** shape.get("height_power", 2.0)


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    thrust = frame.thrust * _gain(frame, shape)
    return frame.airframe.body_loads(thrust, np.zeros_like(thrust))[..., None]


def _parameters(_: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    bend = {k: v for k, v in shape.items() if k in BENDS}
    if "height_scale_m" in shape:
        return {"gain_at_ground": float(c[0]), "height_scale_m": shape["height_scale_m"], **bend}
    power = shape.get("height_power", 2.0)
    radius = float(np.sign(c[0]) * abs(c[0]) ** (1.0 / power))
    return {"effective_radius_m": radius, "height_power": power, **bend}


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    bend = {k: v for k, v in p.items() if k in BENDS}
    if "height_scale_m" in p:
        return {"height_scale_m": p["height_scale_m"], **bend}, np.array([p["gain_at_ground"]])
    power, radius = p.get("height_power", 2.0), p["effective_radius_m"]
    return {"height_power": power, **bend}, np.array([np.sign(radius) * abs(radius) ** power])


def _refuse(p: Mapping[str, float]) -> str | None:
    if "height_scale_m" in p:
        return outside("gain_at_ground", p["gain_at_ground"], 0.0, 3.0)
    return outside("effective_radius_m", p["effective_radius_m"], 0.0, 2.0, "m")


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    shape, c = _inverse(frame, p)
    gain = c[0] * _gain(frame, shape)
    gain = gain / np.maximum(1.0 + shape.get("levelling", 0.0) * gain, 0.3)
    return frame.pulling(frame.thrust * (1.0 + gain), frame.torque)


def _free(_: FlightFrame, shape: Shape) -> Mapping[str, tuple[float, float]]:
    bend = {k: limits for k, limits in BENDS.items() if k in shape}
    if "height_scale_m" in shape:
        return {"height_scale_m": (0.5 * SCALES_M[0], 2.0 * SCALES_M[-1]), **bend}
    return {"height_power": POWERS, **bend}


def _finer(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    sign = np.sign(c[0])
    mine = {k: v for k, v in shape.items() if k not in BENDS}
    other, size = ({"height_scale_m": 0.5}, 0.2) if "height_power" in shape else ({"height_power": 2.0}, 0.1)
    out: list[tuple[Shape, Array]] = [(other, np.array([size * sign]))]
    if "levelling" not in shape:
        out += [({**mine, "levelling": b}, c) for b in (0.3, -0.3)]
    if "flat_below_m" not in shape:
        level = shape.get("levelling", -0.3)
        out += [({**mine, "levelling": level, "flat_below_m": h}, c) for h in (0.35, 0.2, 0.12)]
    return out


FLIGHT: Effect[FlightFrame] = Effect(
    name="ground_effect",
    physics="thrust at given speed grows near the ground",
    source="Cheeseman and Bennett 1955; Sanchez-Cuevas, Heredia and Ollero 2017; He, Lee and Leang 2019",
    needs=("height_m",),
    channels=("force_z",),
    units={
        "gain_at_ground": "1",
        "height_scale_m": "m",
        "effective_radius_m": "m",
        "height_power": "1",
        "levelling": "1",
        "flat_below_m": "m",
    },
    missing=_missing,
    shapes=_shapes,
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=lambda frame, _, channel: ("height_m", _height(frame)),
    nil=lambda _: {"gain_at_ground": 0.0, "effective_radius_m": 0.0},
    stage=4,
    apply=_apply,
    free=_free,
    finer=_finer,
)
