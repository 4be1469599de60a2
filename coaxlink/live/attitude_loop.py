"""The attitude and rate loops run by the companion, for autopilots that send no torque demand.

Setpoint: ATTITUDE_TARGET (83; attitude, body rates, normalised thrust), as the autopilot's own position
control or its pilot makes it. State: ATTITUDE_QUATERNION (31). Each state is answered with one demand.

    rates wanted   w_d = w_ff + k_a 2 sgn(q_e0) q_ev        (Brescianini, Hehn, D'Andrea 2013)
    torque         M = J (k_r (w_d - w) + integral) + w x J w

Gains come from the airframe file, in rad/s, independent of the vehicle's size since the inertia is known:
    [attitude_loop]
    attitude_rad_s = [5.0, 5.0, 2.5]
    rate_rad_s = [12.0, 12.0, 5.0]
    integral_rad_s2 = [8.0, 8.0, 4.0]
    rate_max_rad_s = [3.8, 3.8, 2.5]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError
from firmware_params.keys import unknown_key

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
TARGET_STALE_US = 250_000
INTEGRAL_MAX = 6.0  # rad/s^2
_KEYS = ("attitude_rad_s", "rate_rad_s", "integral_rad_s2", "rate_max_rad_s")


@dataclass(frozen=True)
class LoopGains:
    """Roll, pitch, yaw each; see the module."""

    attitude_rad_s: Three = (5.0, 5.0, 2.5)
    rate_rad_s: Three = (12.0, 12.0, 5.0)
    integral_rad_s2: Three = (8.0, 8.0, 4.0)
    rate_max_rad_s: Three = (3.8, 3.8, 2.5)


def load_gains(path: Path) -> LoopGains:
    """The [attitude_loop] table of an airframe file, or the defaults. Raises InputError naming the key."""
    table = files.read_toml(path).get("attitude_loop", {})
    if not isinstance(table, dict):
        raise InputError(path, "attitude_loop", "a table is expected")
    found: dict[str, Three] = {}
    if odd := unknown_key(table, _KEYS):
        raise InputError(path, f"attitude_loop.{odd[0]}", odd[1])
    for key, value in table.items():
        numbers = value if isinstance(value, list) else []
        if len(numbers) != 3 or not all(
            isinstance(v, (int, float)) and math.isfinite(v) and 0 <= v <= 200 for v in numbers
        ):
            raise InputError(path, f"attitude_loop.{key}", "three numbers from 0 to 200 are expected")
        found[key] = (float(numbers[0]), float(numbers[1]), float(numbers[2]))
    return LoopGains(**found)


@dataclass
class AttitudeLoop:
    """The loops of one vehicle; `aim` for a setpoint, `torque` for a state. Times are the vehicle's, us."""

    inertia_kg_m2: Three
    gains: LoopGains = LoopGains()
    thrust: float = 0.0  # normalised, of the setpoint

    def __post_init__(self) -> None:
        self._attitude: Four | None = None
        self._rates: Three = (0.0, 0.0, 0.0)
        self._aimed_us = -TARGET_STALE_US
        self.reset()

    def reset(self) -> None:
        """Forget the integral, as after a time without flying."""
        self._integral = [0.0, 0.0, 0.0]
        self._last_us: int | None = None

    def aim(self, time_us: int, attitude: Sequence[float], rates: Sequence[float], thrust: float) -> None:
        """A setpoint: attitude (4: w, x, y, z, body to NED), body rates (3: rad/s), thrust 0..1.

        One that is not finite or no rotation is not taken.
        """
        norm = math.sqrt(sum(q * q for q in attitude))
        if not (0.5 < norm < 2.0 and math.isfinite(sum(rates) + thrust)):
            return
        w, x, y, z = (q / norm for q in attitude)
        self._attitude, self._aimed_us = (w, x, y, z), time_us
        self._rates = (rates[0], rates[1], rates[2])
        self.thrust = thrust

    def torque(self, time_us: int, attitude: Sequence[float], rates: Sequence[float]) -> Three | None:
        """Torque (3,) in N m for a state; None without a fresh setpoint or with a state that is none."""
        norm = math.sqrt(sum(q * q for q in attitude))
        known = 0.5 < norm < 2.0 and math.isfinite(sum(rates))
        if self._attitude is None or not known or abs(time_us - self._aimed_us) > TARGET_STALE_US:
            self.reset()
            return None
        last, self._last_us = self._last_us, time_us
        dt = min(max((time_us - last) / 1e6, 0.0), 0.05) if last is not None else 0.0
        error = _error(self._attitude, attitude, norm)
        g, j, w = self.gains, self.inertia_kg_m2, rates
        turning = (
            w[1] * j[2] * w[2] - w[2] * j[1] * w[1],
            w[2] * j[0] * w[0] - w[0] * j[2] * w[2],
            w[0] * j[1] * w[1] - w[1] * j[0] * w[0],
        )
        out = [0.0, 0.0, 0.0]
        for k in range(3):
            most = g.rate_max_rad_s[k]
            wanted = min(max(self._rates[k] + g.attitude_rad_s[k] * error[k], -most), most)
            miss = wanted - w[k]
            total = self._integral[k] + g.integral_rad_s2[k] * miss * dt
            self._integral[k] = min(max(total, -INTEGRAL_MAX), INTEGRAL_MAX)
            out[k] = j[k] * (g.rate_rad_s[k] * miss + self._integral[k]) + turning[k]
        return (out[0], out[1], out[2])


def _error(wanted: Four, attitude: Any, norm: float) -> Three:
    """Rotation vector (small-angle exact) from the attitude to the wanted one, in the body frame."""
    w, x, y, z = (q / norm for q in attitude)
    a, b, c, d = wanted
    # attitude^-1 * wanted
    e0 = w * a + x * b + y * c + z * d
    sign = 2.0 if e0 >= 0 else -2.0
    return (
        sign * (w * b - x * a - y * d + z * c),
        sign * (w * c + x * d - y * a - z * b),
        sign * (w * d - x * c + y * b - z * a),
    )
