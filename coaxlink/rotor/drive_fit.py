"""The drive and the battery watts of a stand log: what throttles, volts and amps say beside the loads.

    throttle V / V_ref = c_0 + c_1 n + c_2 n^2 (+ c_3 n^3) + (r + s n) Q        (`rotor.drive`)

by robust least squares over the rows in which the motor drives its rotor: one that the wake turns runs free
of its ESC. Full throttle is where the rotors would turn at throttle 1, each with its own torque there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.data import Samples
from coaxlink.data.aliases import SIDES
from coaxlink.rotor.drive import TURNS, BatteryPower, Drive, SideDrive

Array = NDArray[np.float64]
AT_FULL = 0.98  # of throttle: full throttle was measured
LEAST_ROWS, LEAST_SPAN = 8, 0.3  # rows and range of throttle that tell a bend
SURE = 0.02  # of the speed at full throttle, its standard error: what two rpm sensors are apart
BENT = 0.05  # of full speed, between a throttle and the speed it gives: more is reported
DRIVEN = 0.6  # of the torque that the rotor has alone at its speed: below, the wake helps to turn it
HUBER, REWEIGHTINGS = 2.5, 12  # deviations beyond which a row counts less (Huber 1964); effort
PARTS = 10  # left out in turn
PAYS = 0.9  # of the error: a term that does not bring it below is left out
WATTS_ROWS = 12  # rows; five terms are fitted to them, and a part of the rows left out in turn
CERTAIN = 5.0  # standard errors of a slope that is no chance
# of the fastest and of the greatest torque, judgement: within it what a motor draws goes straight
ALIKE, MOST_ROWS = 0.05, 1000  # rows, effort: all of them against one another
# of the most shaft watts; the other side's, of these: more, and a reading may end at nothing
LOADED, OUTDRAWN = 0.05, 5.0


@dataclass(frozen=True)
class DriveFit:
    """Of one rotor, speeds in rpm."""

    coefficients: tuple[float, ...]  # c_0, c_1 per rpm, ... at `volts`
    per_torque: tuple[float, float]  # r, s: 1/(N m), 1/(N m rpm)
    torque: float  # N m per rpm^2 at the top of the log
    volts: float | None  # supply near full throttle, None where it was not measured
    low: float  # the least throttle of the rows, the greatest
    top: float
    error: float  # standard error of a throttle, on rows left out
    error_full: float  # standard error of the throttle at full speed

    @cached_property
    def full_rpm(self) -> float:
        """At throttle 1 and the usual supply; infinite where no speed takes that."""
        n = np.linspace(0.0, 4.0 / max(self.coefficients[1], 1e-9), 20001)
        above = self._throttle(n) >= 1.0
        return float(n[int(np.argmax(above))]) if above.any() else float("inf")

    def _throttle(self, rpm: Array) -> Array:
        r, s = self.per_torque
        return np.polynomial.Polynomial(self.coefficients)(rpm) + (r + s * rpm) * self.torque * rpm**2

    @property
    def known(self) -> bool:
        """Whether the log tells what full throttle gives."""
        n = self.full_rpm
        if not np.isfinite(n):
            return False
        slope = float(self._throttle(np.array([n * 1.001]))[0] - self._throttle(np.array([n * 0.999]))[0])
        return slope > 0 and self.error_full / slope * 0.002 <= SURE

    @property
    def reaches_full(self) -> bool:
        """Whether speeds may be taken from throttles by it: full throttle was measured, or is known."""
        return self.known or self.top >= AT_FULL

    def bend(self) -> tuple[float, float]:
        """(throttle, share of full speed there) where the two are furthest apart, of the log's throttles."""
        n = np.linspace(TURNS, 1.0, 400) * self.full_rpm
        throttle, share = self._throttle(n), n / self.full_rpm
        inside = (throttle >= self.low) & (throttle <= self.top)
        at = int(np.argmax(np.where(inside, np.abs(share - throttle), -1.0)))
        return float(throttle[at]), float(share[at])

    def side(self, speed_max_rpm: float) -> SideDrive:
        """As the rotor file has it, over u = rpm / speed_max_rpm."""
        scaled = tuple(float(c * speed_max_rpm**k) for k, c in enumerate(self.coefficients))
        r, s = self.per_torque
        range_ = round(self.low, 4), round(self.top, 4)
        return SideDrive(scaled, r, s * speed_max_rpm, range_, self.error)


