"""Intervals, weights and the noise floor, against draws whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import TRUTH, eq17, grid

from coaxlink.rotor.fit import Options, least_squares, noise_weights
from coaxlink.rotor.selection import fit_load
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import held_out_error, noise_floor, standard_errors_above, term_intervals

U, V = grid()
TERMS = [f"u_u^{a} u_l^{b}" for a in range(3) for b in range(3)]
X = np.stack([U**a * V**b for a in range(3) for b in range(3)], axis=1)
TRUE = np.array([0.801, 12.402, 64.721, 0, -2.547, 0, -37.502, 0, 2.755])
EVEN = np.ones(len(U))


def test_intervals_cover_the_truth() -> None:
    """150 draws: 95 % +- 4 binomial standard errors for every term, true zeros included."""
    hits = np.zeros(9)
    for seed in range(150):
        y = X @ TRUE + 0.5 * np.random.default_rng(seed).standard_normal(121)
        found = term_intervals(TERMS, X, y, EVEN)
        bounds = np.array([found.bounds[t] for t in TERMS])
        hits += (bounds[:, 0] <= TRUE) & (bounds[:, 1] >= TRUE)
    assert (np.abs(hits / 150 - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 150)).all(), hits / 150


def test_intervals_widen_where_neighbouring_rows_err_alike() -> None:
    """Noise that drifts: an interval made for white noise would be missed by twice its width."""
    random = np.random.default_rng(5)
    hits, widths = 0, []
    for _ in range(100):
        shared = np.repeat(random.standard_normal(11), 11)
        found = term_intervals(TERMS, X, X @ TRUE + 0.5 * shared, EVEN)
        low, high = found.bounds[TERMS[2]]
        hits += low <= TRUE[2] <= high
        widths.append(high - low)
    white = term_intervals(TERMS, X, X @ TRUE + 0.5 * random.standard_normal(121), EVEN).bounds[TERMS[2]]
    assert hits >= 80 and np.median(widths) > 0.5 * np.ptp(white)


@pytest.mark.slow
def test_intervals_cover_the_truth_through_all_of_the_selection() -> None:
    """120 draws of eq. 17's lower thrust, the terms chosen anew in each: 90 % at least for a true term."""
    true = TRUTH["lower.thrust_N"]
    fold = np.repeat(np.arange(11), 11)
    hits = dict.fromkeys(true, 0)
    for seed in range(120):
        y = eq17(U, V)[2] + 0.5 * np.random.default_rng(seed).standard_normal((4, 121))[2]
        fit = fit_load("crm", LoadRows("lower.thrust_N", U, V, y, fold), Options(max_order=2))
        for term, value in true.items():
            low, high = fit.intervals.bounds[term]
            hits[term] += low <= value <= high
    assert all(0.9 <= count / 120 <= 0.99 for count in hits.values()), hits


def test_terms_that_cannot_be_told_apart_are_named() -> None:
    y = X @ TRUE + 0.5 * np.random.default_rng(0).standard_normal(121)
    found = term_intervals(TERMS, X, y, EVEN)
    named = {t for group in found.indistinct for t in group}
    assert {TERMS[8], TERMS[4]} <= named and TERMS[2] not in named
    assert found.standard_error[TERMS[8]] == pytest.approx(8.9, rel=0.25)
    twins = term_intervals(("a", "b", "c"), np.stack([U, U, V], axis=1), U + V, EVEN)
    assert set(twins.bounds) == {"c"} and twins.indistinct == (("a", "b"),)


def test_noise_that_grows_with_the_load_is_weighed() -> None:
    dice = np.random.default_rng(7)
    load = np.abs(X @ TRUE)
    plain, weighed = [], []
    for _ in range(60):
        y = X @ TRUE + (0.05 + 0.02 * load) * dice.standard_normal(len(U))
        weights = noise_weights(X, y, EVEN)
        assert weights[load < 5].mean() > 2 * weights[load > 40].mean()
        plain.append(X @ (least_squares(X, y) - TRUE))
        weighed.append(X @ (least_squares(X, y, weights) - TRUE))
    quiet = load < 10
    assert np.std(np.array(weighed)[:, quiet]) < 0.8 * np.std(np.array(plain)[:, quiet])


def test_even_noise_and_few_rows_are_left_even() -> None:
    dice = np.random.default_rng(8)
    touched = 0
    for _ in range(300):
        y = X @ TRUE + 0.5 * dice.standard_normal(len(U))
        touched += not np.array_equal(noise_weights(X, y, EVEN), EVEN)
    assert touched <= 3
    assert np.array_equal(noise_weights(X[:22], X[:22] @ TRUE, EVEN[:22]), EVEN[:22])


def test_the_noise_floor_is_the_noise_and_leaves_out_what_neighbours_share() -> None:
    dice = np.random.default_rng(9)
    floors = [noise_floor(U, V, 3.0 * U + 0.5 * dice.standard_normal(121)) for _ in range(20)]
    assert np.mean(floors) == pytest.approx(0.53, abs=0.03)
    assert noise_floor(U[:3], V[:3], U[:3]) == 0.0


def test_errors_count_known_rows_only() -> None:
    found = held_out_error(np.array([1.0, 2.0, 3.0, np.nan]), np.array([1.0, 2.0, 5.0, 9.0]))
    assert found.held_out_rows == 3 and found.rmse == pytest.approx(np.sqrt(4 / 3))
    assert found.nrmse == pytest.approx(found.rmse / 2)
    assert held_out_error(np.array([np.nan]), np.array([1.0])).held_out_rows == 0


def test_one_loss_above_another_in_standard_errors() -> None:
    other = np.array([1.0, 1.0, 1.0, 1.0])
    errors = np.array([[2.0, 1.0, 2.0], [2.0, 1.0, 0.0], [2.0, 1.0, 2.0], [2.0, 1.0, 2.0]])
    above = standard_errors_above(errors, other)
    assert above[0] == np.inf and above[1] == 0.0
    assert above[2] == pytest.approx(2.0 / (1.0 * np.sqrt(4)))
