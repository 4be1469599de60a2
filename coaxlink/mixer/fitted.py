"""The fitted table: column scales and one thrust curve, chosen for what the autopilot's law makes of them.

An autopilot mixes by s = A+ mu with its own table's A and bends all motors by one curve,
s = fac u^2 + (1 - fac) u (PX4's THR_MDL_FAC, ArduPilot's MOT_THST_EXPO). It cannot hold the surface of a
coaxial rotor (Berra, Trujillo and Heredia 2024, eq. 17), but its few numbers can be chosen so that the wrench
that comes out follows the rotors over an envelope: a thousand times closer than the printed R-CRM of eq. 15.

Errors alone leave the share of the upper rotors nearly free (least squares would park them), so the share is
chosen by power and by the authority that is left; `FittedTable.trade` keeps what was weighed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer.coefficients import reduced_coefficients
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.law import checked_wrench
from coaxlink.vehicle import Vehicle, require_vehicle
from firmware_params.px4 import Px4Table, RotorEntry, realise

SHARES = (0.45, 0.50, 0.55, 0.60, 0.70, 0.85, 1.00)
AUTHORITY_PRICE = 0.05  # a hundredth of thrust ceiling is worth 0.05 % of power
MISS_PRICE = 3.0  # a hundredth of the weight (or of weight x arm) not delivered is worth 3 % of power
ENVELOPE = (0.765, 1.326)  # thrusts, of the weight: 150 to 260 N of the paper's vehicle
CLOSE = 3e-4  # of the weight: a table this close needs no refinement by rotor


@dataclass(frozen=True)
class Trade:
    """One share of the upper rotors, with everything else fitted to it."""

    share: float  # upper column / lower column, thrust
    error: tuple[float, float, float, float]  # mean |error| over the envelope, N and N m
    power: float  # mean sum of torque x speed over the envelope
    power_excess: float  # against the exact law
    ceiling_N: float  # thrust at level attitude when the first rotor is at full speed
    yaw_Nm: float  # yaw at hover thrust when the first rotor is at a bound


@dataclass(frozen=True)
class FittedTable:
    """An autopilot's table: what it shall believe that each rotor does at setpoint 1."""

    ct: NDArray[np.float64]  # (N,) thrust, N
    yaw: NDArray[np.float64]  # (N,) moment on the body about z besides that of the thrust, N m
    axes: NDArray[np.float64]  # (N, 3) direction of the thrust, FRD
    curve: float  # THR_MDL_FAC or MOT_THST_EXPO, 0..1
    chosen: Trade
    trade: tuple[Trade, ...]  # all that were weighed, by share; by-rotor refinement comes after


def envelope(airframe: Airframe, rows: int = 150, seed: int = 1) -> NDArray[np.float64]:
    """(rows, 4) wrenches a vehicle meets: 0.76 to 1.32 of its weight with roll, pitch and yaw.

    Roll and pitch of up to 8 % of weight x arm, yaw up to 2 % of it: on the paper's vehicle 150 to 260 N,
    +-4 and +-1 N m.
    """
    weight = airframe.mass_kg * GRAVITY_M_S2
    arm = max(float(np.hypot(*r.position_m[:2])) for r in airframe.rotors)
    turn = weight * arm * 4.0 / (196.133 * 0.25555)
    low = np.array([ENVELOPE[0] * weight, -turn, -turn, -0.25 * turn])
    high = np.array([ENVELOPE[1] * weight, turn, turn, 0.25 * turn])
    return np.random.default_rng(seed).uniform(low, high, (rows, 4))


def table_axes(airframe: Airframe) -> NDArray[np.float64]:
    """(N, 3) thrust directions for the table: upright where the real ones lean.

    PX4 asks its pseudo-inverse for no sideways force; coaxial arms that lean can only obey by playing upper
    against lower rotors over their small distance, with enormous columns. Told that all rotors stand upright
    it lets the small sideways forces be.
    """
    return np.tile([0.0, 0.0, -1.0], (len(airframe.rotors), 1))


def mixing(airframe: Airframe, ct: NDArray[np.float64], yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4) setpoints per wrench by the pseudo-inverse of an upright table."""
    x, y = np.array([r.position_m[:2] for r in airframe.rotors]).T
    return np.asarray(np.linalg.pinv(np.stack([ct, -y * ct, x * ct, yaw])), np.float64)


def bend(setpoints: ArrayLike, curve: float, spin_min: float, spin_max: float) -> NDArray[np.float64]:
    """Normalised speeds of setpoints: the curve's inverse, then the spin range; clipped to 0..1."""
    s = np.clip(np.asarray(setpoints, float), 0.0, 1.0)
    if curve > 1e-6:
        half = (1.0 - curve) / (2.0 * curve)
        s = np.sqrt(half * half + s / curve) - half
    return np.asarray(spin_min + (spin_max - spin_min) * s)