def drive_fits(samples: Samples) -> dict[str, DriveFit]:
    """Of each side whose throttle and rpm are measured, where the rows tell one."""
    found: dict[str, DriveFit] = {}
    for side in SIDES:
        if samples.has(f"{side}_rpm", f"{side}_throttle") and np.any(samples[f"{side}_rpm"] > 0):
            fit = _drive_fit(samples, side)
            found |= {side: fit} if fit is not None else {}
    return found


def at_full_throttle(fits: Mapping[str, DriveFit]) -> float | None:
    """The fastest rotor's rpm at full throttle by its drive; None where one is not known."""
    if not fits or not all(fit.known for fit in fits.values()):
        return None
    return max(fit.full_rpm for fit in fits.values())


def drive_of(fits: Mapping[str, DriveFit], speed_max_rpm: float) -> Drive | None:
    """The pair's, where the sides that were measured reach full throttle."""
    if not fits or not all(fit.reaches_full for fit in fits.values()):
        return None
    first = next(iter(fits.values()))
    volts = [fit.volts for fit in fits.values() if fit.volts is not None]
    usual = float(np.mean(volts)) if len(volts) == len(fits) else None
    sides = {}
    for side, fit in fits.items():
        scaled = fit.side(speed_max_rpm)
        share = fit.volts / usual if usual is not None and fit.volts is not None else 1.0
        command = tuple(c * share for c in scaled.command)
        per = scaled.torque_per_Nm * share, scaled.torque_speed_per_Nm * share
        sides[side] = SideDrive(command, *per, scaled.range, scaled.error)
    only = sides["upper" if first is fits.get("upper") else next(iter(fits))]
    return Drive(sides.get("upper", only), sides.get("lower", only), usual)


def supply(samples: Samples, side: str) -> Array | None:
    """(rows,) V of a side's ESC, None where no column has it."""
    name = next((n for n in (f"{side}_voltage_V", "voltage_V") if samples.has(n)), None)
    return None if name is None else samples[name]


def driven(rpm: Array, torque: Array | None) -> NDArray[np.bool_]:
    """(rows,) in which the motor drives its rotor: its torque is near what it has alone at this speed."""
    if torque is None:
        return np.ones(len(rpm), bool)
    fast = np.isfinite(torque) & (rpm > 0.3 * rpm.max(initial=0.0))
    if not fast.any():
        return np.isfinite(torque)
    alone = float(np.quantile(torque[fast] / rpm[fast] ** 2, 0.9))
    return np.asarray(np.isfinite(torque) & (torque > DRIVEN * alone * rpm**2))


def _drive_fit(samples: Samples, side: str) -> DriveFit | None:
    throttle, rpm = samples[f"{side}_throttle"], samples[f"{side}_rpm"]
    torque = samples[f"{side}_torque_Nm"] if samples.has(f"{side}_torque_Nm") else None
    volts = supply(samples, side)
    rows = (throttle > TURNS) & (rpm > TURNS * float(rpm.max(initial=0.0))) & driven(rpm, torque)
    if volts is not None:
        rows &= np.isfinite(volts) & (volts > 0.5 * np.nanmedian(volts))
    if rows.sum() < LEAST_ROWS or np.ptp(throttle[rows]) < LEAST_SPAN:
        return None
    t, n, q = throttle[rows], rpm[rows], None if torque is None else torque[rows]
    fast = t >= np.quantile(t, 0.9)
    usual = None if volts is None else float(np.median(volts[rows][fast]))
    y = t if volts is None or usual is None else t * volts[rows] / usual
    unit = float(n.max())
    share = 0.0 if q is None else float(np.median(q[fast] / n[fast] ** 2))
    best: _Form | None = None
    for order, terms in ((2, 0), (2, 1), (2, 2), (3, 0), (3, 1), (3, 2)):
        if q is None and terms:
            continue
        tried = _form(n / unit, q, y, order, terms)
        speeds = np.linspace(0.3, 1.15, 40)
        rises = np.diff(_command(tried, speeds, share * unit**2, order)).min() > 0.0
        resists = all(np.polynomial.Polynomial([*tried.values[order + 1 :], 0.0])(speeds) >= 0.0)
        if rises and resists and (best is None or tried.missed < PAYS * best.missed):
            best = replace(tried, order=order)
    if best is None:
        return None
    b, order = best.values, best.order
    per = [float(v) for v in b[order + 1 :]] + [0.0, 0.0]
    fit = DriveFit(
        tuple(float(c / unit**k) for k, c in enumerate(b[: order + 1])), (per[0], per[1] / unit), share,
        usual, float(t.min()), float(t.max()), best.missed, 0.0,
    )  # fmt: skip
    full = min(fit.full_rpm, 2.0 * unit) / unit
    at = _row(np.array([full]), np.array([share * (full * unit) ** 2]), order, len(b) - order - 1)[0]
    return replace(fit, error_full=float(np.sqrt(at @ best.covariance @ at)))


