"""The control cascade of a PX4 multirotor, at one rate: position, velocity, attitude, rates.

Position P and velocity PID make an acceleration; with the hover thrust it becomes a thrust vector and an
attitude; quaternion P makes body rates; rate PID makes a normalised torque. NED, FRD, SI; plain floats, for
eight numpy calls on three numbers cost more than the whole loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

G = 9.80665
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Goal:
    """What the vehicle is to follow; NaN in position or velocity leaves that axis to the other."""

    position: Three = NAN3
    velocity: Three = NAN3
    acceleration: Three = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0


class Demand(NamedTuple):
    """Normalised torque and thrust (up, 0..1), and what led to it."""

    roll: float
    pitch: float
    yaw: float
    thrust: float
    attitude: Four
    rates: Three


IDLE = Demand(0.0, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Settings(Protocol):
    """Parameters by PX4's names, wherever they come from."""

    def __getitem__(self, name: str) -> float: ...
    def listen(self, callback: Callable[[str], None]) -> None:
        """Call `callback(name)` after every change."""
        ...


class Gains:
    """The parameters the cascade reads, as plain numbers."""

    def __init__(self, store: Settings) -> None:
        def get(name: str) -> float:
            return float(store[name])

        self.position: Three = (get("MPC_XY_P"), get("MPC_XY_P"), get("MPC_Z_P"))
        self.velocity_p: Three = (get("MPC_XY_VEL_P_ACC"), get("MPC_XY_VEL_P_ACC"), get("MPC_Z_VEL_P_ACC"))
        self.velocity_i: Three = (get("MPC_XY_VEL_I_ACC"), get("MPC_XY_VEL_I_ACC"), get("MPC_Z_VEL_I_ACC"))
        self.velocity_d: Three = (get("MPC_XY_VEL_D_ACC"), get("MPC_XY_VEL_D_ACC"), get("MPC_Z_VEL_D_ACC"))
        self.fastest = get("MPC_XY_VEL_MAX")
        self.climb, self.sink = get("MPC_Z_VEL_MAX_UP"), get("MPC_Z_VEL_MAX_DN")
        self.tilt = math.radians(get("MPC_TILTMAX_AIR"))
        self.thrust_min, self.thrust_max = get("MPC_THR_MIN"), get("MPC_THR_MAX")
        self.hover, self.estimate = get("MPC_THR_HOVER"), get("MPC_USE_HTE") == 1
        self.hover_range = get("HTE_THR_RANGE")
        self.attitude: Three = (get("MC_ROLL_P"), get("MC_PITCH_P"), get("MC_YAW_P"))
        self.yaw_weight = get("MC_YAW_WEIGHT")
        axes = (("ROLLRATE", "RR"), ("PITCHRATE", "PR"), ("YAWRATE", "YR"))
        self.rate_max = [math.radians(get(f"MC_{a}_MAX")) for a, _ in axes]
        self.rate_p = [get(f"MC_{a}_P") * get(f"MC_{a}_K") for a, _ in axes]
        self.rate_i = [get(f"MC_{a}_I") * get(f"MC_{a}_K") for a, _ in axes]
        self.rate_d = [get(f"MC_{a}_D") * get(f"MC_{a}_K") for a, _ in axes]
        self.rate_ff = [get(f"MC_{a}_FF") for a, _ in axes]
        self.rate_limit = [get(f"MC_{short}_INT_LIM") for _, short in axes]
        self.gyro_cutoff, self.rate_cutoff = get("IMU_GYRO_CUTOFF"), get("IMU_DGYRO_CUTOFF")
        self.accel_cutoff = get("MPC_VELD_LP")


