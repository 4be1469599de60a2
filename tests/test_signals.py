"""Filters and noise floors, and what a slow quantity is without the noise of its sensor."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.signals import (
    derivative,
    difference_gain,
    lagged,
    low_pass,
    noise_floor,
    spectral_floor,
    without_row_noise,
)


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
