"""What a slow quantity is without the noise of its sensor."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.signals import without_row_noise


@pytest.mark.parametrize("rows", [300, 2001])
def test_a_slow_quantity_loses_most_of_its_sensors_noise(rows):
    x = np.linspace(0.0, 1.0, rows)
    slow = 15.0 + 10.0 * (1.0 - np.exp(-3.0 * x))
    read = slow + 0.1 * np.random.default_rng(rows).standard_normal(rows)
    assert np.std(without_row_noise(read) - slow) < 0.3 * np.std(read - slow)


def test_what_moves_from_row_to_row_comes_back_as_it_is():
    x = np.linspace(0.0, 1.0, 500)
    for values in (np.exp(x), np.where(x > 0.5, 1.0, 0.9), np.full(500, 3.0), x[:5], np.full(500, np.nan)):
        assert np.array_equal(without_row_noise(values), values, equal_nan=True)
