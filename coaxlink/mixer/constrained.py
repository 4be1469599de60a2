"""The fitted table under limits that a user states, and what each of them costs.

Same vehicle, same envelope and the same prices of power and ceiling as `mixer.fitted`; here all columns and
the curve move at once. Delivered wrench, power and what is limited are linear in a small step of them, so
each step is a convex problem (cvxpy): error in the 2-norm, power and ceiling at their price, limits with a
slack that costs more than all they could buy (an exact penalty), inside a trust region. A step is taken only
when the table itself, not its linear picture, is better for it (Conn, Gould and Toint 2000, chapter 15).

Rotors of a level that have the same numbers keep them alike, unless a limit names rotors.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import CheckFailed
from coaxlink.mixer.demands import demand_units
from coaxlink.mixer.fitted import AUTHORITY_PRICE, Columns, FittedTable, TableFit, Trade, mixing
from coaxlink.mixer.limits import Limit
from coaxlink.rotor.lasso import solve
from coaxlink.vehicle import Vehicle

ERROR_PRICE = 10.0  # a thousandth of weight (and weight x arm) of rms error is worth 1 % of power
PENALTY = 100.0  # of a limit missed by all of its scale: above what power and ceiling can pay (1 + 0.05)
MET = 1e-4  # of a limit's scale
STEPS, WIDEST, CLOSEST = 40, 0.3, 1e-4  # steps; trust region, of each number
NUDGE = 1e-6
BEYOND = 0.02  # of a setpoint
Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldLimit:
    """One limit: what the fitted table does, what this one does, and what it would be without the limit."""

    limit: Limit
    before: float | None  # the worst value of the fitted table, None for `equal`
    now: float | None
    without: Trade  # this table's trade, all other limits kept


@dataclass(frozen=True)
class ConstrainedTable:
    """A table that keeps limits."""

    table: FittedTable
    fitted: FittedTable  # without any
    limits: tuple[HeldLimit, ...]

    def to_json(self) -> dict[str, Any]:
        """As `table --constrain --json` writes it."""
        kept = [
            {
                "limit": held.limit.to_json(),
                "fitted": held.before,
                "now": held.now,
                "without": held.without.to_json(),
            }
            for held in self.limits
        ]
        return {
            "fitted": self.fitted.chosen.to_json(),
            "now": self.table.chosen.to_json(),
            "kept": kept,
        }


def constrained_table(
    vehicle: Vehicle, limits: Sequence[Limit], *, spin_min: float = 0.0, spin_max: float = 1.0
) -> ConstrainedTable:
    """The table nearest to the rotors, at least power and most ceiling, that keeps `limits`.

    `spin_min`, `spin_max` as for `fit_table`. Raises InputError as that does, and CheckFailed when no table
    near the fitted one keeps them: it names the limit and how far one gets.
    """
    fit = TableFit(vehicle, spin_min, spin_max)
    fitted = fit.fitted()
    search = _Search(fit, fitted)
    start = np.array([*fitted.ct, *fitted.yaw, fitted.curve])
    x = search.under(start, limits)
    for limit in limits:
        if search.missed(x, limit) > MET:
            value = search.worst(x, limit)
            got = "" if value is None else f": the nearest gets to {limit.shown(value)}"
            with_others = ", the other limits holding" if len(limits) > 1 else ""
            raise CheckFailed(f"no table near the fitted one keeps: {limit}{got}{with_others}")
    held = []
    for n, limit in enumerate(limits):
        others = [*limits[:n], *limits[n + 1 :]]
        # a limit that costs nothing leaves the table where it is
        without = search.trade(
            x if search.missed(start, limit) <= 0 and others else search.under(start, others)
        )
        held.append(HeldLimit(limit, search.worst(start, limit), search.worst(x, limit), without))
    table = FittedTable(*search.columns(x), search.trade(x), fitted.trade)
    return ConstrainedTable(table, fitted, tuple(held))


class _Search:
    """Everything that stays the same while limits come and go. x = [ct (N,), yaw (N,), curve]."""

    def __init__(self, fit: TableFit, fitted: FittedTable) -> None:
        self.fit = fit
        self.n = len(fit.airframe.rotors)
        self.units = demand_units(fit.airframe, fit.weight)
        self.scales = {"speed": 1.0, "hover_share": 1.0, "ceiling_N": fit.weight, "yaw_Nm": self.units[3]}
        self.top = max(t.ceiling_N for t in fitted.trade)
        first = np.array([*fitted.ct, *fitted.yaw, fitted.curve])
        # a yaw column may be next to nothing: it moves with the largest
        self.size = np.maximum(
            np.abs(first), [0.0] * self.n + [0.2 * np.abs(fitted.yaw).max()] * self.n + [0.1]
        )
        self.low = np.array([0.02 * fitted.ct.mean()] * self.n + [-np.inf] * self.n + [0.02])
        self.high = np.array([np.inf] * (2 * self.n) + [1.0])

        levels = Limit("equal", of="levels")
        self.alike = [levels] if self.missed(first, levels) <= 0 else []

    def columns(self, x: Array) -> Columns:
        return x[: self.n], x[self.n : 2 * self.n], float(x[-1])

    def trade(self, x: Array) -> Trade:
        columns = self.columns(x)
        ratio = [float(columns[0][u] / columns[0][w]) for u, w in self.fit.airframe.pairs]
        return self.fit.weigh(float(np.mean(ratio)) if ratio else 1.0, columns)

    def under(self, start: Array, limits: Sequence[Limit]) -> Array:
        """The best x that keeps the limits, or comes nearest; `start` itself if it keeps them all."""
        apart = any(limit.rotors for limit in limits)
        ties = self._ties([*limits, *([] if apart else self.alike)])
        if max((self.missed(start, limit) for limit in limits), default=0.0) <= 0.0:
            return start
        x = start - np.linalg.pinv(ties) @ (ties @ start) if len(ties) else start
        measured = [limit for limit in limits if limit.kind != "equal"]
        radius, merit = WIDEST, self._merit(x, measured)
        for _ in range(STEPS):
            step = self._step(x, measured, ties, radius)
            found = np.inf if step is None else self._merit(x + step, measured)
            if step is None or found >= merit - 1e-9:
                radius /= 4.0
                if radius < CLOSEST:
                    break
                continue
            gain = merit - found
            x, merit = x + step, found
            radius = min(2.0 * radius, WIDEST)
            if gain < 1e-6:
                break
        return x

    def missed(self, x: Array, limit: Limit) -> float:
        """By how much of its scale a limit is missed; 0 or less where it is kept."""
        if limit.kind == "equal":
            return float(np.abs(self._ties([limit]) @ (x / self.size)).max(initial=0.0)) - MET
        values, scale = self._values(x, limit), self.scales[limit.kind]
        below = (limit.low - values.min()) / scale if limit.low is not None else -np.inf
        above = (values.max() - limit.high) / scale if limit.high is not None else -np.inf
        return float(max(below, above))

    def worst(self, x: Array, limit: Limit) -> float | None:
        """The value that comes nearest to the limit, or goes farthest beyond."""
        if limit.kind == "equal":
            return None
        values = self._values(x, limit)
        if limit.low is None or (
            limit.high is not None and values.max() - limit.high > limit.low - values.min()
        ):
            return float(values.max())
        return float(values.min())

    def _merit(self, x: Array, limits: Sequence[Limit]) -> float:
        error, power, ceilings = self._outcome(x)
        missed = sum(max(self.missed(x, limit), 0.0) for limit in limits)
        given_away = AUTHORITY_PRICE * (1.0 - ceilings.min() / self.top)
        return float(ERROR_PRICE * np.linalg.norm(error) + abs(power) + given_away + PENALTY * missed)

    def _outcome(self, x: Array) -> tuple[Array, float, Array]:
        """(rows x 4,) errors whose norm is the rms error, power above the exact law's, (N,) ceilings."""
        columns = self.columns(x)
        u = self.fit.speeds(columns)
        loads = self.fit.airframe.loads(self.fit.model, u)
        error = (self.fit.airframe.wrench(*loads) - self.fit.demands) / self.units
        power = float((loads[1] * u).sum(axis=1).mean()) / self.fit.least - 1.0
        return error.ravel() / np.sqrt(len(u)), power, self._ceilings(columns)

    def _ceilings(self, columns: Columns) -> Array:
        """(N,) level thrust when each rotor is at full speed; the smallest is the table's."""
        ct, yaw, curve = columns
        share = mixing(self.fit.airframe, ct, yaw)[:, 0]
        u = self._speeds_beyond(share / np.maximum(share, 1e-9)[:, None], curve)
        return np.asarray(self.fit.airframe.wrench(*self.fit.airframe.loads(self.fit.model, u))[:, 0])

    def _values(self, x: Array, limit: Limit) -> Array:
        """Everything that a limit bounds, one by one, so that each is smooth in x."""
        columns, frame, model = self.columns(x), self.fit.airframe, self.fit.model
        if limit.kind == "ceiling_N":
            return self._ceilings(columns)
        if limit.kind == "speed":
            which = [n - 1 for n in limit.rotors] or slice(None)
            return np.asarray(self.fit.speeds(columns)[:, which].ravel())
        ct, yaw, curve = columns
        mix = mixing(frame, ct, yaw)
        hover = mix[:, 0] * self.fit.weight
        if limit.kind == "hover_share":
            thrust = frame.loads(model, self._speeds_beyond(hover, curve))[0]
            return np.array([thrust[u] / (thrust[u] + thrust[w]) for u, w in frame.pairs])
        turn = mix[:, 3]
        room = np.concatenate([(1.0 - hover) / turn, -hover / turn])  # either bound, either way round
        at = self._speeds_beyond(hover + np.outer(room, turn), curve)
        return np.asarray(np.abs(frame.wrench(*frame.loads(model, at))[:, 3]))

    def _speeds_beyond(self, setpoints: Array, curve: float) -> Array:
        """`bend`, but going on a little beyond its bounds.

        There rotors that are alike get to their bound together: cut off at once, none of them has a slope.
        """
        s, half = np.clip(setpoints, -BEYOND, 1.0 + BEYOND), (1.0 - curve) / (2.0 * curve)
        fraction = np.sqrt(np.maximum(half * half + s / curve, 0.0)) - half
        return np.asarray(self.fit.low + (self.fit.high - self.fit.low) * fraction)

    def _step(self, x: Array, limits: Sequence[Limit], ties: Array, radius: float) -> Array | None:
        """The convex problem of one step, None when the solver gives none."""
        import cvxpy as cp

        at = self._all(x, limits)
        free = _null_space(ties * self.size)  # (2N + 1, k) moves that keep alike what shall be
        moves = NUDGE * (self.size[:, None] * free).T
        J = np.stack([(self._all(x + h, limits) - at) / NUDGE for h in moves], axis=1)
        rows = self.fit.demands.size
        q, R = np.linalg.qr(J[:rows])
        outside = float(np.linalg.norm(at[:rows] - q @ (q.T @ at[:rows])))
        top, slack = cp.Variable(), cp.Variable(max(len(limits), 1), nonneg=True)
        w = cp.Variable(free.shape[1])
        d = free @ w
        # what no step takes off the error stays under the root
        error = cp.norm(cp.hstack([R @ w + q.T @ at[:rows], outside]))
        cost = ERROR_PRICE * error + cp.abs(at[rows] + J[rows] @ w) - AUTHORITY_PRICE * top
        row = rows + 1 + self.n
        bound = [top <= at[rows + 1 : row] + J[rows + 1 : row] @ w, cp.abs(d) <= radius]
        keep = np.isfinite(self.low)
        bound.append(d[keep] >= ((self.low - x) / self.size)[keep])
        keep = np.isfinite(self.high)
        bound.append(d[keep] <= ((self.high - x) / self.size)[keep])
        for n, limit in enumerate(limits):
            count, scale = len(self._values(x, limit)), self.scales[limit.kind]
            value, slope = at[row : row + count], J[row : row + count]
            if limit.high is not None:
                bound.append(value + slope @ w <= limit.high / scale + slack[n])
            if limit.low is not None:
                bound.append(value + slope @ w >= limit.low / scale - slack[n])
            row += count
        solve(cp.Problem(cp.Minimize(cost + PENALTY * cp.sum(slack)), bound))
        return None if d.value is None else np.asarray(d.value * self.size)

    def _all(self, x: Array, limits: Sequence[Limit]) -> Array:
        error, power, ceilings = self._outcome(x)
        bounded = [self._values(x, limit) / self.scales[limit.kind] for limit in limits]
        return np.concatenate([error, [power], ceilings / self.top, *bounded])

    def _ties(self, limits: Sequence[Limit]) -> Array:
        """(m, 2N + 1) rows that are zero on x where the limits of kind equal want numbers alike."""
        rotors, gains = self.fit.airframe.rotors, self.fit.airframe.gains
        rows = []
        for limit in limits:
            if limit.kind != "equal":
                continue
            for i, j in _alike(self.fit, limit.of):
                spins = np.array([r.yaw_sign for r in rotors])
                for k, weights in enumerate((1.0 / gains[0], spins / gains[1])):
                    row = np.zeros(2 * self.n + 1)
                    row[k * self.n + i], row[k * self.n + j] = weights[i], -weights[j]
                    rows.append(row)
        return np.array(rows).reshape(len(rows), 2 * self.n + 1)


def _null_space(rows: Array) -> Array:
    """(n, k) orthonormal columns that (m, n) rows send to zero."""
    if not len(rows):
        return np.eye(rows.shape[1])
    scaled = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    _, singular, vectors = np.linalg.svd(scaled)
    return np.asarray(vectors[int((singular > 1e-9).sum()) :].T)


def _alike(fit: TableFit, of: str) -> list[tuple[int, int]]:
    """Pairs of rotors (indices) that shall have the same numbers."""
    rotors = fit.airframe.rotors
    if of == "levels":
        chains = [
            [i for i, r in enumerate(rotors) if r.level == level] for level in ("upper", "lower", "single")
        ]
        return [(a, b) for chain in chains for a, b in itertools.pairwise(chain)]
    found = []
    for i, r in enumerate(rotors):
        x, y, z = r.position_m
        for j, other in enumerate(rotors):
            mirrored = np.allclose(other.position_m, (x, -y, z), atol=0.02 * max(abs(y), 1e-3))
            if y > 0 and other.level == r.level and mirrored:
                found.append((i, j))
    return found
