"""Centre of mass off its declared place: the thrust, which acts where it did, gains a lever arm.

Source: moment of a force about a shifted point, M = -r x F. The declared origin is the centre of mass, so r
is where it really is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import LiveView, Part
from coaxlink.effects.onset import COMES, OVER, onset_limits, since
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, one_shape, outside, present
from coaxlink.frames import FlightFrame


def moment(x_m: float, y_m: float, force: Array) -> Array:
    """(..., 3) N m of forces (..., 3) in N about a centre of mass that lies (x, y) off."""
    return -np.cross([x_m, y_m, 0.0], force)


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    out = np.zeros((len(frame.predicted), 6, 2))
    for k, (x, y) in enumerate(np.eye(2)):
        out[:, 3:, k] = moment(x, y, frame.predicted[:, :3]) * since(frame, shape)[:, None]
    return out


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("offset", float(np.hypot(p["offset_x_m"], p["offset_y_m"])), 0.0, 0.3, "m")


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="cg_offset",
    physics="the centre of mass lies beside the declared one: M = -r x F",
    source="moment of the thrust about a shifted centre of mass",
    needs=("motor1",),
    channels=("torque_x", "torque_y"),
    units={"offset_x_m": "m", "offset_y_m": "m", "onset_s": "s", "over_s": "s"},
    missing=present,
    shapes=one_shape,
    columns=_columns,
    parameters=lambda _, shape, c: {"offset_x_m": float(c[0]), "offset_y_m": float(c[1]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k in COMES},
        np.array([p["offset_x_m"], p["offset_y_m"]]),
    ),
    refuse=_refuse,
    cause=lambda frame, _, channel: ("total_thrust_N", frame.thrust.sum(axis=1)),
    nil=lambda _: {"offset_x_m": 0.0, "offset_y_m": 0.0},
    sudden=True,
    stage=8,
    free=onset_limits,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    x, y = p["offset_x_m"], p["offset_y_m"]
    moved = (
        replace(r, position_m=(r.position_m[0] - x, r.position_m[1] - y, r.position_m[2]))
        for r in vehicle.airframe.rotors
    )
    vehicle.airframe = replace(vehicle.airframe, rotors=tuple(moved))
    forward, right = (round(1e3 * d, 1) + 0.0 for d in (x, y))
    return f"rotor places from the true centre of mass, {forward:+.1f} mm forward, {right:+.1f} mm right"


def _live(view: LiveView, p: Numbers) -> Part:
    x, y = p["offset_x_m"], p["offset_y_m"]

    def part(speeds: Sequence[float]) -> Array:
        total = float(view.wrench_of(*view.loads(speeds))[0])
        return np.concatenate([[0.0], moment(x, y, np.array([0.0, 0.0, -total]))])

    return part


EFFECT = PhysicalEffect(
    name="cg_offset",
    stage=Stage.BODY,
    parameters=(
        Parameter("offset_x_m", "m", -0.3, 0.3, (0.0, 0.01),
            source="assumed: a battery strapped on by hand lies within 10 mm"),
        Parameter("offset_y_m", "m", -0.3, 0.3, (0.0, 0.01),
            source="assumed: a battery strapped on by hand lies within 10 mm"),
        Parameter("onset_s", "s", 0.0, 1e6,
            source="wide: any value between the bounds; the second of the log at which it began"),
        OVER,
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    required=("offset_x_m", "offset_y_m"),
)  # fmt: skip
