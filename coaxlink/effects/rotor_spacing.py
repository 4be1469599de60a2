"""Rotor spacing: further apart, the wake has contracted more and the rotors disturb each other less.

Source: wake contraction (Leishman 2006, ch. 2); bench maps of Buzzatto and Liarokapis 2022.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.static import LeftOut, Loads, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import STAND_LOADS, StandFrame
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import RotorModel

SPACING_M = (1e-3, 10.0)  # a rotor's thickness, and more than any pair has
APART = (-0.3, -0.15, 0.0, 0.15, 0.3)  # of the log's median spacing
WAKE = ("wake_thrust_share", "wake_torque_share", "upper_gain_N")  # the lower rotor's wake, not its loads
# of the lower rotor's loads, of the upper one's; the first alone: all four alike
OF_LOADS = ("loads_share", "torque_loads_share", "upper_loads_share", "upper_torque_loads_share")


def _no_spacing(frame: StandFrame) -> str | None:
    z = frame.context("rotor_spacing_m")
    if z is None:
        return "rotor_spacing_m is not in the log"
    own = z[frame.keep]
    odd = own[(own < SPACING_M[0]) | (own > SPACING_M[1])]
    if len(odd):
        return f"rotor_spacing_m reads {odd[0]:.2g} m in some rows: no pair has that"
    return None if np.ptp(z) > 0.02 * np.median(z) else "rotor_spacing_m does not vary"


def spread(p: Numbers, relative: ArrayLike) -> Array:
    """Of a spacing over the reference, less 1: straight, or what is left of the wake dies away.

    It is nought where the nuisance model holds: at the reference, or `apart` from it.
    """
    change = np.asarray(relative, float)
    if "decay" in p:
        change = np.asarray(-np.expm1(-p["decay"] * change) / p["decay"])
    return np.asarray(change - p.get("apart", 0.0))


def share_of(p: Numbers, load: Load) -> float:
    """By how much of itself a load changes with the spacing; the first share alone: all alike."""
    if not set(OF_LOADS[1:]) & set(p):
        return p["loads_share"]
    return p.get(dict(zip((*of_rotor(1), *of_rotor(0)), OF_LOADS, strict=True))[load], 0.0)


def _adds(frame: StandFrame, p: Numbers) -> Array:
    relative = frame.columns["rotor_spacing_m"] / p["reference_spacing_m"] - 1.0
    change, out = spread(p, relative), np.zeros((len(frame.time_s), 6))
    if "loads_share" in p:
        for load in Load:
            out[:, load] = share_of(p, load) * change * frame.predicted[:, load]
        return out
    lower = list(of_rotor(1))
    alone = frame.loads_at(np.stack([np.zeros(len(frame.time_s)), frame.speeds[:, 1]], axis=1))
    wake = (frame.loads_at(frame.speeds) - alone)[:, lower]  # negative: what the lower rotor loses
    for k, (load, name) in enumerate(zip(lower, WAKE, strict=False)):
        out[:, load] = -p[name] * wake[:, k] * change
    out[:, Load.UPPER_THRUST] = p["upper_gain_N"] * frame.speeds[:, 1] ** 2 * change
    return out


def _starts(frame: StandFrame) -> list[Numbers]:
    """The wake; both rotors by one share (each draws less through the other); the lower one alone.

    Not each load by its own, which is what a fit comes to by itself: a rival with three numbers more would be
    behind what one number explains as well.
    """
    if why := _no_spacing(frame):
        raise NotShown(why)
    # where the nuisance model may hold
    places: list[Numbers] = [{}] if frame.free_nuisance else [{"apart": a} for a in APART]
    ways: tuple[Numbers, ...] = ({}, {"decay": 1.0})
    return [
        *({**dict.fromkeys(WAKE, 0.1), **place} for place in places),
        *({"loads_share": 0.1, **place, **way} for place in places for way in ways),
        *({**dict.fromkeys(OF_LOADS[:2], 0.1), **way} for way in ways),
    ]


def _further(frame: StandFrame, p: Numbers) -> list[Numbers]:
    forms: list[Numbers] = []
    z = frame.columns["rotor_spacing_m"]
    if "decay" not in p and len(np.unique(np.round(z / np.median(z), 2))) > 2:
        forms.append({**p, "decay": 1.0})
    decay = {k: v for k, v in p.items() if k == "decay"}
    if "loads_share" not in p:
        forms += [{**dict.fromkeys(names, 0.0), **decay} for names in (OF_LOADS[:2], OF_LOADS)]
    elif OF_LOADS[1] in p and OF_LOADS[2] not in p:  # the upper loads may go with it too
        forms.append({**p, **dict.fromkeys(OF_LOADS[2:], 0.0)})
    return forms


def _no_wake(_: StandFrame, p: Numbers) -> float | None:
    """Of whole loads: the wake's part is in them."""
    return 0.0 if "loads_share" in p else None


