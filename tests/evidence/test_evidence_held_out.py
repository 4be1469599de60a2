"""Held-out errors, and numbers with intervals, of a set of explanations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coaxlink.evidence.held_out import Regression, contiguous_blocks, error_interval, folds_of
from coaxlink.residual.answer.report import _against_limit
from coaxlink.residual.diagnosis.flight_forms import period_of

FREE = np.full(3, np.inf)


def regression(rng, rows=600, deviation=FREE):
    columns = rng.standard_normal((rows, 2, 3))
    columns[:, 1, 2] = 0.0
    target = columns @ np.array([0.5, -1.0, 2.0]) + 0.1 * rng.standard_normal((rows, 2))
    block = rng.permutation(np.repeat(np.arange(12), rows // 12))
    return Regression(columns, target, np.zeros(3), deviation, np.array([1.0, 1.0]), block)


def least_squares(x, y):
    return np.linalg.lstsq(x.reshape(-1, x.shape[-1]), y.reshape(-1), rcond=None)[0]


def test_values_are_the_least_squares_of_the_rows_and_priors_pull():
    r = regression(np.random.default_rng(0))
    assert r.values == pytest.approx(least_squares(r.columns, r.target), abs=1e-6)
    pulled = replace(r, mean=np.array([0.1, 0.0, 0.0]), deviation=np.array([1e-4, np.inf, np.inf]))
    rest = r.target - 0.1 * r.columns[..., 0]
    assert pulled.values[0] == pytest.approx(0.1, abs=1e-3)
    assert pulled.values[1:] == pytest.approx(least_squares(r.columns[..., 1:], rest), abs=1e-3)
    assert r.only(np.array([2, 0])).values == pytest.approx(
        least_squares(r.columns[..., [2, 0]], r.target), abs=1e-6
    )


def test_held_out_errors_are_of_fits_that_did_not_see_the_block():
    r = regression(np.random.default_rng(2))
    fold = folds_of(12)[r.block]
    for f in np.unique(fold):
        fit = least_squares(r.columns[fold != f], r.target[fold != f])
        mine = fold == f
        assert r.held_out[mine] == pytest.approx(r.target[mine] - r.columns[mine] @ fit, abs=1e-6)
    assert r.errors == pytest.approx(np.sqrt(np.mean(r.held_out**2, axis=0)))


def test_intervals_cover_the_error_they_are_of():
    rng, block = np.random.default_rng(5), np.repeat(np.arange(30), 50)
    hits = 0
    for seed in range(100):
        low, high = error_interval(rng.standard_normal(1500), block, seed=seed)
        hits += low <= 1.0 <= high
    assert 84 <= hits <= 100


def test_blocks_are_contiguous_and_never_span_a_gap():
    time = np.concatenate([np.arange(0, 30, 0.1), np.arange(100, 107, 0.1)])
    run = np.concatenate([np.zeros(300), np.ones(70)]).astype(int)
    block = contiguous_blocks(time, run, least_s=3.0, count=40)
    assert np.all(np.diff(block) >= 0) and np.all(np.diff(block) <= 1)
    assert block[299] != block[300]
    lengths = np.bincount(block)
    assert lengths.min() >= 25 and lengths.max() <= 45


def test_what_the_rows_do_not_tell_has_the_width_of_its_prior():
    """Two columns that are one: rows say the sum, a prior of 0.02 holds the second."""
    rng = np.random.default_rng(4)
    column = rng.standard_normal((600, 1, 1))
    target = column[..., 0] + 0.1 * rng.standard_normal((600, 1))
    both, deviation = column.repeat(2, axis=2), np.array([np.inf, 0.02])
    drawn = Regression(both, target, np.zeros(2), deviation, np.array([0.1]), np.arange(600) // 50).drawn(400)
    assert np.std(drawn[:, 1]) == pytest.approx(0.02, rel=0.15)
    assert np.std(drawn.sum(axis=1)) < 0.01


def test_columns_that_are_one_have_the_shortest_solution():
    rng = np.random.default_rng(6)
    column = rng.standard_normal((600, 1, 1))
    r = Regression(
        column.repeat(2, axis=2), column[..., 0], np.zeros(2), FREE[:2], np.ones(1), np.arange(600) // 50
    )
    assert r.values == pytest.approx([0.5, 0.5], abs=1e-3)


def test_a_period_is_a_line_and_a_wander_is_none():
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(600)
    wander = np.convolve(rng.standard_normal(700), np.ones(100) / 10.0, "valid")[:600]
    chance = [found[2] for found in (period_of(noise), period_of(wander)) if found]
    assert all(log_evidence < 5.0 for log_evidence in chance)
    seconds, rms, log_evidence = period_of(noise + 1.5 * np.sin(np.arange(600) / 3.0))
    assert seconds == pytest.approx(6.0 * np.pi, rel=0.02) and rms == pytest.approx(1.06, rel=0.15)
    assert log_evidence > 50.0


@pytest.mark.parametrize("limit", [0.4, 2.0])
def test_a_number_at_its_limit_has_an_interval_of_one_side(limit):
    beyond = limit + np.sign(limit - 1.0) * np.abs(np.random.default_rng(1).normal(0.1, 0.02, 200))
    low, high = _against_limit(limit, (0.4, 2.0), beyond)
    assert limit in (low, high) and 0.001 < high - low < 0.04 and 0.4 <= low < high <= 2.0
    assert _against_limit(limit, (0.4, 2.0), limit + 10.0 * (beyond - limit))[0] >= 0.4