class Cascade:
    """The loops' memory: integrals, filters, the hover thrust learnt."""

    def __init__(self, store: Settings, dt: float) -> None:
        self._store, self.dt = store, dt
        self.gains = Gains(store)
        self.hover = self.gains.hover
        self._stale = False
        store.listen(self._heard)
        self.reset()

    def _heard(self, name: str) -> None:
        self._stale = self._stale or name.startswith(("MPC_", "MC_", "HTE_", "IMU_"))

    def _refresh(self) -> None:
        if self._stale:
            before = self.gains.hover
            self.gains = Gains(self._store)
            if self.gains.hover != before:
                self.hover = self.gains.hover
            self._stale = False

    def reset(self) -> None:
        """Forget integrals and filters, as on the ground."""
        self._velocity_i = [0.0, 0.0, 0.0]
        self._rate_i = [0.0, 0.0, 0.0]
        self._accel = [0.0, 0.0, 0.0]
        self._alpha = [0.0, 0.0, 0.0]
        self._last_rates: Three | None = None
        self._gyro = [0.0] * 12  # by axis: two readings and two filtered rates of before
        self._last_velocity: Three | None = None
        self._thrust = 0.0

    def track(self, goal: Goal, position: Three, velocity: Three, attitude: Four, rates: Three) -> Demand:
        """All loops, from a goal in space."""
        self._refresh()
        acceleration = self._acceleration(goal, position, velocity)
        thrust, wanted = self._thrust_vector(acceleration, goal.yaw, attitude)
        return self.hold_attitude(wanted, thrust, attitude, rates, goal.yaw_rate)

    def _acceleration(self, goal: Goal, position: Three, velocity: Three) -> list[float]:
        g, dt = self.gains, self.dt
        wanted = [0.0, 0.0, 0.0]
        for k in range(3):
            p, v = goal.position[k], goal.velocity[k]
            if not math.isnan(p):
                wanted[k] += g.position[k] * (p - position[k])
            if not math.isnan(v):
                wanted[k] += v
        level = math.hypot(wanted[0], wanted[1])
        if level > g.fastest:
            wanted[0], wanted[1] = wanted[0] * g.fastest / level, wanted[1] * g.fastest / level
        wanted[2] = min(max(wanted[2], -g.climb), g.sink)
        share = 1.0 - math.exp(-2 * math.pi * g.accel_cutoff * dt)
        out = [0.0, 0.0, 0.0]
        for k in range(3):
            if self._last_velocity is not None:
                self._accel[k] += share * ((velocity[k] - self._last_velocity[k]) / dt - self._accel[k])
            error = wanted[k] - velocity[k]
            out[k] = g.velocity_p[k] * error + self._velocity_i[k] - g.velocity_d[k] * self._accel[k]
            feed = goal.acceleration[k]
            out[k] += 0.0 if math.isnan(feed) else feed
            full = self._thrust >= g.thrust_max - 1e-6 or self._thrust <= g.thrust_min + 1e-6
            if not (k == 2 and full):
                step = g.velocity_i[k] * error * dt
                self._velocity_i[k] = min(max(self._velocity_i[k] + step, -0.5 * G), 0.5 * G)
        self._last_velocity = velocity
        return out

    def _thrust_vector(self, acceleration: list[float], yaw: float, attitude: Four) -> tuple[float, Four]:
        """Collective thrust 0..1 and the attitude that points it."""
        g = self.gains
        ax, ay, az = acceleration
        x, y, z = -ax, -ay, G  # PX4 tilts for level acceleration against plain gravity
        limit = z * math.tan(g.tilt)
        level = math.hypot(x, y)
        if level > limit:
            x, y = x * limit / level, y * limit / level
        size = math.sqrt(x * x + y * y + z * z)
        bx, by, bz = x / size, y / size, z / size  # body z, pointing down
        up = (self.hover - az * self.hover / G) / bz
        thrust = min(max(up, g.thrust_min), g.thrust_max)
        if self.gains.estimate:
            self._learn_hover(attitude)
        self._thrust = thrust
        # body y as level as the wanted heading allows
        cx, cy = -math.sin(yaw), math.cos(yaw)
        xx, xy, xz = cy * bz, -cx * bz, cx * by - cy * bx
        size = math.sqrt(xx * xx + xy * xy + xz * xz) or 1.0
        xx, xy, xz = xx / size, xy / size, xz / size
        yx, yy, yz = by * xz - bz * xy, bz * xx - bx * xz, bx * xy - by * xx
        return thrust, matrix_to_quaternion(((xx, yx, bx), (xy, yy, by), (xz, yz, bz)))

    def _learn_hover(self, attitude: Four) -> None:
        """Follow the thrust that would hover, slowly, and not far from where it was set."""
        _, x, y, _ = attitude
        upright = 1.0 - 2.0 * (x * x + y * y)
        lift = G - self._accel[2]
        if upright < 0.9 or lift < 5.0 or self._thrust < 0.1:
            return
        g = self.gains
        seen = self._thrust * upright * G / lift
        self.hover += (seen - self.hover) * self.dt / 2.0
        self.hover = min(
            max(self.hover, max(g.hover - g.hover_range, 0.1)), min(g.hover + g.hover_range, 0.9)
        )

    def hold_attitude(
        self, wanted: Four, thrust: float, attitude: Four, rates: Three, yaw_rate: float = 0.0
    ) -> Demand:
        """Attitude and rate loops. The tilt is turned directly; the heading error counts less."""
        g = self.gains
        error = multiply(conjugate(attitude), wanted)
        tilt = reduced_tilt(error)
        # what remains after the tilt is about body z
        twist = multiply(conjugate(tilt), error)
        half = math.asin(min(max(twist[3] if twist[0] >= 0 else -twist[3], -1.0), 1.0)) * g.yaw_weight
        error = multiply(tilt, (math.cos(half), 0.0, 0.0, math.sin(half)))
        sign = 2.0 if error[0] >= 0 else -2.0
        scale = (1.0, 1.0, 1.0 / max(g.yaw_weight, 0.1))
        turn = [sign * error[k + 1] * g.attitude[k] * scale[k] for k in range(3)]
        turn[2] += 0.0 if math.isnan(yaw_rate) else yaw_rate
        wanted_rates = tuple(min(max(turn[k], -g.rate_max[k]), g.rate_max[k]) for k in range(3))
        return self.hold_rates((wanted_rates[0], wanted_rates[1], wanted_rates[2]), thrust, rates, wanted)

    def hold_rates(self, wanted: Three, thrust: float, rates: Three, attitude: Four) -> Demand:
        """The rate loop on the low-passed gyro: P, I with a limit, D on the filtered angular acceleration."""
        self._refresh()
        g, dt = self.gains, self.dt
        rates = self._low_passed(rates)
        share = 1.0 - math.exp(-2 * math.pi * g.rate_cutoff * dt)
        torque = [0.0, 0.0, 0.0]
        for k in range(3):
            if self._last_rates is not None:
                self._alpha[k] += share * ((rates[k] - self._last_rates[k]) / dt - self._alpha[k])
            error = wanted[k] - rates[k]
            torque[k] = g.rate_p[k] * error + self._rate_i[k] - g.rate_d[k] * self._alpha[k]
            torque[k] = min(max(torque[k] + g.rate_ff[k] * wanted[k], -1.0), 1.0)
            if thrust > 0.05:
                limit = g.rate_limit[k]
                step = g.rate_i[k] * error * dt
                self._rate_i[k] = min(max(self._rate_i[k] + step, -limit), limit)
        self._last_rates = rates
        return Demand(torque[0], torque[1], torque[2], thrust, attitude, wanted)

    def _low_passed(self, rates: Three) -> Three:
        """What the loops see of the gyro: a second-order Butterworth at IMU_GYRO_CUTOFF (0: as it is)."""
        cutoff, past = self.gains.gyro_cutoff, self._gyro
        if not 0.0 < cutoff < 0.45 / self.dt:
            return rates
        if self._last_rates is None:
            self._gyro = [x for r in rates for x in (r, r, r, r)]
            return rates
        w = math.tan(math.pi * cutoff * self.dt)
        whole = 1.0 + math.sqrt(2.0) * w + w * w
        gain, first = w * w / whole, 2.0 * (w * w - 1.0) / whole
        second = (1.0 - math.sqrt(2.0) * w + w * w) / whole
        out = [0.0, 0.0, 0.0]
        for k, r in enumerate(rates):
            x1, x2, y1, y2 = past[4 * k : 4 * k + 4]
            y = gain * (r + 2.0 * x1 + x2) - first * y1 - second * y2
            past[4 * k : 4 * k + 4] = r, x1, y, y1
            out[k] = y
        return (out[0], out[1], out[2])


