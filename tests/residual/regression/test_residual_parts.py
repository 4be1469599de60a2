"""The parts of `refine`: filters, noise floor, blocks, bounded least squares, effects."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.residual.answer.assemble import _against_limit
from coaxlink.residual.regression.blocks import (
    accumulate,
    bootstrap,
    error_interval,
    held_out,
    solve,
    squares,
)
from coaxlink.residual.regression.dependence import dependences
from coaxlink.residual.regression.problem import contiguous_blocks
from coaxlink.signals import (
    derivative,
    difference_gain,
    lagged,
    low_pass,
    noise_floor,
    spectral_floor,
)


def test_low_pass_has_no_delay_and_half_power_where_it_should():
    t = np.arange(0, 20, 0.02)
    for hertz, gain in ((0.5, 1.0), (4.0, 0.5), (12.0, 0.01)):
        wave = np.sin(2 * np.pi * hertz * t)[:, None]
        out = low_pass(wave, 50.0, 4.0)[200:-200, 0]
        inner = wave[200:-200, 0]
        assert out @ inner / (inner @ inner) == pytest.approx(gain, abs=0.02)
        other = np.cos(2 * np.pi * hertz * t)[200:-200]
        assert abs(out @ other) / (other @ other) < 5e-3


def test_lag_of_a_step_and_a_ramp():
    t = np.arange(0, 1, 0.001)
    step = (t >= 0.1).astype(float)[:, None]
    out = lagged(step, 0.001, 0.05)[:, 0]
    assert out[np.searchsorted(t, 0.15)] == pytest.approx(1 - np.exp(-1), abs=0.012)
    ramp = lagged(t[:, None], 0.001, 0.05)[:, 0]
    assert ramp[-1] == pytest.approx(t[-1] - 0.05, abs=1e-6)
    assert lagged(np.full((9, 2), 0.7), 0.02, 0.05) == pytest.approx(0.7)


def test_derivative_is_exact_where_the_low_pass_lets_through():
    t = np.arange(0, 10, 0.02)
    for hertz in (0.5, 2.0, 4.0):
        rate = derivative(np.sin(2 * np.pi * hertz * t), 50.0)[5:-5]
        want = 2 * np.pi * hertz * np.cos(2 * np.pi * hertz * t)[5:-5]
        assert np.abs(rate - want).max() < 3e-4 * np.abs(want).max()


@pytest.mark.parametrize("differentiated", [False, True])
def test_noise_floor_ignores_slow_errors(differentiated):
    rng = np.random.default_rng(3)
    raw = rng.standard_normal((40000, 1))
    if differentiated:
        raw = np.gradient(raw, axis=0)
    kept = low_pass(raw, 50.0, 4.0)[100:-100:5]
    slow = 30 * np.sin(np.arange(len(kept)) / 200.0)[:, None]
    gain = np.array([difference_gain(50.0, 4.0, 5, differentiated=differentiated)])
    floor = noise_floor(kept + slow, np.zeros(len(kept)), gain)
    assert floor[0] == pytest.approx(kept.std(), rel=0.05)


def make_blocks(rng, rows=600, bound=np.inf):
    design = rng.standard_normal((rows, 2, 3))
    truth = np.array([0.5, -1.0, 2.0])
    residual = design @ truth + 0.1 * rng.standard_normal((rows, 2))
    block = np.repeat(np.arange(12), rows // 12)
    bounds = np.array([bound, np.inf, np.inf])
    return design, residual, block, accumulate(design, residual, block, np.arange(12) % 4, bounds)


def gyro_torques(rng, rows, rate, inertia):
    """(rows, 3) what white noise of three gyro axes makes of torque, and (3,) its rms after the low-pass."""
    torque = np.stack([i * derivative(rng.normal(size=rows), rate) for i in inertia], axis=1)
    return torque, low_pass(torque, rate, 4.0)[60:-60].std(axis=0)  # no rows that the ends reach


def test_axes_of_one_gyro_tell_of_each_others_noise():
    """Held to one level they tell it closer; an axis that shakes five times as much is not held to it."""
    rng, rate, inertia = np.random.default_rng(9), 60.0, np.array([0.3, 0.4, 0.7])

    def floor(torque, alike):
        return spectral_floor(
            [torque], rate, 4.0, lag_s=0.02, raw_rate_hz=rate, differentiated=[True] * 3, alike=alike
        )

    off = {"alone": [], "alike": []}
    for _ in range(12):
        torque, rms = gyro_torques(rng, 1500, rate, inertia)
        off["alone"].append(np.log(floor(torque, None) / rms))
        off["alike"].append(np.log(floor(torque, inertia) / rms))
    alone, alike = (np.sqrt(np.mean(np.square(off[k]))) for k in ("alone", "alike"))
    assert alike < 0.06 and alike < alone
    torque, rms = gyro_torques(rng, 6000, rate, inertia)
    shaken = torque * np.array([5.0, 1.0, 1.0])
    assert floor(shaken, inertia) == pytest.approx(rms * np.array([5.0, 1.0, 1.0]), rel=0.12)


def test_blocks_give_the_least_squares_of_the_rows():
    design, residual, _, blocks = make_blocks(np.random.default_rng(0))
    mine = solve(blocks, np.arange(3), np.ones(12))
    theirs = np.linalg.lstsq(design.reshape(-1, 3), residual.reshape(-1), rcond=None)[0]
    assert mine == pytest.approx(theirs, abs=1e-6)
    assert squares(blocks, mine).sum() == pytest.approx(((residual - design @ theirs) ** 2).sum(), rel=1e-6)


def test_bounds_hold_and_the_rest_adapts():
    design, residual, _, blocks = make_blocks(np.random.default_rng(1), bound=0.1)
    mine = solve(blocks, np.arange(3), np.ones(12))
    assert mine[0] == pytest.approx(0.1)
    rest = residual.reshape(-1) - design.reshape(-1, 3)[:, 0] * 0.1
    theirs = np.linalg.lstsq(design.reshape(-1, 3)[:, 1:], rest, rcond=None)[0]
    assert mine[1:] == pytest.approx(theirs, abs=1e-6)


def test_held_out_errors_are_of_fits_that_did_not_see_the_block():
    design, residual, block, blocks = make_blocks(np.random.default_rng(2))
    errors, fits = held_out(blocks, np.arange(3))
    for b in range(12):
        seen = np.isin(block, [k for k in range(12) if k % 4 != b % 4])
        fit = np.linalg.lstsq(design[seen].reshape(-1, 3), residual[seen].reshape(-1), rcond=None)[0]
        mine = block == b
        want = ((residual[mine] - design[mine] @ fit) ** 2).sum(axis=0)
        assert errors[b] == pytest.approx(want, rel=1e-5)
    assert fits.shape == (4, 3)


def test_blocks_of_any_length_and_order_give_their_rows_sums():
    rng = np.random.default_rng(3)
    block = rng.permutation(np.repeat(np.arange(5), [3, 9000, 1, 40, 700]))
    design, residual = rng.standard_normal((len(block), 2, 3)), rng.standard_normal((len(block), 2))
    design[:, 1, 2] = 0.0
    blocks = accumulate(design, residual, block, np.arange(5), np.full(3, np.inf))
    for b in range(5):
        x, y = design[block == b], residual[block == b]
        assert blocks.rows[b] == len(x)
        for c, use in enumerate(([0, 1, 2], [0, 1])):
            assert blocks.touched[c].tolist() == use
            assert blocks.gram[c][b] == pytest.approx(x[:, c, use].T @ x[:, c, use])
        assert blocks.moment[b] == pytest.approx(np.einsum("rci,rc->ci", x, y))
        assert blocks.power[b] == pytest.approx((y**2).sum(axis=0))
        assert blocks.summed[0][b] == pytest.approx(np.einsum("rci,rcj->ij", x, x))
        few = blocks.only(np.array([2, 0]))
        assert few.summed[0][b] == pytest.approx(blocks.summed[0][b][np.ix_([2, 0], [2, 0])])
        assert few.moment[b] == pytest.approx(blocks.moment[b][:, [2, 0]])


def test_intervals_cover_the_error_they_are_of():
    rng = np.random.default_rng(5)
    hits = 0
    for seed in range(100):
        sums = (rng.standard_normal((30, 50)) ** 2).sum(axis=1)
        low, high = error_interval(sums, np.full(30, 50.0), seed=seed)
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


def test_dependence_is_found_where_it_is_and_nowhere_else():
    rng = np.random.default_rng(7)
    rows = 2000
    variables = {"one": rng.uniform(-1, 1, rows), "two": rng.uniform(-1, 1, rows)}
    residual = 0.1 * rng.standard_normal((rows, 2))
    block = np.arange(rows) // 50
    arguments = (variables, block, block % 5, np.array([5.0, 5.0]), np.array([0.1, 0.1]))
    assert dependences(residual, *arguments) == []
    residual[:, 1] += 0.3 * np.exp(-(((variables["one"] - 0.4) / 0.1) ** 2))
    found = dependences(residual, *arguments)
    assert [(d.channel, d.variable) for d in found] == [(1, "one")]
    assert "near 0." in found[0].where


def test_what_the_rows_do_not_tell_has_the_width_of_its_prior():
    """Two columns that are one: rows say the sum, a prior of 0.02 holds the second."""
    rng = np.random.default_rng(4)
    column = rng.standard_normal((600, 1, 1))
    residual = column[..., 0] + 0.1 * rng.standard_normal((600, 1))
    bounds = np.array([np.inf, -2 * 0.02])
    blocks = accumulate(column.repeat(2, axis=2), residual, np.arange(600) // 50, np.arange(12) % 6, bounds)
    drawn = bootstrap(blocks, np.arange(2), 400)
    assert np.std(drawn[:, 1]) == pytest.approx(0.02, rel=0.15)
    assert np.std(drawn.sum(axis=1)) < 0.01


@pytest.mark.parametrize("limit", [0.4, 2.0])
def test_a_number_at_its_limit_has_an_interval_of_one_side(limit):
    beyond = limit + np.sign(limit - 1.0) * np.abs(np.random.default_rng(1).normal(0.1, 0.02, 200))
    low, high = _against_limit(limit, (0.4, 2.0), beyond)
    assert limit in (low, high) and 0.001 < high - low < 0.04 and 0.4 <= low < high <= 2.0
    assert _against_limit(limit, (0.4, 2.0), limit + 10.0 * (beyond - limit))[0] >= 0.4
