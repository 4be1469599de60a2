"""Iteratively reweighted least squares: each channel weighted by its own residual, the last fit of a flight.

The selection whitens by the noise, but by no less than 0.1 % of a channel's reference load, lest a form that
is off by little decide everything by the sharpest channel. A gyro tells torque ten times finer than that.
Once the effects stand, every channel counts by the error that remains in it, which is the likelihood of a
normal error of unknown size: what the torques tell of inertia, level and form is heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.effects.tracing import Array
from coaxlink.residual.regression.blocks import held_out
from coaxlink.residual.regression.problem import Option, Problem

ROUNDS = 3
LEAST = 0.02  # of the whitening before: no channel is ever believed finer


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
    out = nuisance_of(p, p.sigma)
    for _ in range(ROUNDS):
        sigma = np.maximum(channel_errors(out, ()), LEAST * p.sigma)
        out = reweighted(out, sigma)
    return out


def nuisance_of(p: Problem, sigma: Array) -> Problem:
    """The problem's rows and base at other scales, no options: all that a joint fit asks of it."""
    small = p.blocks.only(p.nuisance)
    only = replace(
        p, design=p.design[:, :, p.nuisance], blocks=small, nuisance=np.arange(len(p.nuisance)), options=()
    )
    return reweighted(only, sigma)
