"""The mix that ArduCopter will make of a table: used factors, saturation, thrust curve, PWM.

Follows ArduPilot's AP_MotorsMatrix and AP_Motors_Thrust_Linearization step by step (master of 2026-03) and is
held to outputs of that code. Roll, pitch and yaw demands are -1..1, throttle 0..1; a motor's roll factor is
positive on the left, its pitch factor in front, its yaw factor where the propeller turns counter-clockwise.

The throttle factor of a motor acts only after everything was fitted into 0..1, so with factors below 1 a
motor can leave that range and be clipped without a limit flag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_params.ardupilot.table import SCRIPTING_MATRIX, ApTable, expo_for, used_factors
from firmware_params.errors import Finding

_TINY = 1.19e-7  # FLT_EPSILON, as ArduPilot's is_zero and is_positive have it
_BALANCE = 1.0 / 3.0  # the thrust-balance check trips in hover where a motor has a third of another's thrust
FLAGS = ("roll", "pitch", "yaw", "throttle_lower", "throttle_upper")


@dataclass(frozen=True)
class Demand:
    """What the attitude controller demands of the mixer, and the state the motors are in."""

    roll: float
    pitch: float
    yaw: float
    throttle: float
    throttle_avg_max: float | None = None  # None: the throttle itself
    throttle_thrust_max: float = 1.0
    spool: str = "THROTTLE_UNLIMITED"  # or GROUND_IDLE, SHUT_DOWN
    battery_ratio: float = 1.0  # filtered voltage / MOT_BAT_VOLT_MAX
    lift_max: float = 1.0
    air_density_ratio: float = 1.0
    boost: bool = False  # thrust boost after a motor was lost
    boost_ratio: float = 0.0
    motor_lost: int = 0  # index


@dataclass(frozen=True)
class Output:
    """What ArduPilot's motors do with a demand."""

    thrust: NDArray[np.float64]  # (N,) before the curve; may leave 0..1
    actuator: NDArray[np.float64]  # (N,) after curve and spin range, 0..1
    pwm: NDArray[np.int64]  # (N,) us
    limits: frozenset[str]  # of FLAGS
    throttle_out: float


