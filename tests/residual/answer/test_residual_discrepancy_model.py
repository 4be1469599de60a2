"""Own fits of pairs that polynomials do not follow, and rows that no other row tells of."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import steady_loads
from residual_stand_logs import log_of, names, over, ramps

from coaxlink.residual import refine_stand
from coaxlink.residual.nuisance.gaussian_process import find_process
from coaxlink.residual.regression.blocks import folds_of
from coaxlink.rotor.polynomial import design_matrix

TERMS = ("1", "u_u", "u_l", "u_u^2", "u_l^2", "u_u u_l")


def rough(a, b):
    """Loads of a pair whose blades stall at a ratio of the speeds, the earlier the slower they are."""
    loads = steady_loads(a, b)
    ratio = np.arctan2(b, a + 1e-9)
    loads[2] -= 3.0 * (a**2 + b**2) * np.tanh((ratio - 0.5 - 0.1 * a) / 0.09)
    loads[3] -= 0.12 * (a**2 + b**2) * np.tanh((ratio - 0.4 + 0.1 * a) / 0.06)
    loads[1] += 0.04 * np.tanh((a - 0.45) / 0.09)
    return loads


def test_a_process_says_how_well_it_knows_a_row():
    rng = np.random.default_rng(4)
    u = rng.uniform(0.15, 0.95, (600, 2))
    u[580:, 1] = 0.02 * u[580:, 0]  # one piece of the log alone shows a lower rotor this slow
    fold = folds_of(30)[np.arange(600) // 20]
    load = rough(*u.T)[3] + 0.006 * rng.standard_normal(600)
    process, deviation = find_process(u, load, fold, 0.006, 1.5, TERMS, True)
    assert np.median(deviation[:580]) < 0.6
    assert np.median(deviation[580:]) > 1.0
    share = design_matrix(TERMS, *u.T).T @ process.columns(u)
    assert np.max(np.abs(share)) < 1e-6 * len(u)


@pytest.mark.slow
def test_a_fitted_nuisance_that_polynomials_follow_stays_one():
    t, a, b = ramps(900)
    answer = refine_stand(log_of(t, a, b, steady_loads(a, b)))
    assert names(answer) == [] and over(answer) < 1.1
    assert not any("Gaussian process" in note for note in answer.notes)


def test_a_short_log_of_a_lower_rotor_at_one_speed_flags_nobody():
    """Its load goes up and down with the upper rotor's wake; the tachometer is right."""
    a = np.random.default_rng(0).uniform(0.1, 0.95, 24)
    answer = refine_stand(log_of(2.0 * np.arange(24.0), a, 0.0 * a + 0.5, rough(a, 0.0 * a + 0.5)))
    assert names(answer) == [] and answer.suspect_data == ()