@dataclass(frozen=True)
class _Form:
    """One form of a drive, fitted."""

    values: Array
    covariance: Array
    missed: float  # rms of rows left out
    order: int = 0


def _row(n: Array, q: Array, order: int, terms: int) -> Array:
    """(rows, order + 1 + terms) of the form's terms."""
    return np.stack([*(n**k for k in range(order + 1)), *(q * n**k for k in range(terms))], axis=1)


def _command(form: _Form, n: Array, torque: float, order: int) -> Array:
    """Of a rotor alone, whose torque goes with the square of its speed."""
    return _row(n, torque * n**2, order, len(form.values) - order - 1) @ form.values


def _form(n: Array, q: Array | None, y: Array, order: int, terms: int) -> _Form:
    X = _row(n, np.zeros_like(n) if q is None else q, order, terms)
    w = _weights(X, y)
    scaled = X * w[:, None]
    b = np.asarray(np.linalg.lstsq(scaled, y * w, rcond=None)[0], np.float64)
    left = y * w - scaled @ b
    variance = float(left @ left) / max(len(y) - X.shape[1], 1)
    covariance = np.asarray(variance * np.linalg.pinv(scaled.T @ scaled), np.float64)
    return _Form(b, covariance, _left_out(X, y))


def _weights(X: Array, y: Array) -> Array:
    """(rows,) square roots of Huber's weights."""
    w = np.ones(len(y))
    for _ in range(REWEIGHTINGS):
        left = y - X @ np.linalg.lstsq(X * w[:, None], y * w, rcond=None)[0]
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-9)
        w = np.sqrt(np.minimum(1.0, HUBER * scale / np.maximum(np.abs(left), 1e-12)))
    return w


def _left_out(X: Array, y: Array) -> float:
    """Root mean square error of rows that a fit has not seen, in stretches of the log."""
    part = np.arange(len(y)) * PARTS // len(y)
    missed = np.empty(len(y))
    for k in range(PARTS):
        out = part == k
        if not out.any():
            continue
        w = _weights(X[~out], y[~out])
        missed[out] = y[out] - X[out] @ np.linalg.lstsq(X[~out] * w[:, None], y[~out] * w, rcond=None)[0]
    return float(np.sqrt(np.mean(missed**2)))


@dataclass(frozen=True)
class WattsFit:
    """Battery watts of one side, and what its log says of its efficiency."""

    power: BatteryPower
    efficiency: float  # shaft over battery energy, of the rows in which the motor drives
    crosstalk: float  # watts that its reading lacks for each watt that the other side draws
    less_than_shaft: int  # rows, of these, in which the reading is below the shaft's power


def watts_fits(samples: Samples) -> dict[str, WattsFit]:
    """Of each side whose volts and amps (or watts), rpm and torque are measured."""
    drawn = {side: drawn_watts(samples, side) for side in SIDES}
    lacks = {side: _crosstalk(samples, side, drawn) for side in SIDES}
    found: dict[str, WattsFit] = {}
    for side, read in drawn.items():
        if read is not None and samples.has(f"{side}_rpm", f"{side}_torque_Nm"):
            other, true = drawn[_other(side)], read
            if lacks[side] and other is not None:
                known = other < OUTDRAWN * _shaft_watts(samples, side)
                true = np.where(known, read + lacks[side] * other, np.nan)
            fit = _watts_fit(samples, side, true / (1.0 - lacks["upper"] * lacks["lower"]), read)
            found |= {side: replace(fit, crosstalk=lacks[side])} if fit is not None else {}
    return found


def _other(side: str) -> str:
    return SIDES[1 - SIDES.index(side)]


def _shaft_watts(samples: Samples, side: str) -> Array:
    return np.asarray(samples[f"{side}_rpm"] * RAD_S_PER_RPM * samples[f"{side}_torque_Nm"])


def drawn_watts(samples: Samples, side: str) -> Array | None:
    """(rows,) W into a side's ESC, None where they were not measured."""
    if samples.has(f"{side}_power_W"):
        return samples[f"{side}_power_W"]
    volts = supply(samples, side)
    if volts is None or not samples.has(f"{side}_current_A"):
        return None
    return np.asarray(volts * samples[f"{side}_current_A"])


