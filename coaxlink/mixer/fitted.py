"""The fitted table: column scales and one thrust curve, chosen for what the autopilot's law makes of them.

An autopilot mixes by s = A+ mu with its own table's A and bends all motors by one curve,
s = fac u^2 + (1 - fac) u (PX4's THR_MDL_FAC, ArduPilot's MOT_THST_EXPO). It cannot hold the surface of a
coaxial rotor (Berra, Trujillo and Heredia 2024, eq. 17), but its few numbers can be chosen so that the wrench
that comes out follows the rotors over an envelope: a thousand times closer than the printed R-CRM of eq. 15.

The error hardly depends on the upper rotors' share of the thrust (least squares would park them), so it is
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
from coaxlink.mixer.demands import envelope
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.law import checked_wrench
from coaxlink.vehicle import Vehicle, require_vehicle
from firmware_params.px4 import Px4Table, RotorEntry, realise

SHARES = (0.45, 0.50, 0.55, 0.60, 0.70, 0.85, 1.00)
AUTHORITY_PRICE = 0.05  # a hundredth of thrust ceiling is worth 0.05 % of power
MISS_PRICE = 3.0  # a hundredth of the weight (or of weight x arm) not delivered is worth 3 % of power
# upper over lower rotors' yaw columns: which of them ends the yaw first; power hardly knows
YAW_SPLITS = (0.7, 1.0, 1.5)
HALVINGS = 7  # of the range of shares
CLOSE = 3e-4  # of the weight: a table this close needs no refinement by rotor

Array = NDArray[np.float64]
Columns = tuple[Array, Array, float]  # ct (N,), yaw (N,), curve


@dataclass(frozen=True)
class Trade:
    """One share of the upper rotors, with everything else fitted to it."""

    share: float  # upper column / lower column, thrust
    error: tuple[float, float, float, float]  # mean |error| over the envelope, N and N m
    power: float  # mean sum of torque x speed over the envelope
    power_excess: float  # against the exact law
    ceiling_N: float  # thrust at level attitude when the first rotor is at full speed
    yaw_Nm: float  # yaw at hover thrust when the first rotor is at a bound

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "power": self.power,
            "power_excess": self.power_excess,
            "ceiling_N": self.ceiling_N,
            "yaw_Nm": self.yaw_Nm,
            "error": list(self.error),
        }


@dataclass(frozen=True)
class FittedTable:
    """An autopilot's table: what it shall believe that each rotor does at setpoint 1.

    Its rotors stand upright where the real ones lean: PX4's pseudo-inverse demands no sideways force, and
    coaxial arms that lean could only obey by playing upper against lower rotors over their small distance,
    with enormous columns.
    """

    ct: Array  # (N,) thrust, N
    yaw: Array  # (N,) moment on the body about z besides that of the thrust, N m
    curve: float  # THR_MDL_FAC or MOT_THST_EXPO, 0..1
    chosen: Trade
    trade: tuple[Trade, ...]  # all that were weighed, by share; by-rotor refinement comes after


def mixing(airframe: Airframe, ct: Array, yaw: Array) -> Array:
    """(N, 4) setpoints per wrench by the pseudo-inverse of an upright table."""
    x, y = np.array([r.position_m[:2] for r in airframe.rotors]).T
    return np.asarray(np.linalg.pinv(np.stack([ct, -y * ct, x * ct, yaw])), np.float64)


def bend(setpoints: ArrayLike, curve: float, spin_min: float, spin_max: float) -> Array:
    """Motor commands of setpoints: the curve's inverse, then the spin range; clipped to 0..1."""
    s = np.clip(np.asarray(setpoints, float), 0.0, 1.0)
    if curve > 1e-6:
        half = (1.0 - curve) / (2.0 * curve)
        s = np.sqrt(half * half + s / curve) - half
    return np.asarray(spin_min + (spin_max - spin_min) * s)


def fit_table(
    vehicle: Vehicle,
    *,
    wrenches: Array | None = None,
    spin_min: float = 0.0,
    spin_max: float = 1.0,
    shares: Sequence[float] = SHARES,
) -> FittedTable:
    """Fit a table to the rotors over `wrenches` (rows, 4), by default `envelope(airframe)`.

    `spin_min`, `spin_max` are ArduPilot's spin range (PX4: 0 and 1). Raises InputError when the envelope is
    out of the vehicle's reach.
    """
    return TableFit(vehicle, spin_min, spin_max, wrenches).fitted(shares)


