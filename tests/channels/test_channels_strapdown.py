"""Attitude, velocity and height that wander, smoothed by gyro and accelerometer: a path made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.channels.strapdown import smoothed_attitude, smoothed_height, smoothed_velocity

RATE = 62.5
G = 9.80665


def path(seconds=60.0):
    """Angles, rates, rotation to the world, velocity, specific force, height of a vehicle that sways."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    roll, pitch, yaw = 0.2 * np.sin(1.9 * t), 0.15 * np.sin(1.3 * t + 1.0), 0.8 * np.sin(0.4 * t)
    dr, dp, dy = 0.38 * np.cos(1.9 * t), 0.195 * np.cos(1.3 * t + 1.0), 0.32 * np.cos(0.4 * t)
    rates = np.stack(
        [
            dr - dy * np.sin(pitch),
            dp * np.cos(roll) + dy * np.sin(roll) * np.cos(pitch),
            dy * np.cos(roll) * np.cos(pitch) - dp * np.sin(roll),
        ],
        axis=1,
    )
    turn = np.empty((len(t), 3, 3))
    for i, (a, b, c) in enumerate(zip(roll, pitch, yaw, strict=True)):
        x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        turn[i] = z @ y @ x
    velocity = np.stack([2.0 * np.sin(1.1 * t), 1.5 * np.cos(0.7 * t), 0.6 * np.sin(0.9 * t)], axis=1)
    pull = np.stack([2.2 * np.cos(1.1 * t), -1.05 * np.sin(0.7 * t), 0.54 * np.cos(0.9 * t)], axis=1)
    force = np.einsum("rwb,rw->rb", turn, pull - np.array([0.0, 0.0, G]))
    height = 3.0 + (0.6 / 0.9) * np.cos(0.9 * t)
    return t, np.stack([roll, pitch, yaw], axis=1), rates, turn, velocity, force, height


def wander(random, rows, size, seconds):
    """(rows, 3) of this rms that hangs together over so many seconds."""
    keep = np.exp(-1.0 / (RATE * seconds))
    out = random.standard_normal((rows, 3))
    for k in range(1, rows):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * out[k]
    return size * out


def rms(values):
    inner = values[round(8 * RATE) : -round(8 * RATE)]
    return float(np.sqrt(np.mean((inner - inner.mean(axis=0)) ** 2)))


def test_an_attitude_that_wanders_follows_the_gyro():
    random = np.random.default_rng(1)
    _, angles, rates, *_ = path()
    determined = angles + wander(random, len(angles), 2e-3, 0.3)
    gyro = rates + 1e-3 * random.standard_normal(rates.shape) + 3e-4
    better = smoothed_attitude(determined, gyro, RATE)
    assert rms(better - angles) < 0.5 * rms(determined - angles)


def test_a_reversed_gyro_smooths_nothing():
    _, angles, rates, *_ = path()
    same = smoothed_attitude(angles, -rates, RATE)
    assert same is angles


@pytest.mark.parametrize("bias", [0.0, 0.08])
def test_a_velocity_follows_the_accelerometer_whatever_its_bias(bias):
    random = np.random.default_rng(2)
    _, _, _, turn, velocity, force, _ = path()
    determined = velocity + wander(random, len(velocity), 0.02, 0.4)
    felt = force + 0.05 * random.standard_normal(force.shape) + np.array([bias, -bias, 0.0])
    better = smoothed_velocity(determined, felt, turn, RATE)
    assert rms(better - velocity) < 0.6 * rms(determined - velocity)


def test_a_stuck_accelerometer_smooths_nothing():
    _, _, _, turn, velocity, force, _ = path()
    stuck = force.copy()
    stuck[1500:1900] = stuck[1500]
    same = smoothed_velocity(velocity, stuck, turn, RATE)
    assert same is velocity


def test_a_height_loses_its_noise_but_not_a_step_of_the_ground():
    random = np.random.default_rng(3)
    t, _, _, _, velocity, _, height = path()
    determined = height + 0.02 * random.standard_normal(len(t))
    better = smoothed_height(determined, velocity[:, 2], RATE)
    assert rms((better - height)[:, None]) < 0.4 * rms((determined - height)[:, None])
    step = determined + 0.6 * (t > 30.0)
    same = smoothed_height(step, velocity[:, 2], RATE)
    assert same is step
