"""Law of blade speed: the loads grow with another power of speed than the model's.

Source: Deters, Ananda and Selig 2014, Reynolds number effects on small propellers; Glauert 1928 for the tip's
Mach number; a stall takes lift off from a speed on.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.static import Loads, StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_LOADS, StandFrame
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import RotorModel

SLOWEST = 0.025  # of full speed: a slower blade has no law of speed
POWERS = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)  # of Reynolds number: relative to full speed, downwards
RISES = (2.0, 4.0, 7.0)  # of Mach number: nothing at rest
TIPS = (0.4, 0.55, 0.7)  # from where a stall or a wave takes lift off
BLADES = {"power": (-0.8, 1.0), "rise": (1.2, 12.0), "tip": (0.2, 0.9)}
SOFT = {"soft": (0.0, 2.0), "power": (-9.0, 1.0)}  # at low Reynolds numbers the loads fall no further


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


def _blade_columns(frame: StandFrame, shape: Shape) -> Array:
    out = np.zeros((len(frame.time_s), 6, 2 if "apart" in shape else 1))
    for side in (0, 1):
        factor = growth(shape, frame.speeds[:, side])
        for k, load in enumerate(of_rotor(side)):
            out[:, load, k if "apart" in shape else 0] = frame.predicted[:, load] * factor
    return out


def _blade_names(shape: Shape) -> tuple[str, ...]:
    name = "loss" if "tip" in shape else "exponent_change"
    return (name, f"torque_{name}") if "apart" in shape else (name,)


def _blade_inverse(_: StandFrame, p: Mapping[str, float]) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in (*BLADES, "soft", "apart")}
    return shape, np.array([p[name] for name in _blade_names(shape)])


def _blade_refuse(p: Mapping[str, float]) -> str | None:
    for name in ("exponent_change", "torque_exponent_change"):
        if why := outside(name, p.get(name, 0.0), -1.0, 1.0):
            return why
    return outside("loss", p.get("loss", 0.1), 0.0, 10.0)


def _blade_variants(frame: StandFrame, shape: Shape, c: Array) -> list[tuple[Shape, Array]]:
    """The same bend at the other end of the speeds; torque by a change of its own."""
    forms: dict[str, tuple[Shape, Array]] = {
        "soft": ({**shape, "soft": 0.2, "power": min(shape.get("power", 0.0), -1.0)}, c),
        "power": ({"power": -0.4}, 0.5 * c[:1]),
        "rise": ({"rise": 4.0}, -c[:1] if "tip" in shape else c[:1]),
    }
    if frame.free_nuisance:
        forms = {}
    out = [form for name, form in forms.items() if name not in shape and (name != "soft" or "power" in shape)]
    return out if "apart" in shape else [*out, ({**shape, "apart": 1.0}, np.array([c[0], c[0]]))]


def _blade_shapes(frame: StandFrame) -> list[Shape]:
    """What sets in at a speed; beside a given model also what bends over all, as a fitted nuisance does."""
    onset: list[Shape] = [{"tip": t, **apart} for t in TIPS for apart in ({}, {"apart": 1.0})]
    if frame.free_nuisance:
        return onset
    bent: list[Shape] = [*({"power": p} for p in POWERS), *({"rise": p} for p in RISES)]
    # a stall, or a slow blade, takes lift and adds drag: torque need not follow thrust
    return [*bent, *onset, *({"power": p, "apart": 1.0} for p in (-0.5, -0.1))]


def _unknowable(frame: StandFrame) -> str | None:
    if frame.driven and frame.context("upper_rpm") is None and frame.context("lower_rpm") is None:
        return "no rpm in the log: what bends over throttle may be the drive, not the blades"
    return None


STAND: Tracing[StandFrame] = Tracing(
    name="blade_speed_law",
    stage=3,  # behind the wake, which the blades meet at their own speed
    physics="the loads grow with another power of speed than the model's (Reynolds number, tip Mach number)",
    source="Deters, Ananda and Selig 2014, Reynolds number effects on small propellers; Glauert 1928",
    needs=("upper_rpm",),
    channels=STAND_LOADS,
    units=dict.fromkeys(
        (
            "exponent_change",
            "torque_exponent_change",
            "loss",
            "torque_loss",
            "power",
            "rise",
            "tip",
            "soft",
            "apart",
        ),
        "1",
    ),
    missing=_unknowable,
    shapes=_blade_shapes,
    columns=_blade_columns,
    parameters=lambda _, shape, c: {**dict(zip(_blade_names(shape), map(float, c), strict=True)), **shape},
    inverse=_blade_inverse,
    refuse=_blade_refuse,
    cause=lambda frame, _, channel: (
        f"u_{channel[0]}",
        frame.speeds[:, 1 if channel.startswith("lower") else 0],
    ),
    free=lambda _, shape: {
        name: limit for name, limit in (BLADES | (SOFT if "soft" in shape else {})).items() if name in shape
    },
    variants=_blade_variants,
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    names = _blade_names(p)
    lift, drag = p[names[0]], p[names[-1]]

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
    parameters=(
        Parameter("exponent_change", "1", -1.0, 1.0, (0.0, 0.2),
            source="Deters, Ananda and Selig 2014: coefficients rise or fall with Reynolds number; 0.2 is "
                   "assumed"),
        Parameter("torque_exponent_change", "1", -1.0, 1.0, (0.0, 0.2),
            source="Deters, Ananda and Selig 2014: coefficients rise or fall with Reynolds number; 0.2 is "
                   "assumed"),
        Parameter("loss", "1", 0.0, 10.0,
            source="wide: any value between the bounds; how much lift a stall takes goes with the blade's "
                   "section"),
        Parameter("torque_loss", "1", -10.0, 10.0,
            source="wide: any value between the bounds; drag in a stall goes with the blade's section"),
        Parameter("power", "1", -9.0, 1.0, (-0.2, 0.3),
            source="skin friction goes with Reynolds number to -0.5 (laminar) or -0.2 (turbulent; "
                   "Schlichting 1979)"),
        Parameter("rise", "1", 1.2, 12.0,
            source="wide: any value between the bounds; Glauert 1928 gives 2 at once, wave drag more"),
        Parameter("tip", "1", 0.2, 0.9,
            source="wide: any value between the bounds; where it begins goes with the section and the "
                   "tip's Mach number"),
        Parameter("soft", "1", 0.0, 2.0,
            source="wide: any value between the bounds; where Reynolds number ceases to count goes with "
                   "the section"),
        Parameter("apart", "1", 0.0, 1.0, source="a switch, 0 or 1: torque changes by a number of its own"),
    ),
    stand=STAND,
    static=_static,
    surface=1,
)  # fmt: skip