def _watts_fit(samples: Samples, side: str, drawn: Array, read: Array) -> WattsFit | None:
    from scipy.optimize import nnls  # scipy takes a third of a second to load

    rpm, torque = samples[f"{side}_rpm"], samples[f"{side}_torque_Nm"]
    rows = np.isfinite(drawn) & (rpm > TURNS * float(rpm.max(initial=0.0))) & driven(rpm, torque)
    if rows.sum() < WATTS_ROWS or np.ptp(drawn[rows]) < 0.3 * drawn[rows].max():
        return None
    w, q, p = rpm[rows] * RAD_S_PER_RPM, torque[rows], drawn[rows]
    shaft = q * w
    X = np.stack([np.ones_like(w), w, w**2, q**2, shaft], axis=1)
    unit = np.abs(X).max(axis=0)

    def fitted(keep: NDArray[np.bool_]) -> Array:
        """The shaft's power and losses on top of it: less from the battery would be power from nothing."""
        near = 1.0 / np.maximum(0.02 * p[keep].max() + 0.02 * p[keep], 1e-9)
        lost = nnls(X[keep] / unit * near[:, None], (p - shaft)[keep] * near)[0] / unit
        return np.asarray([*lost[:4], 1.0 + lost[4]])

    part = np.arange(len(p)) * PARTS // len(p)
    missed = np.concatenate([p[part == k] - X[part == k] @ fitted(part != k) for k in range(PARTS)])
    b = fitted(np.ones(len(p), bool))
    constant, per_w, per_w2, copper, of_shaft = b.tolist()
    missed_W = float(np.sqrt(np.mean(missed**2)))
    power = BatteryPower(constant, per_w, per_w2, copper, of_shaft, missed_W)
    return WattsFit(power, float(shaft.sum() / p.sum()), 0.0, int(np.sum(read[rows] < shaft)))


def _crosstalk(samples: Samples, side: str, drawn: Mapping[str, Array | None]) -> float:
    """Watts that a side's reading lacks for each watt that the other's shows; 0 where that may be chance.

    A rotor that turns alike under a like torque takes like watts, whatever the other one does. Where readings
    of such rows differ as the other side's do, a sensor reads some of the other's current (Ott,
    Electromagnetic Compatibility Engineering 2009, ch. 3: a common ground). No form of a drive is assumed.
    """
    read, other = drawn[side], drawn[_other(side)]
    if read is None or other is None or not samples.has(f"{side}_rpm", f"{side}_torque_Nm"):
        return 0.0
    rpm, torque = samples[f"{side}_rpm"], samples[f"{side}_torque_Nm"]
    shaft = _shaft_watts(samples, side)
    with np.errstate(invalid="ignore"):
        fair = np.isfinite(read + other + shaft) & (shaft > LOADED * np.nanmax(shaft, initial=0.0))
        rows = np.flatnonzero(fair & (other < OUTDRAWN * shaft))
    if len(rows) < WATTS_ROWS:
        return 0.0
    rows = rows[:: -(-len(rows) // MOST_ROWS)]
    place = np.stack([rpm[rows] / rpm[rows].max(), torque[rows] / torque[rows].max()], axis=1)
    apart = np.hypot(*(place[:, None] - place).transpose(2, 0, 1))
    i, j = (rows[k] for k in np.nonzero(np.triu(apart < ALIKE, 1)))
    if len(i) < WATTS_ROWS or not np.any(other[i] != other[j]):
        return 0.0
    own = np.stack([values[i] - values[j] for values in (rpm, torque)], axis=1)
    lost, others = (values[i] - values[j] for values in (read - shaft, other))
    own = own[:, np.any(own != 0.0, axis=0)]  # set-points that come back exactly differ by nothing
    lost, others = (_beside(own / np.abs(own).max(axis=0), values) for values in (lost, others))
    if not np.any(others != 0.0):
        return 0.0
    slope = float(lost @ others / (others @ others))
    rest, count = lost - slope * others, len(np.union1d(i, j))  # rows, not pairs, are independent
    error = float(np.sqrt(np.mean(rest**2) / np.mean(others**2) / count))
    pays = np.mean(rest**2) < PAYS**2 * np.mean(lost**2)
    return -slope if pays and abs(slope) > CERTAIN * error else 0.0


def _beside(X: Array, y: Array) -> Array:
    """What no combination of the columns gives."""
    return np.asarray(y - X @ np.linalg.lstsq(X, y, rcond=None)[0])
