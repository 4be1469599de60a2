"""A lying tachometer: it shows another speed than the loads and the throttle agree on, from a speed on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.effects.base import Parameter, PhysicalEffect, Stage
from coaxlink.effects.tracing import Array, Shape, Tracing, outside
from coaxlink.frames import STAND_LOADS, StandFrame

ABOVE = tuple(0.05 * k for k in range(5, 17))  # of the full speed: from there on a tachometer lies
SIDES = {"upper": 0, "lower": 1}


def _tachometer_columns(side: int, frame: StandFrame, shape: Shape) -> Array:
    """A reading too high by a share: the loads are those of a slower rotor, the speed channel reads high."""
    u = frame.speeds[:, side]
    out = np.zeros((len(u), 6, 1))
    out[:, :4, 0] = -frame.slope[:, :, side] * (u * (u > shape["above"]))[:, None]
    if frame.throttles is not None:
        throttle = frame.throttles[:, side]  # not the reading itself: it would explain its own noise
        out[:, 4 + side, 0] = throttle * (throttle > shape["above"])
    return out


def _no_second_witness(frame: StandFrame) -> str | None:
    if frame.driven:
        return "speeds are throttles"
    return (
        "no throttle in the log: nothing but the loads could contradict it"
        if frame.throttles is None
        else None
    )


def _tachometer(name: str) -> Tracing[StandFrame]:
    side = SIDES[name]

    def columns(frame: StandFrame, shape: Shape) -> Array:
        return _tachometer_columns(side, frame, shape)

    def refuse(p: Mapping[str, float]) -> str | None:
        return outside("reads_high_by", p["reads_high_by"], -0.8, 3.0)

    return Tracing(
        name=f"lying_tachometer_{name}",
        physics="the tachometer shows another speed than the loads and the throttle agree on",
        source="tachometer",
        needs=(f"{name}_rpm",),
        channels=(*STAND_LOADS, f"{name}_speed"),
        units={"reads_high_by": "1", "above": "1"},
        missing=_no_second_witness,
        shapes=lambda _: [{"above": a} for a in ABOVE],
        columns=columns,
        parameters=lambda _, shape, c: {"reads_high_by": float(c[0]), **shape},
        inverse=lambda _, p: ({"above": p["above"]}, np.array([p["reads_high_by"]])),
        refuse=refuse,
        cause=lambda frame, _, __: (f"{name}_speed", frame.speeds[:, side]),
        flagged=f"{name}_rpm",
    )


def _effect(name: str) -> PhysicalEffect:
    instrument = "an instrument of the stand, not of the vehicle"
    return PhysicalEffect(
        name=f"lying_tachometer_{name}",
        stage=Stage.INSTRUMENT,
        parameters=(
            Parameter("reads_high_by", "1", -0.8, 3.0,
                source="wide: any value between the bounds; a wrong number of poles or blades is any "
                       "ratio, a lost pulse a few per cent"),
            Parameter("above", "1", 0.0, 1.0,
                source="wide: any value between the bounds; the speed from which pulses are lost goes "
                       "with the instrument"),
        ),
        stand=_tachometer(name),
        no_static=instrument,
        no_live=instrument,
    )  # fmt: skip


EFFECTS = tuple(_effect(name) for name in SIDES)
