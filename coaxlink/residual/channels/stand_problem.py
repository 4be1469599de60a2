"""The regression of a stand log, its noise floor, and the variables that its residual may depend on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects import stand_effects
from coaxlink.effects.tracing import Tracing
from coaxlink.frames import STAND_CHANNELS, STAND_UNITS, Array, StandFrame
from coaxlink.residual.channels.stand import base_corrections, held_levels
from coaxlink.residual.regression.joint_model import Part
from coaxlink.residual.regression.problem import Index, Problem, build
from coaxlink.signals import NEIGHBOURS, neighbour_floor, noise_floor

FEW = 3000  # rows: more of them tell their noise by second differences alone


def known_parts(frame: StandFrame) -> tuple[list[Part], list[str]]:
    """The effects that the model carries already, and notes on those that this log cannot evaluate."""
    by_name = {e.name: e for e in stand_effects()}
    parts: list[Part] = []
    notes = []
    for known in frame.model.effects:
        effect = by_name.get(known.name)
        why = "it is none of a stand" if effect is None else effect.missing(frame)
        if effect is None or why is not None:
            notes.append(f"the model's effect {known.name} is left out: {why}")
        else:
            parts.append((effect, known.parameters))
    return parts, notes


def reducing(frame: StandFrame) -> Callable[[Array], Array]:
    """From (frame rows, 6) to (judged rows, C)."""
    keep, present = frame.keep, list(frame.present)
    return lambda columns: np.asarray(columns[keep][:, present])


def stand_problem(frame: StandFrame, effects: Sequence[Tracing[StandFrame]] | None = None) -> Problem:
    """The regression of a stand log: residual of the measured channels at trusted rows."""
    present, keep, reduce = list(frame.present), frame.keep, reducing(frame)
    residual = reduce(frame.measured - frame.predicted)
    _, block = np.unique(frame.block[keep], return_inverse=True)
    nuisance = [(name, bound, reduce(columns)) for name, bound, columns in base_corrections(frame)]
    reference = frame.reference[present]
    floor = stand_floor(frame, _without_nuisance(residual, nuisance))
    problem = build(
        frame=frame,
        channels=[STAND_CHANNELS[c] for c in present],
        units=[STAND_UNITS[c] for c in present],
        reference=reference,
        residual=residual,
        sigma=np.sqrt(floor**2 + (2e-4 * reference) ** 2),
        corrections=nuisance,
        effects=stand_effects() if effects is None else effects,
        reduce=reduce,
        block=block.astype(np.intp),
    )
    clusters = _clusters(frame, problem.block) if frame.free_nuisance else None
    return replace(problem, noise_known=True, fitted_nuisance=frame.free_nuisance, clusters=clusters)


def _clusters(frame: StandFrame, block: Index) -> Index:
    """(kept, C) what a fitted nuisance may miss together: a level of speed that was held, or a block."""
    out = np.zeros((len(block), len(frame.present)), np.intp)
    for k, c in enumerate(frame.present):
        u = frame.speeds[frame.keep, c % 2 if c > 3 else c // 2]
        level = held_levels(u)
        out[:, k] = (block if level is None else level) + out.max() + 1
    return out


def _without_nuisance(residual: Array, nuisance: Sequence[tuple[str, float, Array]]) -> Array:
    """What least squares on the nuisance model columns leaves, channel by channel."""
    out = residual.copy()
    for c in range(residual.shape[1]):
        columns = [values[:, c] for _, _, values in nuisance if np.any(values[:, c])]
        if columns:
            x = np.stack(columns, axis=1)
            out[:, c] -= x @ np.linalg.lstsq(x, residual[:, c], rcond=1e-10)[0]
    return out


def stand_variables(frame: StandFrame) -> dict[str, Array]:
    """(kept,) recorded variables that a residual may still depend on."""
    out = {"time_s": frame.time_s, "upper_speed": frame.speeds[:, 0], "lower_speed": frame.speeds[:, 1]}
    out |= {
        name: values
        for name, values in frame.columns.items()
        if not name.endswith(("_rpm", "_throttle", "_thrust_N", "_torque_Nm")) and name != "time_s"
    }
    return {name: values[frame.keep] for name, values in out.items() if np.all(np.isfinite(values))}


def stand_floor(frame: StandFrame, left: Array) -> Array:
    """(C,) noise of residuals (kept, C): second differences between neighbours of one sweep.

    Of few rows these say little; there it is taken from neighbours in both speeds (of a speed, in both
    throttles), where the two agree.
    """
    block = np.unique(frame.block[frame.keep], return_inverse=True)[1]
    along = noise_floor(left, block.astype(float), np.full(left.shape[1], 6.0))
    if not 3 * NEIGHBOURS < len(left) < FEW:
        return along
    loads = np.array(frame.present) < 4  # a speed's own noise is in the speeds that rows are neighbours by
    about = neighbour_floor(left, frame.speeds[frame.keep])
    if frame.throttles is not None:
        about = np.where(loads, about, neighbour_floor(left, frame.throttles[frame.keep]))
        loads = np.ones_like(loads)
    return np.where(loads & (about < along * (1.0 + 2.0 / np.sqrt(len(left)))), about, along)