@dataclass(frozen=True)
class ApMix:
    """What ArduPilot makes of a table. All methods are pure."""

    factors: NDArray[np.float64]  # (N, 4) roll, pitch, yaw, throttle, as used
    table: ApTable
    warnings: tuple[Finding, ...]
    _rows: tuple[tuple[float, ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_rows", tuple(map(tuple, self.factors.tolist())))

    def output(self, demand: Demand) -> Output:
        """Motors for a demand."""
        d = demand
        if d.spool != "THROTTLE_UNLIMITED":
            return self._idle(d.spool)
        gain = compensation_gain(d.lift_max, d.air_density_ratio)
        thrust, limits, throttle_out = self._mixed(d, gain)
        actuator = self.actuator(thrust, battery_ratio=d.battery_ratio, lift_max=d.lift_max)
        return Output(thrust, actuator, self.pwm(actuator), limits, throttle_out)

    def throttle(self, thrust: ArrayLike) -> NDArray[np.float64]:
        """Actuator outputs (..., N) of thrust commands, full battery at sea level."""
        return self.actuator(np.asarray(thrust, float))

    def actuator(
        self, thrust: NDArray[np.float64], *, battery_ratio: float = 1.0, lift_max: float = 1.0
    ) -> NDArray[np.float64]:
        """0..1 after the thrust curve and the spin range."""
        p = self.table.parameters
        x = np.clip(thrust, 0.0, 1.0)
        e = min(max(p.thst_expo, -1.0), 1.0)
        if abs(e) < _TINY:
            curve = lift_max * x / battery_ratio
        else:
            root = np.sqrt((1.0 - e) ** 2 + 4.0 * e * lift_max * x)
            curve = np.clip(((e - 1.0) + root) / (2.0 * e) / battery_ratio, 0.0, 1.0)
        return np.clip(p.spin_min + (p.spin_max - p.spin_min) * curve, 0.0, 1.0)

    def thrust_of(self, actuator: ArrayLike) -> NDArray[np.float64]:
        """The thrust command whose actuator output this is (the curve's inverse, clipped to 0..1)."""
        p = self.table.parameters
        a = (np.asarray(actuator, float) - p.spin_min) / (p.spin_max - p.spin_min)
        e = min(max(p.thst_expo, -1.0), 1.0)
        return np.clip((1.0 - e) * a + e * a * a, 0.0, 1.0)

    def pwm(self, actuator: NDArray[np.float64]) -> NDArray[np.int64]:
        """Microseconds, truncated as ArduPilot does."""
        p = self.table.parameters
        return np.trunc(p.pwm_min + (p.pwm_max - p.pwm_min) * actuator + 1e-9).astype(np.int64)

    def _idle(self, spool: str) -> Output:
        p = self.table.parameters
        level = min(p.spin_arm, p.spin_min) if spool == "GROUND_IDLE" else 0.0
        count = len(self._rows)
        actuator = np.full(count, level)
        pwm = self.pwm(actuator) if spool == "GROUND_IDLE" else np.full(count, int(p.pwm_min))
        return Output(np.zeros(count), actuator, pwm, frozenset(FLAGS), 0.0)

    def _mixed(self, d: Demand, gain: float) -> tuple[NDArray[np.float64], frozenset[str], float]:
        limits: set[str] = set()
        roll, pitch, yaw = d.roll * gain, d.pitch * gain, d.yaw * gain
        throttle = min(max(d.throttle, 0.0), 1.0) * gain
        average = (throttle / gain if d.throttle_avg_max is None else d.throttle_avg_max) * gain
        ceiling = d.boost_ratio + (1.0 - d.boost_ratio) * d.throttle_thrust_max * gain
        if throttle <= 0.0:
            throttle = 0.0
            limits.add("throttle_lower")
        if throttle >= ceiling:
            throttle = ceiling
            limits.add("throttle_upper")
        average = min(max(average, throttle), ceiling)
        best = min(0.5, average)
        part = [roll * f[0] + pitch * f[1] for f in self._rows]
        allowed = self._yaw_allowed(d, part, best, yaw)
        if abs(yaw) > allowed:
            yaw = math.copysign(allowed, yaw)
            limits.add("yaw")
        part = [t + yaw * f[2] for t, f in zip(part, self._rows, strict=True)]
        low, high = self._range(d, part)
        scale = 1.0
        if high - low > 1.0:
            scale = 1.0 / (high - low)
        if average + low < 0.0:
            scale = min(scale, -average / low)
        low, high = low * scale, high * scale
        best = -low
        adjust = throttle - best
        if scale < 1.0:
            limits |= {"roll", "pitch", "yaw"}
            if adjust > 0.0:
                limits.add("throttle_upper")
            adjust = 0.0
        elif adjust < 0.0:
            adjust = 0.0
        elif adjust > 1.0 - (best + high):
            adjust = 1.0 - (best + high)
            limits.add("throttle_upper")
        thrust = [(best + adjust) * f[3] + scale * t for t, f in zip(part, self._rows, strict=True)]
        return np.array(thrust), frozenset(limits), (best + adjust) / gain

    def _yaw_allowed(self, d: Demand, part: Sequence[float], best: float, yaw: float) -> float:
        def room(i: int) -> float:
            factor = self._rows[i][2]
            if abs(factor) < _TINY:
                return math.inf
            free = 1.0 - (best + part[i]) if yaw * factor >= _TINY else best + part[i]
            return max(free, 0.0) / abs(factor)

        allowed = 1.0
        for i in range(len(part)):
            if not (d.boost and i == d.motor_lost):
                allowed = min(allowed, room(i))
        least = self.table.parameters.yaw_headroom / 1000.0
        allowed = max(allowed, d.boost_ratio * 0.5 + (1.0 - d.boost_ratio) * least)
        if d.boost:
            allowed = d.boost_ratio * allowed + (1.0 - d.boost_ratio) * min(allowed, room(d.motor_lost))
        return allowed

    def _range(self, d: Demand, part: Sequence[float]) -> tuple[float, float]:
        low = min(1.0, *part)
        remaining = [t for i, t in enumerate(part) if not (d.boost and i == d.motor_lost)]
        high = max(-1.0, *remaining)
        if d.boost and part[d.motor_lost] > high:
            high = d.boost_ratio * high + (1.0 - d.boost_ratio) * part[d.motor_lost]
        return low, high


def compensation_gain(lift_max: float, air_density_ratio: float) -> float:
    """1 / lift_max, divided by the density ratio where that is believable."""
    gain = 1.0 / lift_max if lift_max > 0.0 else 1.0
    if 0.3 < air_density_ratio < 1.5:
        gain /= min(max(air_density_ratio, 0.5), 1.25)
    return gain


def realise(table: ApTable) -> ApMix:
    """The mix of a table. Raises TableError when ArduPilot would not take it."""
    factors = used_factors(table)
    return ApMix(factors, table, _findings(table, factors))


def _findings(table: ApTable, factors: NDArray[np.float64]) -> tuple[Finding, ...]:
    """What ArduPilot will do with a table of these used factors (N, 4) that its author may not expect."""
    found = []
    for axis, name in enumerate(("roll", "pitch", "yaw", "throttle")):
        if not np.abs(factors[:, axis]).any():
            found.append(Finding("ap.no-authority", "error", f"no rotor acts on {name}"))
    throttle = factors[:, 3]
    if throttle.max() > 0 and throttle.min() <= _BALANCE * throttle.max():
        text = "the thrust-balance check trips in hover: a throttle factor is a third of the largest or less"
        found.append(Finding("ap.thrust-balance", "warning", text, f"{throttle.min() / throttle.max():.3f}"))
    p = table.parameters
    fair = expo_for(1.0, p.spin_min, p.spin_max)
    if np.ptp(throttle) > 1e-6 and p.thst_expo > fair + 1e-3:
        text = (
            f"MOT_SPIN_MIN bends the ratio between rotors: MOT_THST_EXPO {fair:.3f} keeps it for u^2 rotors"
        )
        evidence = f"MOT_SPIN_MIN = {p.spin_min:g}, MOT_THST_EXPO = {p.thst_expo:g}"
        found.append(Finding("ap.spin-min", "warning", text, evidence))
    if np.ptp(throttle) > 1e-6:
        text = "saturation ignores throttle factors: rotors below 1 can clip on yaw without a limit flag"
        found.append(Finding("ap.silent-clip", "warning", text, f"smallest factor {throttle.min():.3f}"))
    for name, value, low, high in (
        ("MOT_THST_EXPO", p.thst_expo, -1.0, 1.0),
        ("MOT_SPIN_MIN", p.spin_min, 0.0, 0.3),
        ("MOT_SPIN_MAX", p.spin_max, 0.9, 1.0),
        ("MOT_SPIN_ARM", p.spin_arm, 0.0, 1.0),
    ):
        if not low <= value <= high:
            text = f"{name} = {value:g} is outside {low:g}..{high:g}"
            found.append(Finding("ap.out-of-range", "error", text, "ArduPilot stores it unchecked"))
    if table.frame_class == SCRIPTING_MATRIX and np.abs(np.array(table.factors)[:, 3]).max() == 0.0:
        found.append(Finding("ap.no-throttle", "error", "every throttle factor is 0"))
    return tuple(found)
