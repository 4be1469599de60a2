"""Law of blade speed: the loads grow with another power of speed than the model's.

Source: Deters, Ananda and Selig 2014, Reynolds number effects on small propellers; Glauert 1928 for the tip's
Mach number; a stall takes lift off from a speed on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.parameter import Range
from coaxlink.effects.static import Loads, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_LOADS, StandFrame
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import RotorModel

SLOWEST = 0.025  # of full speed: a slower blade has no law of speed
POWERS = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)  # of Reynolds number: relative to full speed, downwards
RISES = (2.0, 4.0, 7.0)  # of Mach number: nothing at rest
TIPS = (0.4, 0.55, 0.7)  # from where a stall or a wave takes lift off
SLOWEST_POWER = -0.8  # unless it is softened: at low Reynolds numbers the loads fall no further


def growth(p: Numbers, speed: ArrayLike) -> Array:
    """By how much of itself a load grows at a normalised speed, for a unit coefficient."""
    u = np.maximum(np.asarray(speed, float), SLOWEST)
    if "tip" in p:
        return np.asarray(-(np.maximum(u - p["tip"], 0.0) ** 2))
    if "rise" in p:
        return np.asarray(u ** p["rise"] / p["rise"])
    power = p["power"] if abs(p["power"]) > 1e-4 else 1e-4
    soft = p.get("soft", 0.0)
    return np.asarray(np.expm1(power * np.log((u + soft) / (1.0 + soft))) / power)


def shares(p: Numbers) -> tuple[float, float]:
    """Of thrust and of torque, what multiplies the growth; torque's is thrust's where it has none."""
    name = "loss" if "tip" in p else "exponent_change"
    return p[name], p.get(f"torque_{name}", p[name])


def _adds(frame: StandFrame, p: Numbers) -> Array:
    out = np.zeros((len(frame.time_s), 6))
    for side in (0, 1):
        factor = growth(p, frame.speeds[:, side])
        for load, share in zip(of_rotor(side), shares(p), strict=True):
            out[:, load] = share * frame.predicted[:, load] * factor
    return out


def _apart(p: Numbers) -> Numbers:
    """With a number of its own for torque: a stall, or a slow blade, takes lift and adds drag."""
    _, drag = shares(p)
    return {**p, "torque_loss" if "tip" in p else "torque_exponent_change": drag}


def _further(frame: StandFrame, p: Numbers) -> list[Numbers]:
    """The same bend at the other end of the speeds; torque by a change of its own."""
    lift = shares(p)[0]
    out: list[Numbers] = []
    if not frame.free_nuisance:
        if "power" in p and "soft" not in p:
            out.append({**p, "soft": 0.2, "power": min(p["power"], -1.0)})
        if "power" not in p:
            out.append({"exponent_change": 0.5 * lift, "power": -0.4})
        if "rise" not in p:
            out.append({"exponent_change": -lift if "tip" in p else lift, "rise": 4.0})
    together = not {"torque_loss", "torque_exponent_change"} & set(p)
    return [*out, _apart(p)] if together else out


def _starts(frame: StandFrame) -> list[Numbers]:
    """What sets in at a speed; beside a given model also what bends over all, as a fitted nuisance does."""
    if why := _unknowable(frame):
        raise NotShown(why)
    onset: list[Numbers] = [{"loss": 0.1, "tip": t} for t in TIPS]
    onset = [form for p in onset for form in (p, _apart(p))]
    if frame.free_nuisance:
        return onset
    powers: list[Numbers] = [{"exponent_change": 0.1, "power": p} for p in POWERS]
    rises: list[Numbers] = [{"exponent_change": 0.1, "rise": r} for r in RISES]
    slow = [_apart(p) for p in powers if p["power"] in (-0.5, -0.1)]
    return [*powers, *rises, *onset, *slow]


def _unknowable(frame: StandFrame) -> str | None:
    if frame.driven and frame.context("upper_rpm") is None and frame.context("lower_rpm") is None:
        return "no rpm in the log: what bends over throttle may be the drive, not the blades"
    return None


def _power(_: StandFrame | None, p: Numbers) -> Range:
    return (-9.0 if "soft" in p else SLOWEST_POWER), 1.0


STAND: Tracing[StandFrame] = Tracing(
    needs=("upper_rpm",),
    channels=STAND_LOADS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, _, channel: (
        f"u_{channel[0]}",
        frame.speeds[:, 1 if channel.startswith("lower") else 0],
    ),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    lift, drag = shares(p)

    def change(_: RotorModel, loads: Loads) -> Loads:
        upper, lower = growth(p, loads.upper), growth(p, loads.lower)
        each = zip(Load, (lift * upper, drag * upper, lift * lower, drag * lower), strict=True)
        return loads.plus({load: loads[load] * share for load, share in each})

    vehicle.changes.append(change)
    if "tip" in p:
        return f"loads fall off above speed {p['tip']:g}"
    return f"loads grow with another power of speed ({lift:+.3f} at full speed)"


EFFECT = PhysicalEffect(
    name="blade_speed_law",
    stage=Stage.ROTOR,
    place=1,  # behind the wake, which the blades meet at their own speed
    physics="the loads grow with another power of speed than the model's (Reynolds number, tip Mach number)",
    source="Deters, Ananda and Selig 2014, Reynolds number effects on small propellers; Glauert 1928",
    parameters=(
        *(Parameter(name, "1", -1.0, 1.0, (0.0, 0.2), amount=True,
            source="Deters, Ananda and Selig 2014: coefficients rise or fall with Reynolds number; 0.2 is "
                   "assumed")
          for name in ("exponent_change", "torque_exponent_change")),
        Parameter("loss", "1", 0.0, 10.0, amount=True,
            source="wide: any value between the bounds; how much lift a stall takes goes with the blade's "
                   "section"),
        Parameter("torque_loss", "1", -10.0, 10.0, amount=True,
            source="wide: any value between the bounds; drag in a stall goes with the blade's section"),
        Parameter("power", "1", -9.0, 1.0, (-0.2, 0.3), moves=True, within=_power,
            source="skin friction goes with Reynolds number to -0.5 (laminar) or -0.2 (turbulent; "
                   "Schlichting 1979)"),
        Parameter("rise", "1", 1.2, 12.0, moves=True,
            source="wide: any value between the bounds; Glauert 1928 gives 2 at once, wave drag more"),
        Parameter("tip", "1", 0.2, 0.9, moves=True,
            source="wide: any value between the bounds; where it begins goes with the section and the "
                   "tip's Mach number"),
        Parameter("soft", "1", 0.0, 2.0, moves=True,
            source="wide: any value between the bounds; where Reynolds number ceases to count goes with "
                   "the section"),
    ),
    stand=STAND,
    static=_static,
    surface=1,
)  # fmt: skip
