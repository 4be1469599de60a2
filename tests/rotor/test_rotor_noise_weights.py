"""Weights from the measured noise: of use where it grows with the load, absent where it does not."""

import numpy as np

from coaxlink.rotor.fit import least_squares, noise_weights

LEVELS = np.arange(11) * 0.09
U, V = (g.ravel() for g in np.meshgrid(LEVELS, LEVELS, indexing="ij"))
X = np.stack([np.ones_like(U), U, U**2, V, V**2, U * V], axis=1)
TRUE = np.array([0.5, -2.0, -30.0, 12.0, 65.0, -3.0])
EVEN = np.ones(len(U))


def test_noise_that_grows_with_the_load_is_weighed():
    dice = np.random.default_rng(7)
    plain, weighed = [], []
    for _ in range(60):
        y = X @ TRUE + (0.05 + 0.02 * np.abs(X @ TRUE)) * dice.standard_normal(len(U))
        weights = noise_weights(X, y, EVEN)
        low, high = np.abs(X @ TRUE) < 5, np.abs(X @ TRUE) > 40
        assert weights[low].mean() > 2 * weights[high].mean()
        plain.append(least_squares(X, y, EVEN) - TRUE)
        weighed.append(least_squares(X, y, weights) - TRUE)
    assert np.sqrt(np.mean(np.square(weighed))) < 0.8 * np.sqrt(np.mean(np.square(plain)))


def test_even_noise_is_left_even():
    dice = np.random.default_rng(8)
    touched = 0
    for _ in range(300):
        y = X @ TRUE + 0.5 * dice.standard_normal(len(U))
        touched += not np.array_equal(noise_weights(X, y, EVEN), EVEN)
    assert touched <= 3


def test_too_few_rows_are_left_even():
    assert np.array_equal(noise_weights(X[:22], X[:22] @ TRUE, EVEN[:22]), EVEN[:22])
