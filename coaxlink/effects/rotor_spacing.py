"""Rotor spacing: further apart, the wake has contracted more and the rotors disturb each other less.

Source: wake contraction (Leishman 2006, ch. 2); bench maps of Buzzatto and Liarokapis 2022.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.static import LeftOut, Loads, StaticVehicle
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_LOADS, StandFrame
from coaxlink.load import Load, of_rotor
from coaxlink.rotor import RotorModel

SPACING_M = (1e-3, 10.0)  # a rotor's thickness, and more than any pair has
APART = (-0.3, -0.15, 0.0, 0.15, 0.3)  # of the log's median spacing
COEFFICIENTS = ("wake_thrust_share", "wake_torque_share", "upper_gain_N")
OF_LOADS = {
    "alike": ("loads_share",),
    "whole": ("loads_share", "torque_loads_share"),
    "each": ("loads_share", "torque_loads_share", "upper_loads_share", "upper_torque_loads_share"),
}
SPACING = {"decay": (0.05, 8.0), "apart": (-0.5, 0.5)}


def _spacing(frame: StandFrame) -> Array:
    z = frame.context("rotor_spacing_m")
    assert z is not None
    return z / float(np.median(z)) - 1.0


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


def _spacing_columns(frame: StandFrame, shape: Shape) -> Array:
    lower = list(of_rotor(1))
    nuisance = frame.loads_at(frame.speeds)[:, lower]
    alone = frame.loads_at(np.stack([np.zeros(len(frame.time_s)), frame.speeds[:, 1]], axis=1))[:, lower]
    wake = nuisance - alone  # negative: what the lower rotor loses
    change = spread(shape, _spacing(frame))
    if "alike" in shape:
        pair = np.zeros((len(frame.time_s), 6, 1))
        pair[:, :4, 0] = frame.predicted[:, :4] * change[:, None]
        return pair
    if "whole" in shape or "each" in shape:
        own = lower if "whole" in shape else [*lower, *of_rotor(0)]
        out = np.zeros((len(frame.time_s), 6, len(own)))
        for k, load in enumerate(own):
            out[:, load, k] = frame.predicted[:, load] * change
        return out
    out = np.zeros((len(frame.time_s), 6, 3))
    out[:, Load.LOWER_THRUST, 0] = -wake[:, 0] * change
    out[:, Load.LOWER_TORQUE, 1] = -wake[:, 1] * change
    out[:, Load.UPPER_THRUST, 2] = frame.speeds[:, 1] ** 2 * change
    return out


def _spacing_variants(frame: StandFrame, shape: Shape, c: Array) -> list[tuple[Shape, Array]]:
    levels = len(np.unique(np.round(_spacing(frame), 2)))
    forms: list[tuple[Shape, Array]] = []
    if "decay" not in shape and levels > 2:
        forms.append(({**shape, "decay": 1.0}, c))
    bare = {k: v for k, v in shape.items() if k not in ("apart", *OF_LOADS)}
    if not {*shape} & {*OF_LOADS}:
        forms += [({**bare, form: 1.0}, np.zeros(len(OF_LOADS[form]))) for form in ("whole", "each")]
    elif "whole" in shape:  # the upper loads may go with it too
        forms.append(({**bare, "each": 1.0}, np.array([*c, 0.0, 0.0])))
    return forms


def _names(p: Numbers) -> tuple[str, ...]:
    """Of the coefficients."""
    return next((names for form, names in OF_LOADS.items() if form in p), COEFFICIENTS)


def alike_shapes(frame: StandFrame) -> list[Shape]:
    """Both rotors gain or lose by one share (each draws less through the other), or the lower one alone.

    Not each load by its own, which is what a fit comes to by itself: a rival with three numbers more would be
    behind what one number explains as well.
    """
    forms: tuple[Shape, ...] = ({}, {"decay": 1.0})
    alike = [{"alike": 1.0, **place, **form} for place in _places(frame) for form in forms]
    return [*alike, *({"whole": 1.0, **form} for form in forms)]


def _places(frame: StandFrame) -> list[Shape]:
    """Where the nuisance model may hold."""
    return [{}] if frame.free_nuisance else [{"apart": a} for a in APART]


def _spacing_parameters(frame: StandFrame, shape: Shape, c: Array) -> dict[str, float]:
    reference = float(np.median(frame.columns["rotor_spacing_m"]))  # where the nuisance model holds
    values = dict(zip(_names(shape), map(float, c), strict=True))
    return {**shape, "wake_thrust_share": 0.0, **values, "reference_spacing_m": reference}


def _spacing_inverse(_: StandFrame, p: Numbers) -> tuple[Shape, Array]:
    shape = {k: v for k, v in p.items() if k in (*SPACING, *OF_LOADS)}
    return shape, np.array([p[k] for k in _names(p)])


STAND: Tracing[StandFrame] = Tracing(
    name="rotor_spacing",
    stage=2,
    physics="further apart, the wake has contracted more and the rotors disturb each other less",
    source="wake contraction (Leishman 2006, ch. 2); bench maps of Buzzatto and Liarokapis 2022",
    needs=("rotor_spacing_m",),
    channels=STAND_LOADS,
    units={
        "wake_thrust_share": "1",
        "wake_torque_share": "1",
        "upper_gain_N": "N",
        "reference_spacing_m": "m",
        "decay": "1",
        "apart": "1",
        "alike": "1",
        "whole": "1",
        "loads_share": "1",
        "each": "1",
        "torque_loads_share": "1",
        "upper_loads_share": "1",
        "upper_torque_loads_share": "1",
    },
    missing=_no_spacing,
    shapes=lambda frame: [*_places(frame), *alike_shapes(frame)],
    columns=_spacing_columns,
    parameters=_spacing_parameters,
    inverse=_spacing_inverse,
    refuse=lambda p: outside("wake_thrust_share", p["wake_thrust_share"], -3.0, 3.0),
    cause=lambda frame, _, __: ("rotor_spacing_m", frame.columns["rotor_spacing_m"]),
    free=lambda _, shape: {name: limit for name, limit in SPACING.items() if name in shape},
    variants=_spacing_variants,
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
        if "alike" in p:
            return loads.plus({load: p["loads_share"] * off * loads[load] for load in Load})
        if "whole" in p or "each" in p:
            named = zip((*of_rotor(1), *of_rotor(0)), OF_LOADS["each"], strict=True)
            return loads.plus({load: p.get(name, 0.0) * off * loads[load] for load, name in named})
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
    parameters=(
        Parameter("wake_thrust_share", "1", -3.0, 3.0, (0.0, 0.5),
            source="assumed: less than half of the wake's cost for twice the spacing"),
        Parameter("wake_torque_share", "1", -10.0, 10.0, (0.0, 0.5),
            source="assumed: less than half of the wake's cost for twice the spacing"),
        Parameter("upper_gain_N", "N", -1e4, 1e4,
            source="wide: any value between the bounds; it goes with the rotors' size"),
        Parameter("loads_share", "1", -3.0, 3.0, (0.0, 0.2),
            source="assumed: less than a fifth of a rotor's load for twice the spacing"),
        *(Parameter(name, "1", -3.0, 3.0, (0.0, 0.2),
            source="assumed: less than a fifth of a rotor's load for twice the spacing")
          for name in OF_LOADS["each"][1:]),
        Parameter("alike", "1", 0.0, 1.0, source="a switch, 0 or 1: both rotors by the same share"),
        Parameter("whole", "1", 0.0, 1.0,
            source="a switch, 0 or 1: the lower rotor's whole loads go with it, not its wake's part"),
        Parameter("each", "1", 0.0, 1.0,
            source="a switch, 0 or 1: each of the four loads goes with it by its own share"),
        Parameter("reference_spacing_m", "m", 1e-3, 100.0,
            source="wide: any value between the bounds; spacings are the builder's choice"),
        Parameter("decay", "1", *SPACING["decay"],
            source="wide: any value between the bounds; a wake contracts within 0.3 to 1 radius (Leishman "
                   "2006, ch. 2), of spacings that differ"),
        Parameter("apart", "1", *SPACING["apart"],
            source="wide: any value between the bounds; the model may be of another spacing than the log's"),
    ),
    stand=STAND,
    static=_static,
    required=("wake_thrust_share",),
    surface=0,
)  # fmt: skip
