"""The marginal likelihood, the colour of noise and the processes, each against what defines it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from coaxlink.evidence.blocks import products, waves
from coaxlink.evidence.likelihood import Base, fitted
from coaxlink.evidence.likelihood import _cholesky as cholesky
from coaxlink.evidence.noise import colour_of
from coaxlink.residual.diagnosis.screening import Stack


@pytest.fixture
def data():
    random = np.random.default_rng(1)
    columns = random.normal(size=(40, 2, 5))
    columns[:, 0, 3:] = 0.0  # of the second channel alone
    columns[:, 1, 1] = 0.0  # of the first
    deviation = np.array([1.0, 0.5, 2.0, 1.5, 0.1])
    noise = np.array([0.3, 0.8])
    target = columns @ (deviation * random.normal(size=5)) + noise * random.normal(size=(40, 2))
    return columns, target, deviation, noise


def model(columns, target, deviation, noise, rounds):
    """Fitted, the last two columns as what comes beside the others."""
    base, more = Base(columns[..., :3], deviation[:3]), (columns[..., 3:], deviation[3:])
    channels = base.beside([more], target, np.full(2, float(len(target))))
    return fitted(channels, deviation, noise, np.full(2, 1e-9), rounds=rounds)


def of_definition(columns, target, deviation, noise):
    """log N(y; 0, X P X' + N), the rows of both channels stacked."""
    x = columns.transpose(1, 0, 2).reshape(-1, columns.shape[-1])
    n = np.repeat(noise**2, columns.shape[0])
    return multivariate_normal(cov=(x * deviation**2) @ x.T + np.diag(n)).logpdf(target.T.ravel())


def test_the_evidence_is_that_of_its_definition(data):
    columns, target, deviation, noise = data
    fit = model(columns, target, deviation, noise, rounds=0)
    assert fit.log_evidence == pytest.approx(of_definition(columns, target, deviation, noise), rel=1e-9)


def test_the_noise_levels_are_at_their_best(data):
    columns, target, deviation, noise = data
    fit = model(columns, target, deviation, noise, rounds=60)
    best = of_definition(columns, target, deviation, fit.noise)
    for moved in ([1.05, 1.0], [0.95, 1.0], [1.0, 1.05], [1.0, 0.95]):
        assert of_definition(columns, target, deviation, fit.noise * moved) < best


def test_the_posterior_and_what_it_takes_of_other_columns_are_those_of_their_definitions(data):
    columns, target, deviation, noise = data
    fit = model(columns, target, deviation, noise, rounds=0)
    x = columns / noise[:, None]
    precision = np.einsum("rca,rcb->ab", x, x) + np.diag(deviation**-2.0)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(precision), rtol=1e-7)
    means = np.linalg.solve(precision, np.einsum("rca,rc->a", x, target / noise))
    np.testing.assert_allclose(fit.values, means, rtol=1e-7)
    products = np.random.default_rng(4).normal(size=(5, 3))
    half = fit.half(products)
    np.testing.assert_allclose(half.T @ half, products.T @ np.linalg.solve(precision, products), rtol=1e-7)


def test_columns_more_gain_what_the_larger_model_has_more(data):
    columns, target, deviation, noise = data
    few, more = columns[..., :3], columns[..., 3:]
    small = model(few, target, deviation[:3], noise, rounds=0)
    large = model(columns, target, deviation, noise, rounds=0)
    left = target - few @ small.values
    stack = Stack([(more, deviation[3:]), (more[..., :1], deviation[3:4])])
    gain, one = stack.gains(SimpleNamespace(fit=small, whitened=lambda c: few[:, c]), left)
    middle = model(columns[..., :4], target, deviation[:4], noise, rounds=0)
    assert one == pytest.approx(middle.log_evidence - small.log_evidence, abs=1e-5)
    assert gain == pytest.approx(large.log_evidence - small.log_evidence, abs=1e-5)


def test_noise_that_rings_is_made_white_and_white_noise_stays():
    random = np.random.default_rng(2)
    white = random.normal(size=(4000, 2))
    rung = white[:, 0].copy()
    for k in range(2, len(rung)):
        rung[k] += 1.2 * rung[k - 1] - 0.7 * rung[k - 2]
    both = np.stack([rung, white[:, 1]], axis=1)
    left = colour_of(both).whiten(both)[10:]
    bound = 5.0 / np.sqrt(len(left))
    for c in (0, 1):
        for lag in (1, 2, 3):
            assert abs(np.corrcoef(left[lag:, c], left[:-lag, c])[0, 1]) < bound
    assert np.std(left[:, 0]) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("length", [0.1, 0.35])
def test_waves_are_the_process_that_they_stand_for(length):
    x = np.linspace(-2.0, 5.0, 200)
    functions, deviation = waves(x, length)
    along = (x + 2.0) / 7.0
    total = np.zeros((200, 200))
    for mirrored in (along, -along, 2.0 - along):  # at the ends of the range
        total += np.exp(-0.5 * (np.subtract.outer(along, mirrored) / length) ** 2)
    assert np.max(np.abs((functions * deviation**2) @ functions.T - total)) < 0.03


def test_a_product_of_processes_has_the_product_of_their_covariances():
    random = np.random.default_rng(3)
    first, second = waves(random.uniform(size=30), 0.3), waves(random.uniform(size=30), 0.5)
    functions, deviation = products(first, second)
    one, two, both = ((f * d**2) @ f.T for f, d in (first, second, (functions, deviation)))
    assert np.max(np.abs(both - one * two)) < 0.02


def test_a_wander_beside_white_noise_is_foretold_and_a_trend_is_none():
    random = np.random.default_rng(5)
    rows = 3000
    wander = lfilter([0.1], [1.0, -0.99], random.normal(size=rows))
    colour = colour_of((wander + random.normal(size=rows))[:, None])
    (found,) = colour.wander
    assert found is not None
    left = colour.whiten((wander + random.normal(size=rows))[:, None])[200:, 0]
    power = np.abs(np.fft.rfft(left - left.mean())) ** 2
    assert np.mean(power[1:30]) < 2.0 * np.mean(power[300:])
    trend = np.linspace(-5.0, 5.0, rows)
    kept = colour.whiten(trend[:, None])[500:, 0]
    assert np.ptp(kept) > 0.0  # what a noise that forgets foretells of a trend leaves the trend's slope
    assert colour_of(random.normal(size=(rows, 1))).size == 0


def test_rounding_alone_costs_no_factor_and_what_is_no_matrix_of_products_has_none():
    column = np.linspace(0.0, 1.0, 30)
    gram = 1e9 * np.outer(column, column) + np.eye(30) * 1e-9  # below what rounding leaves of the diagonal
    gram[3, 3] -= 1e-4
    factor = cholesky(gram)
    np.testing.assert_allclose(factor @ factor.T, gram, atol=1e-6 * gram.max())
    with pytest.raises(np.linalg.LinAlgError):
        cholesky(np.diag([1.0, -1.0]))