def fit_table(
    vehicle: Vehicle,
    *,
    wrenches: NDArray[np.float64] | None = None,
    spin_min: float = 0.0,
    spin_max: float = 1.0,
    shares: Sequence[float] = SHARES,
) -> FittedTable:
    """Fit a table to the rotors over `wrenches` (rows, 4), by default `envelope(airframe)`.

    `spin_min`, `spin_max` are ArduPilot's spin range (PX4: 0 and 1). Raises InputError when the envelope is
    out of the vehicle's reach.
    """
    return fit_with_workings(vehicle, wrenches=wrenches, spin_min=spin_min, spin_max=spin_max, shares=shares)[
        0
    ]


def fit_with_workings(
    vehicle: Vehicle,
    *,
    wrenches: NDArray[np.float64] | None = None,
    spin_min: float = 0.0,
    spin_max: float = 1.0,
    shares: Sequence[float] = SHARES,
) -> tuple[FittedTable, TableFit, float]:
    """`fit_table`, what weighs a table on this vehicle, and the exact law's power over the envelope (N m)."""
    require_vehicle(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    demands = envelope(airframe) if wrenches is None else np.asarray(wrenches, float)
    exact = ExactLaw(vehicle)
    best = exact.many(demands)
    torque = airframe.loads(model, best)[1]
    reach = np.abs(airframe.wrench(*airframe.loads(model, best)) - demands).max()
    if reach > 1e-3:
        source = airframe.source or airframe.name
        raise InputError(
            source, "mass_kg", f"these rotors cannot fly its envelope (misses {reach:.2g} N or N m)"
        )
    least = float((torque * best).sum(axis=1).mean())
    fit = TableFit(vehicle, demands, spin_min, spin_max)
    options = [fit.at(share, least) for share in (shares if airframe.pairs else (1.0,))]
    top = max(t.ceiling_N for t, _ in options)
    weight = airframe.mass_kg * GRAVITY_M_S2

    arm = float(np.mean([np.hypot(*r.position_m[:2]) for r in airframe.rotors]))

    def cost(trade: Trade) -> float:
        given_away = AUTHORITY_PRICE * (1.0 - trade.ceiling_N / top)
        # where pairs differ or stand apart (a Y6, a weak rotor), columns by level tip the vehicle
        missed = trade.error[0] + (trade.error[1] + trade.error[2]) / arm
        # less power than the exact law needs is a wrench that was not delivered
        return abs(trade.power_excess) + given_away + MISS_PRICE * missed / weight

    chosen, x = min(options, key=lambda option: cost(option[0]))
    columns = fit.columns(chosen.share, x)
    if chosen.error[0] > CLOSE * weight:
        refined = fit.by_rotor(columns)
        found = fit.weigh(chosen.share, refined, least)
        if cost(found) < cost(chosen):
            columns, chosen = refined, found
    ct, yaw, curve = columns
    table = FittedTable(ct, yaw, table_axes(airframe), curve, chosen, tuple(t for t, _ in options))
    return table, fit, least


Columns = tuple[NDArray[np.float64], NDArray[np.float64], float]  # ct (N,), yaw (N,), curve


class TableFit:
    """What weighs a table on one vehicle over (rows, 4) demands; `low`, `high` are the spin range."""

    def __init__(self, vehicle: Vehicle, demands: NDArray[np.float64], low: float, high: float) -> None:
        airframe = vehicle.airframe
        self.airframe, self.model, self.demands = airframe, vehicle.model, demands
        self.low, self.high = low, high
        self.last: NDArray[np.float64] | None = None  # a share's fit starts from the one before
        self.level = np.array([("upper", "lower", "single").index(r.level) for r in airframe.rotors])
        self.gains = airframe.gains
        self.spin = np.array([r.yaw_sign for r in airframe.rotors], float)
        self.lever = airframe.effectiveness()[0][3]  # yaw of a leaning rotor's thrust, N m per N
        span = np.ptp(demands, axis=0)
        # each axis by its own range; thrust is the one that every wrench has much of
        self.unit = span * np.array([1.0, 3.0, 3.0, 5.0])

    def columns(self, share: float, x: NDArray[np.float64]) -> Columns:
        """Of x = [lower N, upper N m, lower N m, single N, single N m, curve]."""
        thrust_gain, torque_gain = self.gains
        ct = thrust_gain * np.choose(self.level, [share * x[0], x[0], x[3]])
        yaw = self.spin * torque_gain * np.choose(self.level, [x[1], x[2], x[4]]) + self.lever * ct
        return ct, yaw, min(float(x[5]), 1.0)

    def error(self, columns: Columns) -> NDArray[np.float64]:
        """(rows, 4) delivered minus demanded."""
        loads = self.airframe.loads(self.model, self.speeds(columns))
        return self.airframe.wrench(*loads) - self.demands

    def speeds(self, columns: Columns) -> NDArray[np.float64]:
        ct, yaw, curve = columns
        return bend(self.demands @ mixing(self.airframe, ct, yaw).T, curve, self.low, self.high)

    def at(self, share: float, least: float) -> tuple[Trade, NDArray[np.float64]]:
        """The best table with this share, one number a level."""
        c = reduced_coefficients(self.model)
        usual = np.array([c.p_0l, max(share * c.q_0l, 0.1), c.q_0l, c.p_0u, c.q_0u, 0.7])
        low, high = [*(0.01 * usual[:5]), 0.02], [*(20 * usual[:5]), 1.001]
        starts = [usual]
        if self.airframe.singles:
            # yaw from the single rotors or from the pairs: two valleys, and one may cost far more power
            starts.append(usual * np.array([1, 1, 1, 1, 0.15, 1]))
        elif self.last is not None:
            starts = [np.array([self.last[0], usual[1], *self.last[2:]])]
        found = []
        for start in starts:
            x = self._least_squares(lambda x: self.columns(share, x), start, low, high)
            found.append((self.weigh(share, self.columns(share, x), least), x))
        best = min(found, key=lambda f: abs(f[0].power_excess) + f[0].error[0] / self.demands[:, 0].mean())
        self.last = best[1]
        return best

    def weigh(self, share: float, columns: Columns, least: float) -> Trade:
        """Errors, power and authority of a table."""
        u = self.speeds(columns)
        power = float((self.airframe.loads(self.model, u)[1] * u).sum(axis=1).mean())
        return Trade(share, self.mean_error(columns), power, power / least - 1.0, *self._authority(columns))

    def by_rotor(self, columns: Columns) -> Columns:
        """A number a rotor instead of one a level, which layouts such as the Y6 want."""
        ct, yaw, curve = columns
        n = len(ct)
        start = np.array([*ct, *yaw, curve])
        width = np.array([0.15] * n + [0.8] * n + [0.2]) * np.abs(start)
        low, high = start - width, start + width
        high[-1] = max(1.0, start[-1])
        x = self._least_squares(lambda x: (x[:n], x[n : 2 * n], min(float(x[-1]), 1.0)), start, low, high)
        return x[:n], x[n : 2 * n], min(float(x[-1]), 1.0)

    def mean_error(self, columns: Columns) -> tuple[float, float, float, float]:
        """Mean |error| of each axis."""
        thrust, roll, pitch, yaw = (float(e) for e in np.abs(self.error(columns)).mean(axis=0))
        return thrust, roll, pitch, yaw

    def _least_squares(
        self,
        columns: Callable[[NDArray[np.float64]], Columns],
        start: NDArray[np.float64],
        low: Any,
        high: Any,
    ) -> NDArray[np.float64]:
        from scipy.optimize import least_squares

        found = least_squares(
            lambda x: (self.error(columns(x)) / self.unit).ravel(),
            start,
            x_scale=np.maximum(np.abs(start), 0.05),
            bounds=(low, high),
            ftol=1e-5,
            xtol=1e-6,
            max_nfev=80,
        )
        return np.asarray(found.x, np.float64)

    def _authority(self, columns: Columns) -> tuple[float, float]:
        ct, yaw, curve = columns
        mix = mixing(self.airframe, ct, yaw)
        weight = self.airframe.mass_kg * GRAVITY_M_S2
        full = bend(mix[:, 0] / mix[:, 0].max(), curve, self.low, self.high)
        hover, turn = mix[:, 0] * weight, mix[:, 3]
        with np.errstate(divide="ignore"):
            room = np.where(turn > 0, (1.0 - hover) / turn, np.where(turn < 0, -hover / turn, np.inf))
        u = bend(hover + turn * max(float(room.min()), 0.0), curve, self.low, self.high)
        ceiling = self.airframe.wrench(*self.airframe.loads(self.model, full))[0]
        return float(ceiling), float(self.airframe.wrench(*self.airframe.loads(self.model, u))[3])


class FittedLaw:
    """What PX4 itself makes of the fitted table: its normalised mix, desaturation and thrust curve."""

    name = "fitted"
    dropped: tuple[str, ...] = ()

    def __init__(self, vehicle: Vehicle, table: FittedTable | None = None) -> None:
        require_vehicle(vehicle)
        self.table = fit_table(vehicle) if table is None else table
        self._mix = realise(px4_columns(vehicle.airframe, self.table))
        # a control of 1 on an axis means this much wrench: PX4 divides each column of the mix by a scale
        self._scale = self._mix.scale

    def speeds(self, wrench: ArrayLike) -> NDArray[np.float64]:
        """Normalised speeds (N,) for a wrench (4,)."""
        thrust, roll, pitch, yaw = checked_wrench(wrench)
        control = np.array([roll, pitch, yaw, 0.0, 0.0, -thrust]) * self._scale
        return self._mix.throttle(self._mix.setpoints(np.clip(control, -1e3, 1e3)))


def px4_columns(airframe: Airframe, table: FittedTable) -> Px4Table:
    """The fitted table as PX4 holds it (CA_ROTORn_*, THR_MDL_FAC), motor n being rotor n."""
    rotors = tuple(
        RotorEntry(r.position_m, tuple(axis), float(ct), float(yaw / ct))
        for r, ct, yaw, axis in zip(airframe.rotors, table.ct, table.yaw, table.axes.tolist(), strict=True)
    )
    return Px4Table(rotors, table.curve)
