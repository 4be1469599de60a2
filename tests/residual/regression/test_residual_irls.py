"""Channels weighed by what they are left with: two channels made by hand, one of them ten times sharper."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.residual.regression.blocks import accumulate, solve
from coaxlink.residual.regression.irls import channel_errors, reweighted, settled_nuisance
from coaxlink.residual.regression.problem import Problem

ROWS, BLOCKS = 2400, 24


def two_channels(noise=(0.3, 0.004), whitening=(0.3, 0.04)):
    """One number, 0.02, seen by both channels; the second is sharp but whitened as if it were not."""
    random = np.random.default_rng(5)
    cause = random.standard_normal((ROWS, 2))
    told = 0.02 * cause + random.standard_normal((ROWS, 2)) * noise
    sigma = np.array(whitening)
    block = np.arange(ROWS) * BLOCKS // ROWS
    design, residual = (cause / sigma)[..., None], told / sigma
    bounds = np.array([0.5])
    blocks = accumulate(design, residual, block, np.arange(BLOCKS) % 6, bounds)
    return Problem(
        frame=None, channels=("a", "b"), units=("N", "N m"), reference=np.ones(2), sigma=sigma, design=design,
        residual=residual, block=block, blocks=blocks,
        nuisance=np.array([0]), nuisance_names=("x",), options=(),
        impossible=(),
    )  # fmt: skip


def value(p):
    return float(solve(p.blocks, p.nuisance, np.ones(p.blocks.count))[0])


def test_errors_are_in_the_channels_units_whatever_the_whitening():
    p = two_channels()
    q = reweighted(p, p.sigma * 2.0)  # both alike: the same fit
    assert channel_errors(q, ()) == pytest.approx(channel_errors(p, ()), rel=1e-4)
    assert channel_errors(p, ()) == pytest.approx([0.3, 0.004], rel=0.05)


def test_a_sharp_channel_is_heard():
    p = two_channels()
    q = settled_nuisance(p)
    assert q.sigma == pytest.approx([0.3, 0.004], rel=0.05)
    own = np.sum(p.design[:, 1, 0] * p.residual[:, 1]) / np.sum(p.design[:, 1, 0] ** 2)  # by itself
    assert value(q) == pytest.approx(own, abs=3e-5)
    assert abs(value(q) - 0.02) < 3e-4


def test_no_channel_is_believed_beyond_measure():
    q = settled_nuisance(two_channels(noise=(0.3, 1e-9)))
    assert q.sigma[1] == pytest.approx(0.02 * 0.04)