class TableFit:
    """What weighs a table on one vehicle over (rows, 4) demands; `low`, `high` are the spin range.

    `least` is the exact law's mean power over the demands, N m. Raises InputError as `fit_table`.
    """

    def __init__(self, vehicle: Vehicle, low: float, high: float, demands: Array | None = None) -> None:
        require_vehicle(vehicle)
        self.vehicle, self.airframe, self.model = vehicle, vehicle.airframe, vehicle.model
        self.demands = envelope(self.airframe) if demands is None else np.asarray(demands, float)
        self.low, self.high = low, high
        self.weight = self.airframe.mass_kg * GRAVITY_M_S2
        best = ExactLaw(vehicle).many(self.demands)
        thrust, torque = self.airframe.loads(self.model, best)
        reach = np.abs(self.airframe.wrench(thrust, torque) - self.demands).max()
        if reach > 1e-3:
            source = self.airframe.source or self.airframe.name
            problem = f"these rotors cannot fly its envelope (misses {reach:.2g} N or N m)"
            raise InputError(source, "mass_kg", problem)
        self.least = float((torque * best).sum(axis=1).mean())
        self._last: Array | None = None  # a share's fit starts from the one before
        self._level = np.array([("upper", "lower", "single").index(r.level) for r in self.airframe.rotors])
        self._spin = np.array([r.yaw_sign for r in self.airframe.rotors], float)
        self._lever = self.airframe.effectiveness()[0][3]  # yaw of a leaning rotor's thrust, N m per N
        # each axis by its own range; thrust is the one that every wrench has much of
        self._unit = np.ptp(self.demands, axis=0) * np.array([1.0, 3.0, 3.0, 5.0])

    def fitted(self, shares: Sequence[float] = SHARES) -> FittedTable:
        """The best table of all shares, refined by rotor where columns by level do not come close."""
        options = [self._with_share(share) for share in (shares if self.airframe.pairs else (1.0,))]
        top = max(trade.ceiling_N for trade, _ in options)
        arm = float(np.mean([np.hypot(*r.position_m[:2]) for r in self.airframe.rotors]))

        def cost(trade: Trade) -> float:
            given_away = AUTHORITY_PRICE * (1.0 - trade.ceiling_N / top)
            # where pairs differ or stand apart (a Y6, a weak rotor), columns by level tip the vehicle
            missed = trade.error[0] + (trade.error[1] + trade.error[2]) / arm
            # less power than the exact law needs is a wrench that was not delivered
            return abs(trade.power_excess) + given_away + MISS_PRICE * missed / self.weight

        chosen, x = min(options, key=lambda option: cost(option[0]))
        columns = self._columns(chosen.share, x)
        if chosen.error[0] > CLOSE * self.weight:
            refined = self._by_rotor(columns)
            found = self.weigh(chosen.share, refined)
            if cost(found) < cost(chosen):
                columns, chosen = refined, found
        return FittedTable(*columns, chosen, tuple(trade for trade, _ in options))

    def at(self, share: float) -> FittedTable:
        """The best table of one share, upper column over lower, whatever it costs."""
        trade, x = self._with_share(share)
        return FittedTable(*self._columns(share, x), trade, (trade,))

    def with_margins(self, fitted: FittedTable, ceiling_N: float, yaw_Nm: float) -> FittedTable | None:
        """The table of least power that keeps a ceiling and a yaw in hover, None where no share does.

        From the fitted share of the upper rotors to equal columns the ceiling rises, and so does the power.
        """
        found = []
        for split in YAW_SPLITS if self.airframe.pairs else ():

            def made(share: float, split: float = split) -> FittedTable:
                trade, x = self._with_share(share, split)
                return FittedTable(*self._columns(share, x, split), trade, fitted.trade)

            def keeps(table: FittedTable) -> bool:
                return table.chosen.ceiling_N >= ceiling_N and table.chosen.yaw_Nm >= yaw_Nm

            best, low, high = made(1.0), fitted.chosen.share, 1.0
            if not keeps(best):
                continue
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                table = made(middle)
                best, low, high = (table, low, middle) if keeps(table) else (best, middle, high)
            found.append(best)
        return min(found, key=lambda table: table.chosen.power, default=None)

    def speeds(self, columns: Columns) -> Array:
        """(rows, N) for the demands."""
        ct, yaw, curve = columns
        return self._turned(self.demands @ mixing(self.airframe, ct, yaw).T, curve)

    def _turned(self, setpoints: Array, curve: float) -> Array:
        """Speeds that an autopilot's setpoints (..., N) give."""
        return self.vehicle.turned(bend(setpoints, curve, self.low, self.high))

    def error(self, columns: Columns) -> Array:
        """(rows, 4) delivered minus demanded."""
        return self._wrench(self.speeds(columns)) - self.demands

    def weigh(self, share: float, columns: Columns) -> Trade:
        """Errors, power and authority of a table."""
        u = self.speeds(columns)
        power = float((self.airframe.loads(self.model, u)[1] * u).sum(axis=1).mean())
        thrust, roll, pitch, yaw = np.abs(self.error(columns)).mean(axis=0).tolist()
        errors = (thrust, roll, pitch, yaw)
        return Trade(share, errors, power, power / self.least - 1.0, *self._authority(columns))

    def _wrench(self, u: Array) -> Array:
        return self.airframe.wrench(*self.airframe.loads(self.model, u))

    def _authority(self, columns: Columns) -> tuple[float, float]:
        """Ceiling and yaw in hover."""
        ct, yaw, curve = columns
        mix = mixing(self.airframe, ct, yaw)
        full = self._turned(mix[:, 0] / mix[:, 0].max(), curve)
        hover, turn = mix[:, 0] * self.weight, mix[:, 3]
        with np.errstate(divide="ignore"):
            room = np.where(turn > 0, (1.0 - hover) / turn, np.where(turn < 0, -hover / turn, np.inf))
        u = self._turned(hover + turn * max(float(room.min()), 0.0), curve)
        return float(self._wrench(full)[0]), float(self._wrench(u)[3])

    def _columns(self, share: float, x: Array, split: float | None = None) -> Columns:
        """Of x = [lower N, upper N m, lower N m, single N, single N m, curve]."""
        thrust_gain, torque_gain = self.airframe.gains
        upper_yaw = x[1] if split is None else split * x[2]
        ct = thrust_gain * np.choose(self._level, [share * x[0], x[0], x[3]])
        yaw = self._spin * torque_gain * np.choose(self._level, [upper_yaw, x[2], x[4]]) + self._lever * ct
        return ct, yaw, min(float(x[5]), 1.0)

    def _with_share(self, share: float, split: float | None = None) -> tuple[Trade, Array]:
        """The best table with this share, and this split of yaw, one number a level."""
        c = reduced_coefficients(self.model, of_commands=True)
        usual = np.array([c.p_0l, max(share * c.q_0l, 0.1), c.q_0l, c.p_0u, c.q_0u, 0.7])
        low, high = [*(0.01 * usual[:5]), 0.02], [*(20 * usual[:5]), 1.001]
        starts = [usual]
        if self.airframe.singles:
            # yaw from the single rotors or from the pairs: two valleys, and one may cost far more power
            starts.append(usual * np.array([1, 1, 1, 1, 0.15, 1]))
        elif self._last is not None:
            starts = [np.array([self._last[0], usual[1], *self._last[2:]])]
        found = []
        for start in starts:
            x = self._least_squares(lambda x: self._columns(share, x, split), start, low, high)
            found.append((self.weigh(share, self._columns(share, x, split)), x))
        best = min(found, key=lambda f: abs(f[0].power_excess) + f[0].error[0] / self.demands[:, 0].mean())
        self._last = best[1]
        return best

    def _by_rotor(self, columns: Columns) -> Columns:
        """A number a rotor instead of one a level, which layouts such as the Y6 want."""
        ct, yaw, curve = columns
        n = len(ct)
        start = np.array([*ct, *yaw, curve])
        width = np.array([0.15] * n + [0.8] * n + [0.2]) * np.abs(start)
        low, high = start - width, start + width
        high[-1] = max(1.0, start[-1])

        def split(x: Array) -> Columns:
            return x[:n], x[n : 2 * n], min(float(x[-1]), 1.0)

        return split(self._least_squares(split, start, low, high))

    def _least_squares(
        self, columns: Callable[[Array], Columns], start: Array, low: ArrayLike, high: ArrayLike
    ) -> Array:
        from scipy.optimize import least_squares

        found = least_squares(
            lambda x: (self.error(columns(x)) / self._unit).ravel(),
            start,
            x_scale=np.maximum(np.abs(start), 0.05),
            bounds=(low, high),
            ftol=1e-5,
            xtol=1e-6,
            max_nfev=80,
        )
        return np.asarray(found.x, np.float64)