def multiply(a: Four, b: Four) -> Four:
    """Quaternion product."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def conjugate(q: Four) -> Four:
    """The inverse rotation."""
    return (q[0], -q[1], -q[2], -q[3])


def reduced_tilt(error: Four) -> Four:
    """The shortest turn that brings body z where `error` would bring it."""
    w, x, y, z = error
    zx, zy, zz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    if zz < -0.9999:
        return (0.0, 1.0, 0.0, 0.0)
    # between (0, 0, 1) and (zx, zy, zz): axis (-zy, zx, 0)
    size = math.sqrt((1 + zz) ** 2 + zx * zx + zy * zy)
    return ((1 + zz) / size, -zy / size, zx / size, 0.0)


def matrix_to_quaternion(r: tuple[Three, Three, Three]) -> Four:
    """Quaternion of a rotation matrix, w >= 0 (Shepperd)."""
    trace = r[0][0] + r[1][1] + r[2][2]
    if trace > 0:
        s = 2.0 * math.sqrt(trace + 1.0)
        return (s / 4, (r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s)
    k = max(range(3), key=lambda i: r[i][i])
    i, j = (k + 1) % 3, (k + 2) % 3
    s = 2.0 * math.sqrt(max(1.0 + r[k][k] - r[i][i] - r[j][j], 1e-12))
    out = [0.0, 0.0, 0.0]
    out[k], out[i], out[j] = s / 4, (r[i][k] + r[k][i]) / s, (r[j][k] + r[k][j]) / s
    w = (r[j][i] - r[i][j]) / s
    sign = 1.0 if w >= 0 else -1.0
    return (sign * w, sign * out[0], sign * out[1], sign * out[2])


def euler(q: Four) -> Three:
    """Roll, pitch, yaw."""
    w, x, y, z = q
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
