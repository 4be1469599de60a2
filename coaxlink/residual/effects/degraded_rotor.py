"""Degraded rotor: one rotor gives less thrust at its speed (a chipped blade, a slipping mount, a weak motor).

Source: loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010). The signature is
that rotor's own: lift, roll, pitch and yaw all point to its place and its spin. Its drag torque may change
otherwise. A weak motor turns slower than told: then the rotor under it feels less wake as well, and one
number says it all. It may happen in mid-flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.residual.effects.base import Array, Effect, Shape, outside, present
from coaxlink.residual.effects.onset import onset_limits, since
from coaxlink.residual.frames import FlightFrame

# how much torque may change, and more with the thrust that is lost
TORQUE_ALONE, TORQUE_PER_THRUST = 0.03, 4.0


def _shapes(frame: FlightFrame) -> Sequence[Shape]:
    numbers = [float(r.number) for r in frame.airframe.rotors]
    return [*({"rotor": n} for n in numbers), *({"rotor": n, "slower": 1.0} for n in numbers)]


def _only(frame: FlightFrame, shape: Shape) -> Array:
    """(rows, N) how much of the loss each rotor has at each time."""
    only = np.zeros_like(frame.thrust)
    only[:, int(shape["rotor"]) - 1] = since(frame, shape)
    return only


def _columns(frame: FlightFrame, shape: Shape) -> Array:
    only = _only(frame, shape)
    if "slower" in shape:
        small = 1e-3
        slowed = frame.turning_at(frame.speeds * (1.0 - small * only)).predicted
        return ((slowed - frame.predicted) / small)[..., None]
    none = np.zeros_like(frame.thrust)
    return np.stack(
        [
            frame.airframe.body_loads(-frame.thrust * only, none),
            frame.airframe.body_loads(none, -frame.torque * only),
        ],
        axis=-1,
    )


def _parameters(_: FlightFrame, shape: Shape, c: Array) -> dict[str, float]:
    onset = {k: v for k, v in shape.items() if k == "onset_s"}
    if "slower" not in shape:
        return {"rotor": shape["rotor"], "thrust_loss": float(c[0]), "torque_loss": float(c[1]), **onset}
    # whoever knows only loads at given speed: both go with the square of it
    lost = 1.0 - max(1.0 - float(c[0]), 0.0) ** 2
    named = {"rotor": shape["rotor"], "thrust_loss": lost, "torque_loss": lost}
    return {**named, "speed_loss": float(c[0]), **onset}


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in ("rotor", "onset_s")}
    if "speed_loss" in p:
        return {**shape, "slower": 1.0}, np.array([p["speed_loss"]])
    return shape, np.array([p["thrust_loss"], p["torque_loss"]])


def _refuse(p: Mapping[str, float]) -> str | None:
    # a blade that drags otherwise lifts otherwise: torque alone is no failing rotor
    most = min(1.0, TORQUE_ALONE + TORQUE_PER_THRUST * abs(p["thrust_loss"]))
    return outside("thrust_loss", p["thrust_loss"], 0.0, 1.0) or outside(
        "torque_loss", p["torque_loss"], -most, most
    )


def _apply(frame: FlightFrame, p: Mapping[str, float]) -> FlightFrame:
    only = _only(frame, p)
    if "speed_loss" in p:
        return frame.turning_at(frame.speeds * (1.0 - p["speed_loss"] * only))
    return frame.pulling(
        frame.thrust * (1.0 - p["thrust_loss"] * only), frame.torque * (1.0 - p["torque_loss"] * only)
    )


def _finer(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    same = {k: v for k, v in shape.items() if k != "slower"}
    if "slower" in shape:
        lost = 1.0 - (1.0 - c[0]) ** 2
        return [(same, np.array([lost, lost]))]
    return [({**same, "slower": 1.0}, 0.5 * c[:1])]


FLIGHT: Effect[FlightFrame] = Effect(
    name="degraded_rotor",
    physics="one rotor gives less thrust than the others at the same speed",
    source="loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010)",
    needs=("motor1",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={"rotor": "1", "thrust_loss": "1", "torque_loss": "1", "speed_loss": "1", "onset_s": "s"},
    missing=present,
    shapes=_shapes,
    columns=_columns,
    parameters=_parameters,
    inverse=_inverse,
    refuse=_refuse,
    cause=lambda frame, shape, _: (
        f"thrust of rotor {int(shape['rotor'])}, N",
        frame.thrust[:, int(shape["rotor"]) - 1],
    ),
    nil=lambda _: {"thrust_loss": 0.0},
    sudden=True,
    stage=2,
    apply=_apply,
    free=onset_limits,
    finer=_finer,
)
