"""What the vehicle measures of the truth: noise, bias and quantisation, by seed.

Figures are those of an autopilot's corrected outputs (bias estimated away to a remainder), not of raw parts.
Attitude, position and velocity come out of an estimator, which predicts them with the inertial sensors and
is corrected slowly: their errors wander smoothly, they neither jump nor rattle.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.physics.plant import Plant

BLOCK = 1024
READ_S = 0.004
WANDER_S = np.repeat([0.2, 1.0, 0.5], 3)  # correlation times of attitude, position and velocity errors


@dataclass(frozen=True)
class Noise:
    """Standard deviations; biases are drawn once a flight."""

    accel_m_s2: float = 0.05
    accel_bias_m_s2: float = 0.01
    gyro_rad_s: float = 0.001
    gyro_bias_rad_s: float = 0.0002
    attitude_rad: float = 0.001
    position_m: float = 0.02
    velocity_m_s: float = 0.015
    range_m: float = 0.01
    voltage_V: float = 0.02
    rpm: float = 5.0


@dataclass(frozen=True)
class Reading:
    """One sample of everything, stamped with simulated time."""

    time_s: float
    accel: NDArray[np.float64]  # (3,) specific force, body, m/s^2
    rates: NDArray[np.float64]  # (3,) body, rad/s
    quaternion: NDArray[np.float64]  # (4,)
    position: NDArray[np.float64]  # (3,) NED, m
    velocity: NDArray[np.float64]  # (3,) NED, m/s
    height: float  # above ground, m
    voltage: float
    current: float
    speeds: NDArray[np.float64]  # (N,) normalised


class Sensors:
    """Reads a plant; the same seed reads the same noise."""

    def __init__(self, plant: Plant, seed: int, noise: Noise | None = None, read_s: float = READ_S) -> None:
        self._plant, self.noise, self._read_s = plant, noise or Noise(), read_s
        self._random = np.random.default_rng([seed, 0x5E45])
        n = plant.vehicle.rotors
        s = self.noise
        top = plant.pair.speed_max_rpm
        self._accel_bias = s.accel_bias_m_s2 * self._random.standard_normal(3)
        self._gyro_bias = s.gyro_bias_rad_s * self._random.standard_normal(3)
        sizes = [s.accel_m_s2] * 3 + [s.gyro_rad_s] * 3 + [s.attitude_rad] * 3 + [s.position_m] * 3
        sizes += [s.velocity_m_s] * 3 + [s.range_m, s.voltage_V] + [s.rpm / top] * n
        self._sizes = np.array(sizes)
        self._keep = np.exp(-read_s / WANDER_S)
        self._fresh = np.sqrt(1.0 - self._keep**2)
        self._push = self._sizes[6:15] * self._random.standard_normal(9)
        self._wander = self._push.copy()
        self._block = np.empty((0, len(sizes)))
        self._next = 0
        self._past: deque[Reading] = deque()
        self._turns = 2.0 * np.pi * self._random_phase(seed, n)

    @staticmethod
    def _random_phase(seed: int, n: int) -> NDArray[np.float64]:
        return np.random.default_rng([seed, 0x71B]).random(n)

    def read(self) -> Reading:
        """A sample of the present state; called every `read_s`."""
        noise = self.rows(1)[0]
        self._push = self._keep * self._push + self._fresh * noise[6:15]
        # twice first order; the second halves the variance
        self._wander = self._keep * self._wander + np.sqrt(2.0) * (1.0 - self._keep) * self._push
        p = self._plant
        q, half = p.quaternion, 0.5 * self._wander[0:3]
        # a small rotation about the body axes: q * (1, e / 2)
        turned = np.array(
            [
                q[0] - q[1] * half[0] - q[2] * half[1] - q[3] * half[2],
                q[1] + q[0] * half[0] + q[2] * half[2] - q[3] * half[1],
                q[2] + q[0] * half[1] + q[3] * half[0] - q[1] * half[2],
                q[3] + q[0] * half[2] + q[1] * half[1] - q[2] * half[0],
            ]
        )
        now = Reading(
            p.time_s,
            p.specific_force + self._accel_bias + noise[0:3] + self._shaken(),
            p.rates + self._gyro_bias + noise[3:6],
            turned,
            p.position + self._wander[3:6],
            p.velocity + self._wander[6:9],
            max(p.height + noise[15], 0.0),
            p.voltage + noise[16],
            p.current,
            np.maximum(p.speeds + noise[17:], 0.0),
        )
        return self._late(now) if p.sensing.delay_s > 0.0 else now

    def rows(self, count: int) -> NDArray[np.float64]:
        """(count, 17 + N) the next noise, as `read` would draw it."""
        parts = []
        while count > 0:
            if self._next >= len(self._block):
                self._block = self._sizes * self._random.standard_normal((BLOCK, len(self._sizes)))
                self._next = 0
            part = self._block[self._next : self._next + count]
            self._next += len(part)
            count -= len(part)
            parts.append(part)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def memory(self) -> NDArray[np.float64]:
        """(42,) biases of accelerometer and gyro, what of the wandering is kept and fresh, its two stages."""
        states = (self._keep, self._fresh, self._push, self._wander)
        return np.concatenate([self._accel_bias, self._gyro_bias, *states])

    @property
    def turns(self) -> NDArray[np.float64]:
        """(N,) where the rotors' marks stand, rad."""
        return self._turns

    def _shaken(self) -> NDArray[np.float64] | float:
        """(3,) what unbalanced rotors, or passing blades, shake the accelerometer with."""
        p = self._plant
        size = p.sensing.vibration_m_s2
        if size == 0.0:
            return 0.0
        u = p.speeds
        self._turns = self._turns + self._read_s * p.pair.speed_max_rpm * np.pi / 30.0 * u * p.sensing.blades
        strength = size * u * u
        round_ = np.array([np.cos(self._turns), np.sin(self._turns), 0.3 * np.cos(self._turns)])
        return np.asarray(round_ @ strength)

    def _late(self, now: Reading) -> Reading:
        """The reading of `delay_s` ago, stamped now."""
        self._past.append(now)
        while len(self._past) > 1 and self._past[1].time_s <= now.time_s - self._plant.sensing.delay_s + 1e-9:
            self._past.popleft()
        return replace(self._past[0], time_s=now.time_s)
