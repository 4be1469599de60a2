"""Centre of mass off its declared place: the thrust, which acts where it did, gains a lever arm.

Source: moment of a force about a shifted point, M = -r x F. The declared origin is the centre of mass, so r
is where it really is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import LiveView, Part
from coaxlink.effects.onset import ONSET, since
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Tracing
from coaxlink.frames import FlightFrame


def moment(x_m: float, y_m: float, force: Array) -> Array:
    """(..., 3) N m of forces (..., 3) in N about a centre of mass that lies (x, y) off."""
    return -np.cross([x_m, y_m, 0.0], force)


def _adds(frame: FlightFrame, p: Numbers) -> Array:
    out = np.zeros_like(frame.predicted)
    arm = moment(p["offset_x_m"], p["offset_y_m"], frame.predicted[:, :3])
    out[:, 3:] = arm * since(frame, p)[:, None]
    return out


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("motor1",),
    channels=("torque_x", "torque_y"),
    starts=lambda _: [{"offset_x_m": 0.0, "offset_y_m": 0.0}],
    adds=_adds,
    cause=lambda frame, *_: ("total_thrust_N", frame.thrust.sum(axis=1)),
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
    place=1,
    physics="the centre of mass lies beside the declared one: M = -r x F",
    source="moment of the thrust about a shifted centre of mass",
    parameters=(
        *(Parameter(name, "m", -0.3, 0.3, (0.0, 0.01), amount=True, nil=0.0,
            source="assumed: a battery strapped on by hand lies within 10 mm")
          for name in ("offset_x_m", "offset_y_m")),
        *ONSET,
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    required=("offset_x_m", "offset_y_m"),
)  # fmt: skip
