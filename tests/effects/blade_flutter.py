"""Blade flutter, an effect of nobody's: above a voltage blades lose thrust, torque as it was.

Written as docs/effects.md has it, from outside the package: numbers, what they do, where a search begins.
"""

from __future__ import annotations

import numpy as np

from coaxlink.effects import LeftOut, NotShown, Parameter, PhysicalEffect, Stage, Tracing


def lost(p, volts):
    """Share of the thrust that flutter takes: the formula, once."""
    return p["thrust_loss_per_V"] * np.maximum(np.asarray(volts, float) - p["from_V"], 0.0)


def starts(frame):
    volts = frame.context("voltage_V")
    if volts is None:
        raise NotShown("voltage_V is not in the log")
    return [{"thrust_loss_per_V": 0.01, "from_V": float(v)} for v in np.quantile(volts, [0.1, 0.4, 0.7])]


def adds(frame, p):
    out = np.zeros((len(frame.time_s), 6))
    for load in (0, 2):  # upper and lower thrust
        out[:, load] = -frame.predicted[:, load] * lost(p, frame.columns["voltage_V"])
    return out


def static(vehicle, p):
    volts = vehicle.at.voltage_V
    if volts is None:
        raise LeftOut("flutter needs the voltage stated")
    vehicle.thrust *= 1.0 - lost(p, volts)
    return f"thrust less {100 * float(lost(p, volts)):.1f} % at {volts:g} V"


def live(view, p):
    def part(speeds):
        volts = view.reading("voltage")
        if volts is None:
            return np.zeros(4)
        return view.wrench_of(-lost(p, volts) * view.loads(speeds)[0])

    return part


FLUTTER = PhysicalEffect(
    name="blade_flutter",
    stage=Stage.ROTOR,
    physics="blades flutter and lose thrust at high voltage",
    source="this test",
    parameters=(
        Parameter("thrust_loss_per_V", "1/V", 0.0, 0.1, (0.0, 0.02), amount=True, source="assumed: this toy"),
        Parameter("from_V", "V", 1.0, 100.0, moves=True, source="wide: any value between the bounds; a toy"),
    ),
    stand=Tracing(
        needs=("voltage_V",),
        channels=("upper_thrust", "lower_thrust"),
        starts=starts,
        adds=adds,
        cause=lambda frame, *_: ("voltage_V", frame.columns["voltage_V"]),
    ),
    static=static,
    live=live,
    required=("thrust_loss_per_V", "from_V"),
    messages={"BATTERY_STATUS": 10.0},
)
