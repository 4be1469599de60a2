"""Degraded rotor: one rotor gives less thrust at its speed (a chipped blade, a slipping mount, a weak motor).

Source: loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010). The signature is
that rotor's own: lift, roll, pitch and yaw all point to its place and its spin. Its drag torque may change
otherwise. A weak motor turns slower than commanded: then the rotor under it feels less wake as well, and one
number says it all. It may happen in mid-flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import LiveView, Part
from coaxlink.effects.onset import COMES, OVER, onset_limits, since
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, outside, present
from coaxlink.errors import InputError
from coaxlink.frames import FlightFrame

# how much torque may change, and more with the thrust that is lost
TORQUE_ALONE, TORQUE_PER_THRUST = 0.03, 4.0


def losses(p: Numbers) -> tuple[float, float]:
    """Shares of thrust and of torque that the rotor loses at given speed."""
    return p["thrust_loss"], p.get("torque_loss", 0.0)


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
    onset = {k: v for k, v in shape.items() if k in COMES}
    if "slower" not in shape:
        return {"rotor": shape["rotor"], "thrust_loss": float(c[0]), "torque_loss": float(c[1]), **onset}
    # whoever knows only loads at given speed: both go with the square of it
    lost = 1.0 - max(1.0 - float(c[0]), 0.0) ** 2
    named = {"rotor": shape["rotor"], "thrust_loss": lost, "torque_loss": lost}
    return {**named, "speed_loss": float(c[0]), **onset}


def _inverse(_: FlightFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in ("rotor", *COMES)}
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
    thrust, torque = losses(p)
    return frame.pulling(frame.thrust * (1.0 - thrust * only), frame.torque * (1.0 - torque * only))


def _variants(_: FlightFrame, shape: Shape, c: Array) -> Sequence[tuple[Shape, Array]]:
    same = {k: v for k, v in shape.items() if k != "slower"}
    if "slower" in shape:
        lost = 1.0 - (1.0 - c[0]) ** 2
        return [(same, np.array([lost, lost]))]
    return [({**same, "slower": 1.0}, 0.5 * c[:1])]


FLIGHT: Tracing[FlightFrame] = Tracing(
    name="degraded_rotor",
    physics="one rotor gives less thrust than the others at the same speed",
    source="loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010)",
    needs=("motor1",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    units={
        "rotor": "1",
        "thrust_loss": "1",
        "torque_loss": "1",
        "speed_loss": "1",
        "onset_s": "s",
        "over_s": "s",
    },
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
    variants=_variants,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    rotor = _index(p, len(vehicle.thrust))
    thrust, torque = (1.0 - loss for loss in losses(p))
    vehicle.thrust[rotor] *= max(thrust, LEAST_GAIN)
    vehicle.torque[rotor] *= max(torque, LEAST_GAIN)
    pull, drag = 100 * thrust, 100 * torque
    return f"rotor {rotor + 1} counts for {pull:.1f} % of its thrust and {drag:.1f} % of its torque"


def _live(view: LiveView, p: Numbers) -> Part:
    rotor = _index(p, len(view.airframe.rotors))
    lost_thrust, lost_torque = losses(p)

    def part(speeds: Sequence[float]) -> Array:
        thrust, torque = view.loads(speeds)
        only = np.zeros(len(thrust))
        only[rotor] = 1.0
        return view.wrench_of(-lost_thrust * thrust * only, -lost_torque * torque * only)

    return part


def _index(p: Numbers, count: int) -> int:
    """Of the rotor, from 0. Raises InputError where the airframe has no such rotor."""
    number = int(p["rotor"])
    if not 1 <= number <= count:
        problem = f"this airframe has rotors 1 to {count}, found {number}"
        raise InputError("rotor model", "effects.degraded_rotor.rotor", problem)
    return number - 1


LEAST_GAIN = 0.05  # of a rotor that counts for less, no mixer can make use
EFFECT = PhysicalEffect(
    name="degraded_rotor",
    stage=Stage.ROTOR,
    parameters=(
        Parameter("rotor", "1", 1.0, 16.0, source="a number of the airframe's rotors, each as likely"),
        Parameter("thrust_loss", "1", 0.0, 1.0, (0.1, 0.1),
            source="assumed: a loss of one rotor that is flown unnoticed is a fifth at most"),
        Parameter("torque_loss", "1", -1.0, 1.0, (0.05, 0.1),
            source="assumed: a shortened blade loses drag with its lift, a rough one gains some"),
        Parameter("speed_loss", "1", 0.0, 1.0, (0.05, 0.05),
            source="assumed: half of the thrust loss, which goes with the square of speed"),
        Parameter("onset_s", "s", 0.0, 1e6,
            source="wide: any value between the bounds; the second of the log at which it began"),
        OVER,
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    required=("rotor", "thrust_loss"),
)  # fmt: skip
