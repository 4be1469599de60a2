"""Interference: the lower rotor draws air through the upper one, which loses thrust.

Source: coaxial momentum theory at finite spacing (Leishman and Ananthan 2006).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import Loads, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import StandFrame
from coaxlink.load import Load
from coaxlink.rotor import RotorModel

ARM_M = 0.3  # torque over thrust: a rotor of a metre has some 0.05


def drawn(p: Numbers, upper: Array, lower: Array) -> Array:
    """How much of the full loss the upper rotor has at normalised speeds of both."""
    return np.asarray(
        np.maximum(lower, 0.0) ** p["lower_power"] * np.maximum(upper, 1e-6) ** p["upper_power"]
    )


def _starts(frame: StandFrame) -> Sequence[Numbers]:
    if float(np.ptp(frame.speeds[:, 1])) <= 0.2:
        raise NotShown("the lower rotor's speed hardly varies")
    loss = {"thrust_loss_N": 1.0, "torque_loss_Nm": 0.0}
    return [
        {**loss, "lower_power": a, "upper_power": b} for a in (1.0, 1.5, 2.0) for b in (0.0, 0.5, 1.0, 2.0)
    ]


def _adds(frame: StandFrame, p: Numbers) -> Array:
    term = drawn(p, *frame.speeds.T)
    out = np.zeros((len(term), 6))
    out[:, Load.UPPER_THRUST], out[:, Load.UPPER_TORQUE] = (
        -p["thrust_loss_N"] * term,
        -p["torque_loss_Nm"] * term,
    )
    return out


def _arm(_: StandFrame | None, p: Numbers) -> Range:
    """Torque goes with the thrust, by no more of an arm than rotors have."""
    most = ARM_M * max(p["thrust_loss_N"], 1e-9)
    return -most, most


STAND: Tracing[StandFrame] = Tracing(
    needs=("upper_rpm", "lower_rpm"),
    channels=(Load.UPPER_THRUST.channel, Load.UPPER_TORQUE.channel),
    starts=_starts,
    adds=_adds,
    cause=lambda frame, *_: ("u_l", frame.speeds[:, 1]),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    thrust, torque = p["thrust_loss_N"], p["torque_loss_Nm"]

    def change(_: RotorModel, loads: Loads) -> Loads:
        term = drawn(p, loads.upper, loads.lower)
        return loads.plus({Load.UPPER_THRUST: -thrust * term, Load.UPPER_TORQUE: -torque * term})

    vehicle.changes.append(change)
    powers = f"u_l^{p['lower_power']:g} u_u^{p['upper_power']:g}"
    return f"the upper rotor loses {thrust:.2f} N {powers} to the lower one"


EFFECT = PhysicalEffect(
    name="lower_on_upper_interference",
    stage=Stage.ROTOR,
    place=2,
    physics="the lower rotor draws air through the upper one, which loses thrust",
    source="coaxial momentum theory at finite spacing (Leishman and Ananthan 2006)",
    parameters=(
        Parameter("thrust_loss_N", "N", 0.0, 1e4, amount=True,
            source="wide: any value between the bounds; it goes with the rotors' size; momentum theory "
                   "bounds it by the upper rotor's thrust"),
        Parameter("torque_loss_Nm", "N m", -3e3, 3e3, amount=True, within=_arm,
            source="wide: any value between the bounds; it goes with the rotors' size; an arm of 0.3 m "
                   "bounds it by the thrust"),
        Parameter("lower_power", "1", 0.4, 5.0, (1.5, 0.7), moves=True,
            source="momentum theory (Leishman and Ananthan 2006): inflow goes with speed, its pressure "
                   "with the square"),
        Parameter("upper_power", "1", 0.0, 4.0, (0.7, 0.7), moves=True,
            source="the upper rotor's answer to inflow goes with its speed (blade element theory: 1, 0 at "
                   "rest)"),
    ),
    stand=STAND,
    static=_static,
    required=("thrust_loss_N", "torque_loss_Nm", "lower_power", "upper_power"),
    surface=2,
)  # fmt: skip
