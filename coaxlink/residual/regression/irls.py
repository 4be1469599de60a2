"""Iteratively reweighted least squares: each channel weighted by its own residual, the last fit of a flight.

The selection whitens by the noise, but by no less than 0.1 % of a channel's reference load, lest a form that
is off by little decide everything by the sharpest channel. A gyro tells torque ten times finer than that.
Once the effects stand, every channel counts by the error that remains in it, which is the likelihood of a
normal error of unknown size: what the torques tell of inertia, level and form is heard.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.effects.tracing import Array
from coaxlink.residual.regression.blocks import held_out
from coaxlink.residual.regression.joint_model import Fitter, Joint, Part, fit
from coaxlink.residual.regression.problem import Option, Problem

ROUNDS = 3
MOVED = {"mass_change", "cg_offset"}  # what was moved or added turns as well
ROUGH = 3.0  # times the bound of a declared inertia, then
LEAST = 0.02  # of the whitening before: no channel is ever believed finer
SETTLED = 0.01  # change of a channel's error


def channel_errors(p: Problem, options: Sequence[Option]) -> Array:
    """(C,) held-out rms of every channel, in its unit."""
    use = np.concatenate([p.nuisance, *(o.columns for o in options)]).astype(np.intp)
    squares = held_out(p.blocks, use)[0].sum(axis=0)
    return np.asarray(np.sqrt(squares / p.blocks.rows.sum()) * p.sigma)


def reweighted(p: Problem, sigma: Array) -> Problem:
    """The problem whitened by other scales (C,)."""
    ratio = p.sigma / sigma
    blocks = replace(
        p.blocks,
        gram=tuple(gram * scale for gram, scale in zip(p.blocks.gram, ratio**2, strict=True)),
        moment=p.blocks.moment * (ratio**2)[:, None],
        power=p.blocks.power * ratio**2,
    )
    design = p.design * ratio[:, None].astype(p.design.dtype)
    return replace(p, sigma=sigma, design=design, residual=p.residual * ratio, blocks=blocks)


def settled_nuisance(p: Problem) -> Problem:
    """The nuisance model alone by IRLS: every channel weighted by its own residual."""
    out = _nuisance_of(p, p.sigma)
    for _ in range(ROUNDS):
        sigma = np.maximum(channel_errors(out, ()), LEAST * p.sigma)
        out = reweighted(out, sigma)
    return out


def reweighted_fit(
    joint: Joint,
    problem: Problem,
    bare: Any,
    fixed: Sequence[Part],
    reduce: Callable[[Array], Array],
    nuisance: Callable[[Any, Callable[[Array], Array]], Array],
    *,
    alternatives: bool,
) -> Joint:
    """The joint fit by IRLS, linearised again about its members each round."""
    best, errors = joint, channel_errors(joint.problem, joint.problem.options)
    for number in range(ROUNDS if alternatives else 1):  # of a long log one round is as good
        sigma = np.maximum(errors, LEAST * problem.sigma)
        rough = ROUGH if MOVED & {m.name for m in best.members} else 1.0
        about = _nuisance_of(problem, sigma, rough)
        fitter = Fitter(about, bare, fixed, reduce)
        columns = nuisance(fitter.acting(best.members), reduce) / sigma[:, None]
        fitter = Fitter(about, bare, fixed, reduce, columns)
        trial = fit(fitter, best.members, alternatives=alternatives and number == 0)
        now = channel_errors(trial.problem, trial.problem.options)
        if not np.sum(np.log(now)) < np.sum(np.log(errors)):
            break
        done = bool(np.max(np.abs(now / errors - 1.0)) < SETTLED)
        best, errors = trial, now
        if done:
            break
    return best


def _nuisance_of(p: Problem, sigma: Array, rough: float = 1.0) -> Problem:
    """The problem's rows and base at other scales, no options: all that a joint fit asks of it.

    `rough` widens what inertia may be off by.
    """
    wider = np.array([rough if name.startswith("inertia_") else 1.0 for name in p.nuisance_names])
    small = p.blocks.only(p.nuisance)
    small = replace(small, bounds=small.bounds * wider)
    only = replace(
        p, design=p.design[:, :, p.nuisance], blocks=small, nuisance=np.arange(len(p.nuisance)), options=()
    )
    return reweighted(only, sigma)
