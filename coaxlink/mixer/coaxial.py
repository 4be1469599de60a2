"""The coaxial mixer: Algorithm 1 of Berra, Trujillo and Heredia 2024 (eq. 8-14, 16), and its completion.

As printed (`studies.paper` alone flies that): the pseudo-inverse of the 4 x 2N matrix A gives each rotor a
thrust and a torque; each upper polynomial is solved for u_u, then each lower one for u_l, both for *thrust*.
The allocated torques are never used, so whatever yaw the speeds happen to make is left standing: the yaw
error is the whole yaw demand.

`coaxial` weighs the torque equations of eq. 13 too: what Algorithm 1 leaves of the wrench is shared among
the pairs as a change of thrust and of net torque, and both equations of a pair are solved for its two
speeds together. Where the two cannot be met inside 0 .. 1 thrust goes before torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.errors import InputError
from coaxlink.mixer.law import checked_wrench
from coaxlink.mixer.plain import PlainRotors
from coaxlink.vehicle import Vehicle

PASSES = 3  # over all pairs; each leaves about the square of what the one before left


@dataclass(frozen=True)
class CoaxialPrinted:
    """Algorithm 1 as printed, for pairs; a single rotor is an upper one with nothing below."""

    rotors: PlainRotors
    inverse: NDArray[np.float64]  # (N, 4) rotor thrust per wrench: the upper half of A+ (eq. 12)
    name: str = "coaxial-printed"
    dropped: tuple[str, ...] = ("yaw",)

    def __repr__(self) -> str:
        return f"CoaxialPrinted({len(self.inverse)} rotors)"

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,); yaw is ignored."""
        thrust = (self.inverse @ checked_wrench(wrench)).tolist()
        rotors = self.rotors
        u = [0.0] * len(thrust)
        model = [f / gain for f, (gain, _) in zip(thrust, rotors.gains, strict=True)]
        for upper, lower in rotors.pairs:
            u[upper] = rotors.upper_thrust.upper_for(model[upper])
            u[lower] = rotors.lower_thrust.lower_for(model[lower], u[upper])
        for single in rotors.singles:
            u[single] = rotors.upper_thrust.upper_for(model[single])
        return np.array(u)


