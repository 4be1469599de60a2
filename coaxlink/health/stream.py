"""Telemetry as blocks of a tenth of a second: what the vehicle did, and what its rotors should have done.

Commands and inertial readings come one by one, each with the vehicle's own stamp; speeds follow commands by
the airframe's lag. A block's angular acceleration is the difference of two readings of the gyro, its
predicted wrench the model's at the mean speeds between them (Euler's and Newton's equations in the body
frame, FRD, thrust up). Commands run straight from one to the next: telemetry tells a few of the many that the
motors get, and held they would be late by half a period. Where either side is silent for STALE_S the block is
lost, and whoever reads the blocks is told of the gap.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle

BLOCK_S = 0.1
STALE_S = 0.15  # silence of gyro or commands that ends a block: three periods of a 20 Hz stream
WAITING = 64  # commands and readings that may wait for each other
NONE = -1.0


@dataclass(frozen=True)
class HealthInterval:
    """One tenth of a second. Channels: thrust up (N), roll, pitch, yaw (N m)."""

    time_s: float  # its end, the vehicle's clock
    seconds: float
    measured: Array  # (4,) of the mass and the inertia; thrust is NaN where no accelerometer is reported
    predicted: Array  # (4,) of the rotors
    slope: Array  # (4,) of `predicted` since the block before, per s
    travel: Array  # (4,) how far `predicted` went up and down within it
    speeds: Array  # (N,) normalised, mean
    after_gap: bool  # the block before this one is not the one that ended at its start


class Stream:
    """`command` and `reading` as they come; `reading` returns the blocks that are complete.

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> stream = Stream(load_vehicle(example("x8_demo.toml")))
    >>> for k in range(12):
    ...     stream.command(0.02 * k, [0.55] * 8)
    ...     done = stream.reading(0.02 * k, (0.0, 0.0, 0.0), -9.8)
    ...     if done:
    ...         print(len(done), done[0].after_gap)
    1 True
    1 False
    """

    def __init__(self, vehicle: Vehicle) -> None:
        frame = vehicle.airframe
        self.vehicle, self.count = vehicle, len(frame.rotors)
        self._rotors = PlainRotors.of(vehicle)
        self._inertia = np.array(frame.inertia_kg_m2)
        self._lag = frame.motor_lag_s
        self._commands: deque[tuple[float, Array]] = deque(maxlen=WAITING)
        self._readings: deque[tuple[float, Array, float]] = deque(maxlen=WAITING)
        self.restart()

    def restart(self) -> None:
        """Forget everything: another flight, another clock."""
        self._commands.clear()
        self._readings.clear()
        self._commanded: Array | None = None
        self._commanded_s = self._now_s = self._start_s = self._read_s = NONE
        self._newest_s = NONE
        self._speeds = self._sum = self._total = np.zeros(self.count)
        self._wrench = self._travel = self._last = np.zeros(4)
        self._begin = self._turned = np.zeros(3)
        self._felt, self._heard = 0.0, 0
        self._before: tuple[float, Array] | None = None

    def command(self, time_s: float, commands: Sequence[float]) -> None:
        """Normalised commands (N,) in 0..1 at that time. What is not finite is passed over."""
        values = np.asarray(commands, float)[: self.count]
        if len(values) < self.count or not (math.isfinite(time_s) and np.isfinite(values).all()):
            return
        if time_s <= self._newest_s:
            if time_s < self._newest_s - 1.0:  # the vehicle has started again
                self.restart()
            else:
                return
        self._newest_s = time_s
        self._commands.append((time_s, np.clip(values, 0.0, 1.0)))

    def reading(
        self, time_s: float, rates: Sequence[float], accel_z: float = math.nan
    ) -> list[HealthInterval]:
        """Body rates (3,) rad/s and the specific force along z (m/s^2, FRD; NaN for unknown)."""
        turned = np.asarray(rates, float)
        if math.isfinite(time_s) and turned.shape == (3,) and np.isfinite(turned).all():
            self._readings.append((time_s, turned, accel_z))
        done = []
        # a reading waits for the command after it: messages of one moment come in any order
        while self._readings and self._commands and self._newest_s >= self._readings[0][0]:
            block = self._take(*self._readings.popleft())
            if block is not None:
                done.append(block)
        return done

    def _take(self, time_s: float, rates: Array, accel_z: float) -> HealthInterval | None:
        if time_s <= self._read_s:
            return None
        quiet, since = time_s - self._read_s > STALE_S, time_s - self._read_s
        self._follow(time_s)
        self._read_s = time_s
        if self._commanded is None:
            return None
        if self._start_s == NONE or quiet or time_s - self._commanded_s > STALE_S:
            self._begin_at(time_s, rates)
            self._last, self._before = self._rotors.wrench(self._speeds), None
            return None
        # reading by reading: loads go with the square of a speed, which a mean over a whole block would miss
        now = self._rotors.wrench(self._sum / since)
        self._wrench, self._travel = self._wrench + since * now, self._travel + np.abs(now - self._last)
        self._last = now
        self._total, self._sum = self._total + self._sum, np.zeros(self.count)
        self._felt, self._heard = self._felt + accel_z, self._heard + 1
        self._turned = self._turned + rates
        if time_s - self._start_s < BLOCK_S - 1e-3:
            return None
        block = self._block(time_s, time_s - self._start_s, rates)
        self._begin_at(time_s, rates)
        self._before = time_s, block.predicted
        return block

    def _begin_at(self, time_s: float, rates: Array) -> None:
        self._start_s, self._begin = time_s, rates
        self._sum = self._total = np.zeros(self.count)
        self._wrench, self._travel = np.zeros(4), np.zeros(4)
        self._turned, self._felt, self._heard = np.zeros(3), 0.0, 0

    def _follow(self, time_s: float) -> None:
        """Speeds and their sum over time, up to then."""
        while self._commands and self._commands[0][0] <= time_s:
            at, values = self._commands.popleft()
            if self._commanded is None or at - self._commanded_s > STALE_S:
                self._speeds, self._now_s = values, at
            else:
                self._move(at, values, at)
            self._commanded, self._commanded_s = values, at
        if self._commands and self._commanded is not None:
            self._move(time_s, self._commands[0][1], self._commands[0][0])

    def _move(self, time_s: float, towards: Array, at: float) -> None:
        """On to `time_s` with a command that runs straight from the last one to `towards` at `at`."""
        dt, commanded = time_s - self._now_s, self._commanded
        if dt <= 0 or commanded is None:
            return
        ramp = (towards - commanded) / (at - self._commanded_s)
        now = (
            commanded + ramp * (self._now_s - self._commanded_s) - ramp * self._lag
        )  # where the speeds are when settled
        behind = self._speeds - now
        keep = math.exp(-dt / self._lag) if self._lag > 0 else 0.0
        self._sum = self._sum + now * dt + 0.5 * ramp * dt * dt + behind * (1.0 - keep) * self._lag
        self._speeds, self._now_s = now + ramp * dt + behind * keep, time_s

    def _block(self, time_s: float, seconds: float, rates: Array) -> HealthInterval:
        frame, predicted = self.vehicle.airframe, self._wrench / seconds
        turning = self._turned / self._heard
        moment = self._inertia * (rates - self._begin) / seconds
        (p, q, r), (ix, iy, iz) = turning, self._inertia
        moment += np.array([(iz - iy) * q * r, (ix - iz) * r * p, (iy - ix) * p * q])  # Euler's equations
        measured = np.array([-frame.mass_kg * self._felt / self._heard, *moment])
        linked = self._before is not None
        then, before = self._before or (time_s, predicted)
        slope = (predicted - before) / (time_s - then) if linked else np.zeros(4)
        return HealthInterval(
            time_s, seconds, measured, predicted, slope, self._travel, self._total / seconds, not linked
        )
