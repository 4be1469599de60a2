"""What a stand's model knows already, its judged rows, and the variables that a residual may depend on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coaxlink.effects import NotShown, stand_effects
from coaxlink.frames import Array, StandFrame
from coaxlink.residual.regression.joint_model import Part


def known_parts(frame: StandFrame) -> tuple[list[Part], list[str]]:
    """The effects that the model carries already, and notes on those that this log cannot evaluate."""
    by_name = {e.name: e for e in stand_effects()}
    parts: list[Part] = []
    notes = []
    for known in frame.model.effects:
        effect = by_name.get(known.name)
        try:
            if effect is None:
                raise NotShown("it is none of a stand")
            effect.starts(frame)
            parts.append((effect, effect.completed(frame, known.parameters)))
        except NotShown as why:
            notes.append(f"the model's effect {known.name} is left out: {why}")
    return parts, notes


def reducing(frame: StandFrame) -> Callable[[Array], Array]:
    """From (frame rows, 6) to (judged rows, C)."""
    keep, present = frame.keep, list(frame.present)
    return lambda columns: np.asarray(columns[keep][:, present])


def stand_variables(frame: StandFrame) -> dict[str, Array]:
    """(kept,) recorded variables that a residual may still depend on."""
    out = {"time_s": frame.time_s, "upper_speed": frame.speeds[:, 0], "lower_speed": frame.speeds[:, 1]}
    out |= {
        name: values
        for name, values in frame.columns.items()
        if not name.endswith(("_rpm", "_throttle", "_thrust_N", "_torque_Nm")) and name != "time_s"
    }
    return {name: values[frame.keep] for name, values in out.items() if np.all(np.isfinite(values))}
