"""Degraded rotor: one rotor gives less thrust at its speed (a chipped blade, a slipping mount, a weak motor).

Source: loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010). The signature is
that rotor's own: lift, roll, pitch and yaw all point to its place and its spin. Its drag torque may change
otherwise. A weak motor turns slower than commanded: then the rotor under it feels less wake as well, and one
number says it all. It may happen in mid-flight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import LiveView, Part
from coaxlink.effects.onset import ONSET, since
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import StaticVehicle
from coaxlink.effects.tracing import Array, Tracing
from coaxlink.errors import InputError
from coaxlink.frames import FlightFrame

# how much torque may change, and more with the thrust that is lost
TORQUE_ALONE, TORQUE_PER_THRUST = 0.03, 4.0


def losses(p: Numbers) -> tuple[float, float]:
    """Shares of thrust and of torque that the rotor loses at given speed."""
    return p["thrust_loss"], p.get("torque_loss", 0.0)


def _starts(frame: FlightFrame) -> Sequence[Numbers]:
    """Any rotor: a blade that lifts less, or a motor that turns slower."""
    numbers = [float(r.number) for r in frame.airframe.rotors]
    return [
        *({"rotor": n, "thrust_loss": 0.1, "torque_loss": 0.1} for n in numbers),
        *({"rotor": n, "speed_loss": 0.05} for n in numbers),
    ]


def _only(frame: FlightFrame, p: Numbers) -> Array:
    """(rows, N) how much of the loss each rotor has at each time."""
    only = np.zeros_like(frame.thrust)
    only[:, int(p["rotor"]) - 1] = since(frame, p)
    return only


def _by_speed(_: FlightFrame, p: Numbers) -> float | None:
    """What a slower rotor loses: whoever knows only loads at given speed, both go with the square of it."""
    return 1.0 - max(1.0 - p["speed_loss"], 0.0) ** 2 if "speed_loss" in p else None


def _torque(_: FlightFrame | None, p: Numbers) -> Range:
    """A blade that drags otherwise lifts otherwise: torque alone is no failing rotor."""
    most = min(1.0, TORQUE_ALONE + TORQUE_PER_THRUST * abs(p["thrust_loss"]))
    return -most, most


def _changes(frame: FlightFrame, p: Numbers) -> FlightFrame:
    only = _only(frame, p)
    if "speed_loss" in p:
        return frame.turning_at(frame.speeds * (1.0 - p["speed_loss"] * only))
    thrust, torque = losses(p)
    return frame.pulling(frame.thrust * (1.0 - thrust * only), frame.torque * (1.0 - torque * only))


def _further(_: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    same = {k: v for k, v in p.items() if k not in ("thrust_loss", "torque_loss", "speed_loss")}
    if "speed_loss" in p:
        lost = 1.0 - (1.0 - p["speed_loss"]) ** 2
        return [{**same, "thrust_loss": lost, "torque_loss": lost}]
    return [{**same, "speed_loss": 0.5 * p["thrust_loss"]}]


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("motor1",),
    channels=("force_z", "torque_x", "torque_y", "torque_z"),
    starts=_starts,
    further=_further,
    changes=_changes,
    cause=lambda frame, p, _: (
        f"thrust of rotor {int(p['rotor'])}, N",
        frame.thrust[:, int(p["rotor"]) - 1],
    ),
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
    physics="one rotor gives less thrust than the others at the same speed",
    source="loss of effectiveness of one actuator (Sharifi, Mirzaei, Gordon and Zhang 2010)",
    parameters=(
        Parameter("rotor", "1", 1.0, 16.0, source="a number of the airframe's rotors, each as likely"),
        Parameter("thrust_loss", "1", 0.0, 1.0, (0.1, 0.1), amount=True, nil=0.0, follows=_by_speed,
            source="assumed: a loss of one rotor that is flown unnoticed is a fifth at most"),
        Parameter("torque_loss", "1", -1.0, 1.0, (0.05, 0.1), amount=True, follows=_by_speed,
            within=_torque,
            source="assumed: a shortened blade loses drag with its lift, a rough one gains some"),
        Parameter("speed_loss", "1", 0.0, 1.0, (0.05, 0.05), amount=True,
            source="assumed: half of the thrust loss, which goes with the square of speed"),
        *ONSET,
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    required=("rotor", "thrust_loss"),
)  # fmt: skip
