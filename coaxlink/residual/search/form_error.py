"""Model-form error: what the form of a large effect may miss, a rival of every small effect beside it.

A spacing that takes a tenth of the thrust, in a form that is off by a tenth, leaves one per cent that changes
from run to run: over the time it looks like a cell that drifts. So a member that is small beside another
must be needed still where that one's cause may act on the same loads in a freer form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coaxlink.frames import Array, StandFrame
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.joint_model import Joint
from coaxlink.residual.regression.problem import Option, from_design
from coaxlink.residual.search.time_trend import free_trend
from coaxlink.residual.search.trial import ALPHA, Judge, columns_of

SMALL = 0.25  # of what the other adds to the load that the smaller one changes most
MISSED = 0.1  # of the reference load, a deviation
LEVELS = 8  # a cause with more of them is continuous: its first two powers


def within_forms(joint: Joint, frame: StandFrame) -> set[str]:
    """Names of members that are needless beside a freer form of a larger one."""
    q, found = joint.problem, set()
    members = list(q.options)
    if len(members) < 2:
        return set()
    judge = Judge(q)
    fit = solve(q.blocks, columns_of(q, members), np.ones(q.blocks.count))
    worth = {m.name: judge.worth_of(m.columns, fit) for m in members}
    for small in members:
        c = int(np.argmax(worth[small.name]))
        rest = [m for m in members if m is not small]
        for large in rest:
            if worth[small.name][c] >= SMALL * worth[large.name][c]:
                continue
            added = _freely(joint, large, frame)
            at = q.design.shape[-1]
            free = Option(free_trend, {}, np.arange(at, at + added.shape[-1]))
            design = np.concatenate([q.design, added.astype(q.design.dtype)], axis=-1)
            beside = from_design(q, design, q.residual, [*q.options, free], frame=q.frame)
            bounds = beside.blocks.bounds.copy()
            bounds[at:] = -2.0 * MISSED  # a level that a fold has not seen is not known to it
            beside = replace(beside, blocks=replace(beside.blocks, bounds=bounds))
            still = Judge(beside).trial([*rest, free], small)
            if still.gain <= 0.0 or still.p_value > ALPHA:
                found.add(small.name)
    return found


def _freely(joint: Joint, large: Option, frame: StandFrame) -> Array:
    """(rows, C, K) whitened: its cause times squares and product of the speeds, in every load it acts on."""
    q = joint.problem
    acts = np.flatnonzero(np.any(q.design[:, :, large.columns] != 0.0, axis=(0, 2)))
    u = frame.speeds[frame.keep]
    loads = np.stack([np.ones(len(u)), u[:, 0] ** 2, u[:, 1] ** 2, u[:, 0] * u[:, 1]], axis=1)
    pieces = []
    for c in acts:
        cause = large.effect.cause(frame, large.shape, q.channels[c])[1][frame.keep]
        z = (cause - np.mean(cause)) / max(float(np.std(cause)), 1e-12)
        level = np.unique(np.round(z, 2), return_inverse=True)[1]
        few = level.max() < LEVELS
        powers = np.eye(level.max() + 1)[level][:, 1:] if few else np.stack([z, z**2 - 1.0], axis=1)
        mine = (powers[:, :, None] * loads[:, None, :]).reshape(len(u), -1)
        out = np.zeros((len(u), len(q.channels), mine.shape[1]))
        out[:, c] = mine * q.reference[c] / q.sigma[c]
        pieces.append(out)
    return np.concatenate(pieces, axis=-1)
