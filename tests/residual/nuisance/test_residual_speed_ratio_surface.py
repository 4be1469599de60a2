"""Surfaces over the ratio of the speeds: what a damaged load asks for."""

from __future__ import annotations

import numpy as np

from coaxlink.residual.nuisance.speed_ratio_surface import find_surface

TERMS = ("1", "u_u", "u_l", "u_u^2", "u_l^2", "u_u u_l")


def test_a_load_that_reads_nothing_asks_for_no_surface(capfd):
    """Nor does LAPACK say a word of numbers that are none."""
    speeds = np.random.default_rng(1).uniform(0.1, 1.0, (400, 2))
    assert find_surface(speeds, np.zeros(400), TERMS) is None
    assert capfd.readouterr() == ("", "")


def test_a_load_that_falls_beyond_a_ratio_asks_for_one():
    speeds = np.random.default_rng(1).uniform(0.1, 1.0, (400, 2))
    ratio = np.arctan2(speeds[:, 1], speeds[:, 0])
    load = 50.0 * speeds[:, 1] ** 2 - 3.0 * np.sum(speeds**2, axis=1) * np.tanh((ratio - 0.6) / 0.09)
    surface = find_surface(speeds, load, TERMS)
    assert surface is not None
    assert surface(speeds).shape == (400,)
