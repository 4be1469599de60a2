"""What the vehicle measures of the truth: noise, bias and quantisation, by seed.

Figures are those of an autopilot's corrected outputs (bias estimated away to a remainder), not of raw parts.
Attitude, position and velocity come out of an estimator, which predicts them with the inertial sensors and
is corrected slowly: their errors wander smoothly, they neither jump nor rattle.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.physics import sensing
from sim.physics.plant import FOOT_Z_M, Plant

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


class SensorReading:
    """One sample of everything, stamped with simulated time; `values` (18 + N) as `sensing` numbers them."""

    def __init__(self, time_s: float, values: NDArray[np.float64], current: float) -> None:
        self.time_s, self.values, self.current = time_s, values, current
        self.accel, self.rates = values[0:3], values[3:6]  # (3,) specific force m/s^2, rad/s; body
        self.quaternion = values[6:10]
        self.position, self.velocity = values[10:13], values[13:16]  # (3,) NED, m and m/s
        self.height, self.voltage = float(values[16]), float(values[17])  # above ground, m; V
        self.speeds = values[18:]  # (N,) normalised


class Sensors:
    """Reads a plant; the same seed reads the same noise."""

    def __init__(self, plant: Plant, seed: int, noise: Noise | None = None, read_s: float = READ_S) -> None:
        self._plant, self.noise, self._read_s = plant, noise or Noise(), read_s
        self._random = np.random.default_rng([seed, 0x5E45])
        n = plant.vehicle.rotors
        s = self.noise
        top = plant.pair.speed_max_rpm
        self.memory = m = np.zeros(sensing.SENSES)
        m[sensing.S_ACCEL_BIAS :][:3] = s.accel_bias_m_s2 * self._random.standard_normal(3)
        m[sensing.S_GYRO_BIAS :][:3] = s.gyro_bias_rad_s * self._random.standard_normal(3)
        sizes = [s.accel_m_s2] * 3 + [s.gyro_rad_s] * 3 + [s.attitude_rad] * 3 + [s.position_m] * 3
        sizes += [s.velocity_m_s] * 3 + [s.range_m, s.voltage_V] + [s.rpm / top] * n
        self._sizes = np.array(sizes)
        keep = np.exp(-read_s / WANDER_S)
        m[sensing.S_KEEP :][:9], m[sensing.S_FRESH :][:9] = keep, np.sqrt(1.0 - keep**2)
        m[sensing.S_PUSH :][:9] = self._sizes[6:15] * self._random.standard_normal(9)
        m[sensing.S_WANDER :][:9] = m[sensing.S_PUSH :][:9]
        self._block = np.empty((0, len(sizes)))
        self._next = 0
        self._past: deque[SensorReading] = deque()
        # (N,) where the rotors' marks stand, rad
        self.turns = 2.0 * np.pi * np.random.default_rng([seed, 0x71B]).random(n)

    def read(self) -> SensorReading:
        """A sample of the present state; called every `read_s`."""
        from sim.physics.kernel import sense  # numba takes its time

        p, r = self._plant, np.empty(sensing.R_SPEEDS + self._plant.vehicle.rotors)
        self.take_shaking()
        top = p.pair.speed_max_rpm * np.pi / 30.0
        sense(p.state, p.out, top, FOOT_Z_M, self.memory, self.rows(1)[0], self.turns, self._read_s, r)
        module = p.sensing.power_module
        amps = p.current if module is None else module.read(p.current, self._read_s)
        now = SensorReading(p.time_s, r, amps)
        return self._late(now) if p.sensing.delay_s > 0.0 else now

    def take_shaking(self) -> None:
        """How strongly rotors shake the accelerometer, as the plant's truth has it now."""
        memory, truth = self.memory, self._plant.sensing
        memory[sensing.S_SHAKE], memory[sensing.S_BLADES] = truth.vibration_m_s2, truth.blades

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

    def _late(self, now: SensorReading) -> SensorReading:
        """The reading of `delay_s` ago, stamped now."""
        self._past.append(now)
        while len(self._past) > 1 and self._past[1].time_s <= now.time_s - self._plant.sensing.delay_s + 1e-9:
            self._past.popleft()
        return SensorReading(now.time_s, self._past[0].values, self._past[0].current)
