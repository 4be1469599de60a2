"""What the selection lets in: one effect, hand-made columns, hand-made residuals."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.effects import Parameter, PhysicalEffect, Stage, Tracing
from coaxlink.residual.regression.problem import build
from coaxlink.residual.search.select import select

ROWS = 400


def effect(name, columns):
    """An effect of these columns (rows, channels, 1) whatever the frame."""
    size = Parameter("size", "1", -1e9, 1e9, amount=True, source="any")
    stand = Tracing(
        (), ("one", "two"), lambda _: [{"size": 1.0}], lambda *_: ("", np.zeros(ROWS)),
        adds=lambda _, p: p["size"] * columns[..., 0],
    )  # fmt: skip
    return PhysicalEffect(name, Stage.ROTOR, "", "", (size,), stand=stand).stand


def problem(residual, *effects):
    """Two channels of noise 1, a constant as base, 20 blocks."""
    constants = [(f"c{k}", np.inf, np.ones((ROWS, 1)) * np.eye(2)[k]) for k in (0, 1)]
    return build(
        frame=None, channels=("one", "two"), units=("N", "N"), reference=np.full(2, 100.0), residual=residual,
        sigma=np.ones(2), corrections=constants, effects=effects, reduce=lambda c: c,
        block=np.arange(ROWS) // 20,
    )  # fmt: skip


@pytest.fixture
def noise():
    return np.random.default_rng(3).standard_normal((ROWS, 2))


def names(selection):
    return [m.name for m in selection.members]


@pytest.mark.parametrize(("share", "said"), [(0.03, ["big"]), (0.3, ["big", "small"])])
def test_less_than_a_form_may_err_by_is_no_second_effect(noise, share, said):
    waves = [np.sin(k * np.arange(ROWS) / 7.0)[:, None] * [1.0, 1.0] for k in (1, 3)]
    big, small = (effect(n, w[:, :, None]) for n, w in zip(("big", "small"), waves, strict=True))
    assert names(select(problem(noise + 30.0 * (waves[0] + share * waves[1]), big, small))) == said


@pytest.mark.parametrize(("amount", "left"), [(0.0, None), (0.45, "small")])
def test_what_is_beyond_the_noise_but_too_small_for_a_name_is_kept(noise, amount, left):
    wave = np.sin(np.arange(ROWS) / 7.0)[:, None] * [1.0, 1.0]
    chosen = select(problem(0.5 * noise + amount * wave, effect("small", wave[:, :, None])))
    assert names(chosen) == [] and (chosen.small and chosen.small.option.name) == left
