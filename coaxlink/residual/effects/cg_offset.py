"""Centre of mass off its declared place: the thrust, which acts where it did, gains a lever arm.

Source: moment of a force about a shifted point, M = -r x F. The declared origin is the centre of mass, so r
is where it really is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, one_shape, outside, present
from coaxlink.residual.effects.onset import onset_limits, since
from coaxlink.residual.frames import FlightFrame


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    out = np.zeros((len(frame.predicted), 6, 2))
    for k, arm in enumerate(np.eye(3)[:2]):
        out[:, 3:, k] = -np.cross(arm, frame.predicted[:, :3]) * since(frame, shape)[:, None]
    return out


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("offset", float(np.hypot(p["offset_x_m"], p["offset_y_m"])), 0.0, 0.3, "m")


FLIGHT: Effect[FlightFrame] = Effect(
    name="cg_offset",
    physics="the centre of mass lies beside the declared one: M = -r x F",
    source="moment of the thrust about a shifted centre of mass",
    needs=("motor1",),
    channels=("torque_x", "torque_y"),
    units={"offset_x_m": "m", "offset_y_m": "m", "onset_s": "s"},
    missing=present,
    shapes=one_shape,
    columns=_columns,
    parameters=lambda _, shape, c: {"offset_x_m": float(c[0]), "offset_y_m": float(c[1]), **shape},
    inverse=lambda _, p: (
        {k: v for k, v in p.items() if k == "onset_s"},
        np.array([p["offset_x_m"], p["offset_y_m"]]),
    ),
    refuse=_refuse,
    cause=lambda frame, _, channel: ("total_thrust_N", frame.thrust.sum(axis=1)),
    nil=lambda _: {"offset_x_m": 0.0, "offset_y_m": 0.0},
    sudden=True,
    stage=8,
    free=onset_limits,
)
