"""Commands that a log rounded: what a mixer never told apart is no evidence on rotors."""

import numpy as np
import pytest

from coaxlink.channels.rounding import before_rounding

STEP = 0.001
MIX = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, -1, -1, 1], [1, 1, -1, -1]] * 2, float)  # equal in a pair
MIX[:, 3] *= np.repeat([1.0, -1.0], 4)  # but for yaw
STEPS = np.full(8, STEP)


def commands(rows: int = 400) -> np.ndarray:
    control = np.random.default_rng(3).normal(size=(rows, 4)) * np.array([0.02, 0.004, 0.004, 0.002])
    return np.asarray(0.58 + control @ MIX.T)


def shares(logged: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Of upper and lower rotors, by least squares of a true moment on what the log says of both.

    A lower rotor sits in the upper one's wake: half of what that one's speed changes is lost to it.
    """
    upper, lower = true[:, :4] * 2.0, true[:, 4:] * 2.0 - true[:, :4]
    moment = (upper + lower) @ MIX[:4, 1]
    seen = np.stack([logged[:, :4] * 2.0, logged[:, 4:] * 2.0 - logged[:, :4]], axis=-1)
    return np.linalg.lstsq(np.einsum("nia,i->na", seen, MIX[:4, 1]), moment, rcond=None)[0]


def test_rounding_no_longer_sets_upper_rotors_against_lower_ones() -> None:
    true = commands()
    rounded = np.round(true / STEP) * STEP
    with_it, without = (shares(c, true) for c in (rounded, before_rounding(rounded, STEPS)))
    assert with_it[0] > 1.05 and with_it[1] < 0.9
    assert without[0] + 0.5 * without[1] == pytest.approx(1.5, abs=0.02)  # nothing tells them apart
    assert np.sqrt(np.mean((before_rounding(rounded, STEPS) - true) ** 2)) < 0.8 * STEP / np.sqrt(12.0)


def test_what_a_log_resolves_stays() -> None:
    true = commands()
    true[200:, 2] -= 0.02  # one rotor for itself
    assert before_rounding(true, np.full(8, 1e-7)) == pytest.approx(true, abs=1e-9)
    kept = before_rounding(np.round(true / STEP) * STEP, STEPS)
    assert np.ptp(kept[:, 2]) > np.ptp(true[:, 2]) - 0.005
    assert np.std(kept[:, 2] - true[:, 2]) < STEP