@dataclass(frozen=True)
class Coaxial:
    """Algorithm 1 with the torque equations of eq. 13."""

    printed: CoaxialPrinted
    shares: NDArray[np.float64]  # (pairs + singles + pairs, 4): thrust of each, then net torque of each pair
    signs: tuple[float, ...]  # spin of the lower against the upper, a pair each
    dropped: tuple[str, ...]
    name: str = "coaxial"

    def __repr__(self) -> str:
        return f"Coaxial({len(self.printed.inverse)} rotors)"

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,)."""
        demand = checked_wrench(wrench)
        rotors = self.printed.rotors
        u = self.printed.speeds(demand).tolist()
        aims = [
            _pair_loads(rotors, a, b, u[a], u[b], s)[:2]
            for (a, b), s in zip(rotors.pairs, self.signs, strict=True)
        ]
        lone = [rotors.gains[i][0] * rotors.upper_thrust.at(u[i], 0.0)[0] for i in rotors.singles]
        for _ in range(PASSES):
            missing = demand - rotors.wrench(u)
            if np.abs(missing).max() < 1e-8:
                break
            share = (self.shares @ missing).tolist()
            n = len(aims)
            aims = [(f + share[k], t + share[n + len(lone) + k]) for k, (f, t) in enumerate(aims)]
            lone = [f + share[n + k] for k, f in enumerate(lone)]
            for (a, b), sign, (thrust, torque) in zip(rotors.pairs, self.signs, aims, strict=True):
                u[a], u[b] = solve_pair(rotors, (a, b), thrust, torque, sign, u[a], u[b])
            for i, thrust in zip(rotors.singles, lone, strict=True):
                u[i] = rotors.upper_thrust.upper_for(thrust / rotors.gains[i][0])
        return np.array(u)


def coaxial_printed(vehicle: Vehicle) -> CoaxialPrinted:
    """Algorithm 1 as printed. Raises InputError when thrusts alone cannot make thrust, roll and pitch."""
    airframe = vehicle.airframe
    per_thrust, per_torque = airframe.effectiveness()
    if np.linalg.matrix_rank(per_thrust[:3], tol=1e-9) < 3:
        source = airframe.source or airframe.name
        raise InputError(source, "rotors", "these rotors cannot make thrust, roll and pitch")
    both = np.concatenate([per_thrust, per_torque], axis=1)  # (4, 2N), A of eq. 8
    inverse = np.asarray(np.linalg.pinv(both))[: per_thrust.shape[1]]
    return CoaxialPrinted(PlainRotors.of(vehicle), inverse)


def coaxial(vehicle: Vehicle) -> Coaxial:
    """Algorithm 1 with the torque equations of eq. 13. Raises InputError as `coaxial_printed`."""
    printed, airframe = coaxial_printed(vehicle), vehicle.airframe
    per_thrust, per_torque = airframe.effectiveness()
    signs = tuple(float(airframe.rotors[a].yaw_sign * airframe.rotors[b].yaw_sign) for a, b in airframe.pairs)
    columns = [0.5 * (per_thrust[:, a] + per_thrust[:, b]) for a, b in airframe.pairs]
    columns += [per_thrust[:, i] for i in airframe.singles]
    columns += [per_torque[:, a] for a, _ in airframe.pairs]
    # yaw has no thrust to come from, so any scale serves; a small one keeps roll and pitch to thrust
    scale = np.array([1.0] * (len(columns) - len(signs)) + [0.05] * len(signs))
    shares = scale[:, None] * np.linalg.pinv(np.stack(columns, axis=1) * scale, rcond=1e-9)
    return Coaxial(printed, shares, signs, () if signs else ("yaw",))


def _pair_loads(
    rotors: PlainRotors, a: int, b: int, upper: float, lower: float, sign: float
) -> tuple[float, float, float, float, float, float]:
    """Thrust and net torque (in the upper's sense) of the pair a over b, and their slopes by u_u and u_l."""
    (pu, qu), (pl, ql) = rotors.gains[a], rotors.gains[b]
    ql *= sign
    fu, fu_u, fu_l = rotors.upper_thrust.at(upper, lower)
    fl, fl_u, fl_l = rotors.lower_thrust.at(upper, lower)
    tu, tu_u, tu_l = rotors.upper_torque.at(upper, lower)
    tl, tl_u, tl_l = rotors.lower_torque.at(upper, lower)
    return (
        pu * fu + pl * fl, qu * tu + ql * tl,
        pu * fu_u + pl * fl_u, pu * fu_l + pl * fl_l, qu * tu_u + ql * tl_u, qu * tu_l + ql * tl_l,
    )  # fmt: skip


def solve_pair(
    rotors: PlainRotors,
    pair: tuple[int, int],
    thrust: float,
    torque: float,
    sign: float,
    upper: float,
    lower: float,
) -> tuple[float, float]:
    """Both speeds of a pair (upper, lower) for its thrust (N) and net torque (N m, upper's sense).

    Newton on the two equations from a first guess of the speeds, each step held inside 0 .. 1; at a bound the
    other speed serves thrust alone.
    """
    for _ in range(12):
        f, t, f_u, f_l, t_u, t_l = _pair_loads(rotors, *pair, upper, lower, sign)
        miss_f, miss_t = thrust - f, torque - t
        if abs(miss_f) < 1e-11 and abs(miss_t) < 1e-12:
            break
        det = f_u * t_l - f_l * t_u
        if abs(det) < 1e-9:
            break
        step_u, step_l = (miss_f * t_l - f_l * miss_t) / det, (f_u * miss_t - t_u * miss_f) / det
        want_u, want_l = upper + step_u, lower + step_l
        new_u, new_l = min(max(want_u, 0.0), 1.0), min(max(want_l, 0.0), 1.0)
        # a speed held at its bound: the other one makes up the thrust
        if new_u != want_u and f_l > 0:
            new_l = min(max(lower + (miss_f - f_u * (new_u - upper)) / f_l, 0.0), 1.0)
        elif new_l != want_l and f_u > 0:
            new_u = min(max(upper + (miss_f - f_l * (new_l - lower)) / f_u, 0.0), 1.0)
        if abs(new_u - upper) + abs(new_l - lower) < 1e-15:
            break
        upper, lower = new_u, new_l
    return upper, lower
