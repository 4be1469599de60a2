"""Degraded rotor: one rotor gives less thrust at its speed (a chipped blade, a slipping mount, a weak motor).

Source: loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010). The signature is
that rotor's own: lift, roll, pitch and yaw all point to its place and its spin. Its drag torque may change
otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside, present
from coaxlink.residual.frames import FlightFrame


def _shapes(frame: FlightFrame) -> Sequence[Shape]:
    return [{"rotor": float(r.number)} for r in frame.airframe.rotors]


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    only = np.zeros(len(frame.airframe.rotors))
    only[int(shape["rotor"]) - 1] = 1.0
    none = np.zeros_like(frame.thrust)
    return np.stack(
        [
            frame.airframe.body_loads(-frame.thrust * only, none),
            frame.airframe.body_loads(none, -frame.torque * only),
        ],
        axis=-1,
    )


def _refuse(p: Mapping[str, float]) -> str | None:
    return outside("thrust_loss", p["thrust_loss"], 0.0, 1.0) or outside(
        "torque_loss", p["torque_loss"], -1.0, 1.0
    )


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    thrust, torque, rotor = frame.thrust.copy(), frame.torque.copy(), int(p["rotor"]) - 1
    thrust[:, rotor] *= 1.0 - p["thrust_loss"]
    torque[:, rotor] *= 1.0 - p["torque_loss"]
    return frame.pulling(thrust, torque)


FLIGHT: Effect[FlightFrame] = Effect(
    name="degraded_rotor",
    physics="one rotor gives less thrust than the others at the same speed",
    source="loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010)",
    needs=("motor1",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={"rotor": "1", "thrust_loss": "1", "torque_loss": "1"},
    missing=present,
    shapes=_shapes,
    columns=_columns,
    parameters=lambda _, shape, c: {
        "rotor": shape["rotor"],
        "thrust_loss": float(c[0]),
        "torque_loss": float(c[1]),
    },
    inverse=lambda _, p: ({"rotor": p["rotor"]}, np.array([p["thrust_loss"], p["torque_loss"]])),
    refuse=_refuse,
    cause=lambda frame, shape, _: (
        f"thrust of rotor {int(shape['rotor'])}, N",
        frame.thrust[:, int(shape["rotor"]) - 1],
    ),
    stage=2,
    apply=_apply,
)