STAND: Tracing[StandFrame] = Tracing(
    needs=("rotor_spacing_m",),
    channels=STAND_LOADS,
    starts=_starts,
    further=_further,
    adds=_adds,
    cause=lambda frame, *_: ("rotor_spacing_m", frame.columns["rotor_spacing_m"]),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    if "reference_spacing_m" not in p:
        raise LeftOut(_NO_REFERENCE)
    positions = np.array([r.position_m for r in vehicle.airframe.rotors])
    gaps = [float(np.linalg.norm(positions[u] - positions[w])) for u, w in vehicle.airframe.pairs]
    if not gaps:
        raise LeftOut("this airframe has no pairs")
    gap = float(np.mean(gaps))
    off = float(spread(p, gap / p["reference_spacing_m"] - 1.0))

    def change(model: RotorModel, loads: Loads) -> Loads:
        alone = model.loads(np.zeros_like(loads.lower), loads.lower)
        wake, drag = (loads[load] - alone[load] for load in of_rotor(1))
        if "loads_share" in p:
            return loads.plus({load: share_of(p, load) * off * loads[load] for load in Load})
        return loads.plus({
            Load.UPPER_THRUST: p.get("upper_gain_N", 0.0) * off * loads.lower**2,
            Load.LOWER_THRUST: -p["wake_thrust_share"] * off * wake,
            Load.LOWER_TORQUE: -p.get("wake_torque_share", 0.0) * off * drag,
        })  # fmt: skip

    vehicle.changes.append(change)
    return f"pairs {1e3 * gap:.0f} mm apart, logged about {1e3 * p['reference_spacing_m']:.0f} mm"


_NO_REFERENCE = "the file does not say at which spacing its base holds"
EFFECT = PhysicalEffect(
    name="rotor_spacing",
    stage=Stage.ROTOR,
    physics="further apart, the wake has contracted more and the rotors disturb each other less",
    source="wake contraction (Leishman 2006, ch. 2); bench maps of Buzzatto and Liarokapis 2022",
    parameters=(
        Parameter("wake_thrust_share", "1", -3.0, 3.0, (0.0, 0.5), amount=True, follows=_no_wake,
            source="assumed: less than half of the wake's cost for twice the spacing"),
        Parameter("wake_torque_share", "1", -10.0, 10.0, (0.0, 0.5), amount=True,
            source="assumed: less than half of the wake's cost for twice the spacing"),
        Parameter("upper_gain_N", "N", -1e4, 1e4, amount=True,
            source="wide: any value between the bounds; it goes with the rotors' size"),
        *(Parameter(name, "1", -3.0, 3.0, (0.0, 0.2), amount=True,
            source="assumed: less than a fifth of a rotor's load for twice the spacing")
          for name in OF_LOADS),
        Parameter("reference_spacing_m", "m", 1e-3, 100.0,
            follows=lambda frame, _: float(np.median(frame.columns["rotor_spacing_m"])),
            source="wide: any value between the bounds; spacings are the builder's choice"),
        Parameter("decay", "1", 0.05, 8.0, moves=True,
            source="wide: any value between the bounds; a wake contracts within 0.3 to 1 radius (Leishman "
                   "2006, ch. 2), of spacings that differ"),
        Parameter("apart", "1", -0.5, 0.5, moves=True,
            source="wide: any value between the bounds; the model may be of another spacing than the log's"),
    ),
    stand=STAND,
    static=_static,
    required=("wake_thrust_share",),
    surface=0,
)  # fmt: skip