class FittedLaw:
    """What PX4 itself makes of the fitted table: its normalised mix, desaturation and thrust curve."""

    name = "fitted"
    dropped: tuple[str, ...] = ()

    def __init__(self, vehicle: Vehicle, table: FittedTable | None = None) -> None:
        require_vehicle(vehicle)
        self.table, self._vehicle = fit_table(vehicle) if table is None else table, vehicle
        self._mix = realise(px4_columns(vehicle.airframe, self.table))

    def __repr__(self) -> str:
        return f"FittedLaw({len(self.table.ct)} rotors, thrust curve {self.table.curve:g})"

    def speeds(self, wrench: ArrayLike) -> Array:
        """Normalised speeds (N,) for a wrench (4,)."""
        thrust, roll, pitch, yaw = checked_wrench(wrench)
        # a control of 1 on an axis means `scale` of wrench: PX4 divides each column of the mix by it
        control = np.array([roll, pitch, yaw, 0.0, 0.0, -thrust]) * self._mix.scale
        return self._vehicle.turned(self._mix.throttle(self._mix.setpoints(np.clip(control, -1e3, 1e3))))


def px4_columns(airframe: Airframe, table: FittedTable) -> Px4Table:
    """The fitted table as PX4 holds it (CA_ROTORn_*, THR_MDL_FAC), motor n being rotor n."""
    rotors = tuple(
        RotorEntry(r.position_m, (0.0, 0.0, -1.0), float(ct), float(yaw / ct))
        for r, ct, yaw in zip(airframe.rotors, table.ct, table.yaw, strict=True)
    )
    return Px4Table(rotors, table.curve)
