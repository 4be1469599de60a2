"""What the columns of a flight tell of one another, whatever the rotors do.

Over a window without a gap, seven things that are one by kinematics (Titterton and Weston, Strapdown Inertial
Navigation Technology, 2004, ch. 3): velocity's gain and the turned specific force with gravity, the angles'
change and the turned body rates, height's change and the vertical velocity. Yardstick of a flight's chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.data.logs.streams import ANGLES
from coaxlink.frames import GRAVITY_NED, Array
from coaxlink.instruments.chain import HEAVY, SURE
from coaxlink.instruments.findings import Mask
from coaxlink.instruments.flight.flown_log import FlownLog

ACCEL = tuple(f"accel_{a}_m_s2" for a in "xyz")
GYRO = tuple(f"gyro_{a}_rad_s" for a in "xyz")
VELOCITY = tuple(f"vel_{a}_m_s" for a in "ned")
HEIGHT = "height_m"
COLUMNS = (*ACCEL, *GYRO, *VELOCITY, *ANGLES, HEIGHT)
# priors: name = value  # unit, source
WINDOW_S, MOST_WINDOWS, BLOCK = 1.0, 2000, 256  # longer than an estimator's delay; effort
LEAST_WINDOWS = 16  # judgement: as many as there are numbers in a fit
# m/s^2, rad/s, m/s: what sound estimators differ by over a window (a velocity 0.1 m/s, angles 0.01 rad)
FINEST = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01, 0.1])
COARSE = 0.1  # of that: mg and mrad/s, as autopilots send them
# of a sensor's reading: an accelerometer that was never calibrated has 3 % of scale and 2 % for its zero
# (MPU-6000); uneven ground and a slow barometer change a height by more, no unit but the metre by so little
SHARE = dict.fromkeys((*ACCEL, *GYRO, *VELOCITY, *ANGLES), (0.95, 1.05)) | {HEIGHT: (0.1, 2.0)}
UPRIGHT = 0.1  # cosine: nearer to the vertical these angles say nothing
REWEIGHTINGS = 4  # effort


@dataclass(frozen=True)
class Kinematics:
    """Windows of a log in flight, and what its columns read."""

    columns: Mapping[str, Array]  # (rows,) each
    time: Array  # (rows,)
    first: NDArray[np.intp]  # (windows,)
    size: int  # rows from one end to the other

    def misses(self, **other: Array) -> Array:
        """(windows, 7) what is read less what the others make of it, with some columns (rows,) other ones."""
        changes = self.changes(**other)
        force, rates, *_ = self.turned(**other)
        return np.concatenate(
            [
                changes[:, :3] - GRAVITY_NED - np.trace(force, axis1=2, axis2=3),
                changes[:, 3:6] - np.trace(rates, axis1=2, axis2=3),
                changes[:, 6:],
            ],
            axis=1,
        )

    def changes(self, **other: Array) -> Array:
        """(windows, 7) of velocity, angles, and of height beyond the vertical velocity's, per second."""
        first, last = self.first, self.first + self.size
        lasted = (self.time[last] - self.time[first])[:, None]
        log = {**self.columns, **other}
        angles = [np.unwrap(log[name]) for name in ANGLES]
        ends = np.stack([x[last] - x[first] for x in (*(log[n] for n in VELOCITY), *angles)], axis=1)
        climbed = np.zeros((len(first), 1))
        if HEIGHT in log:
            climbed = (log[HEIGHT][last] - log[HEIGHT][first])[:, None] / lasted + self.path(**other)[:, None]
        return np.concatenate([ends / lasted, climbed], axis=1)

    def turned(self, **other: Array) -> tuple[Array, Array, Array, Array]:
        """Forces in NED and rates of angles, (windows, 3, 3, 3): of axis j's direction and axis k's reading.

        And (windows, 3, 3) the directions.
        """
        log = {**self.columns, **other}
        blocks = [self.first[k : k + BLOCK] for k in range(0, len(self.first), BLOCK)]
        parts = zip(*(self._turned(log, first) for first in blocks), strict=True)
        force, rates, body, euler = (np.concatenate(part) for part in parts)
        return force, rates, body, euler

    def _turned(self, log: Mapping[str, Array], first: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        rows = first[:, None] + np.arange(self.size + 1)
        force, rates = (np.stack([log[n][rows] for n in names], axis=2) for names in (ACCEL, GYRO))
        roll, pitch, yaw = (log[n][rows] for n in ANGLES)
        sr, cr, sp, cp, sy, cy = (f(x) for x in (roll, pitch, yaw) for f in (np.sin, np.cos))
        zero, one, up = 0.0 * roll, 1.0 + 0.0 * roll, np.where(np.abs(cp) < UPRIGHT, UPRIGHT, cp)
        body = np.stack(
            [
                *(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
                *(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
                *(-sp, cp * sr, cp * cr),
            ],
            axis=2,
        )
        euler = np.stack([one, sr * sp / up, cr * sp / up, zero, cr, -sr, zero, sr / up, cr / up], axis=2)
        weight = np.full(self.size + 1, 1.0 / self.size)  # by trapezoids
        weight[[0, -1]] /= 2.0
        shape = (len(first), 3, 3)
        return (
            np.einsum("r,wrj,wrk->wjk", weight, body, force, optimize=True).reshape(*shape, 3),
            np.einsum("r,wrj,wrk->wjk", weight, euler, rates, optimize=True).reshape(*shape, 3),
            np.einsum("r,wrj->wj", weight, body).reshape(shape),
            np.einsum("r,wrj->wj", weight, euler).reshape(shape),
        )

    def along(self, name: str, misses: Array) -> tuple[Array, int]:
        """(windows,) what of misses (windows, 7) goes along with a column, and whose noise it has."""
        for names, at, axes in ((ACCEL, 0, 2), (GYRO, 3, 3)):
            if name in names:
                axis = self.turned()[axes][:, :, names.index(name)]
                return np.sum(misses[:, at : at + 3] * axis, axis=1) / np.sum(axis**2, axis=1), at
        channel = (*VELOCITY, *ANGLES, HEIGHT).index(name)
        return misses[:, channel], channel

    def zero(self, name: str, by: float) -> Array:
        """(windows, 7) what misses lack where a reading of the IMU is so much too large."""
        at, axes, names = (0, 2, ACCEL) if name in ACCEL else (3, 3, GYRO)
        out = np.zeros((len(self.first), 7))
        out[:, at : at + 3] = by * self.turned()[axes][:, :, names.index(name)]
        return out

    def path(self, **other: Array) -> Array:
        """(windows,) the mean of the vertical velocity, by trapezoids."""
        read = {**self.columns, **other}[VELOCITY[2]]
        total = np.concatenate([[0.0], np.cumsum(0.5 * (read[1:] + read[:-1]))])
        return np.asarray((total[self.first + self.size] - total[self.first]) / self.size)

    def within(self, rows: Mask) -> Mask:
        """(windows,) that lie in a mask (rows,) wholly."""
        count = np.concatenate([[0], np.cumsum(rows)])
        return np.asarray(count[self.first + self.size + 1] - count[self.first] == self.size + 1)

    def touches(self, rows: Mask) -> Mask:
        """(windows,) that lie in a mask (rows,) with a part."""
        return ~self.within(~rows)


def kinematics_of(log: FlownLog) -> Kinematics:
    """The windows of a log in which it flies, has no gap, and all that is read is finite."""
    columns = {name: log[name] for name in COLUMNS if log.has(name)}
    finite = np.all([np.isfinite(x) for x in columns.values()], axis=0)
    columns = {name: np.where(finite, x, 0.0) for name, x in columns.items()}
    time, step_s = log["time_s"], log.step_s
    size = max(round(WINDOW_S / step_s), 1) if step_s > 0.0 else max(log.rows, 1)
    first = np.arange(0, log.rows - size, size)
    usable = log.flying & finite
    draft = Kinematics(columns, time, first, size)
    gapless = np.isclose(time[first + size] - time[first], size * step_s, rtol=0.2)
    first = first[draft.within(usable) & gapless]
    return Kinematics(columns, time, first[:: -(-len(first) // MOST_WINDOWS) or 1], size)


@dataclass(frozen=True)
class Linear:
    """What zeros and scales of the columns do to the misses of a log."""

    zeros: Array  # (windows, 7, K) of a unit each
    scales: dict[str, Array]  # (windows, 7) of a reading twice as large
    angles: dict[str, Array]  # (windows, 7) likewise of an angle, but for what it turns
    exchanges: dict[str, Array]  # (windows, 7) of two columns in one another's place
    usable: Mask  # (windows,) that fits go by

    def left(self, misses: Array, sigma: Array) -> Array:
        """(windows, 7) what is left of misses with zeros and scales at their best, within what is sound."""
        bounds = [(1.0 / high - 1.0, 1.0 / low - 1.0) for low, high in (SHARE[n] for n in self.scales)]
        x = np.concatenate([self.zeros, *(s[:, :, None] for s in self.scales.values())], axis=2)
        low, high = np.array([(-np.inf, np.inf)] * self.zeros.shape[2] + bounds).T
        return misses + x @ _robust(misses, x, sigma, self.usable, low, high)

    def scale(self, name: str, misses: Array, sigma: Array, at: Mask) -> float:
        """What a column is to be multiplied by in some windows, nearest to one of what they allow.

        Regressed on what the others tell it comes out too small for the noise of the column; the other way
        round too large: it lies between the two (Frisch bounds; Soderstrom, Automatica 43 (2007), 3.1).
        """
        every, mine = np.full(self.zeros.shape[2], np.inf), {**self.scales, **self.angles}[name]
        mine, determined = (
            ((x + self.zeros @ _robust(x, self.zeros, sigma, at, -every, every)) / sigma)[at]
            for x in (mine, (mine - misses) * np.any(mine != 0.0, axis=0))
        )
        both, squares = (
            float(np.sum(mine * determined)),
            (float(np.sum(mine**2)), float(np.sum(determined**2))),
        )
        alike = both**2 / max(squares[0] * squares[1], 1e-300)
        # a column that does not go along with the others shows no scale
        if -0.5 * at.sum() * np.log(max(1.0 - alike, 1e-300)) < SURE:
            return 1.0
        ends = both / squares[0], squares[1] / both
        return float(np.clip(1.0, min(ends), max(ends)))


def linear_of(log: Kinematics, usable: Mask) -> Linear:
    """Of the columns that a log has."""
    force, rates, body, euler = log.turned()
    changes, empty = log.changes(), np.zeros((len(log.first), 7))

    def filled(columns: slice | int, values: Array | float) -> Array:
        out = empty.copy()
        out[:, columns] = values
        return out

    zeros = [filled(slice(0, 3), -body[:, :, k]) for k in (0, 1)]
    zeros += [filled(slice(3, 6), -euler[:, :, k]) for k in range(3)] + [filled(6, 1.0)]
    scales = {name: filled(slice(0, 3), -force[:, :, k, k]) for k, name in enumerate(ACCEL)}
    scales |= {name: filled(slice(3, 6), -rates[:, :, k, k]) for k, name in enumerate(GYRO)}
    scales |= {name: filled(k, changes[:, k]) for k, name in enumerate(VELOCITY)}
    if HEIGHT in log.columns:
        path = log.path()
        scales[VELOCITY[2]][:, 6] = path
        scales[HEIGHT] = filled(6, changes[:, 6] - path)
    angles = {name: filled(3 + k, changes[:, 3 + k]) for k, name in enumerate(ANGLES)}
    exchanges = {}
    for j, k in ((0, 1), (0, 2), (1, 2)):
        there = changes[:, k] - changes[:, j]
        exchanges[f"{VELOCITY[j]}, {VELOCITY[k]}"] = filled(j, there) + filled(k, -there)
        for names, parts, at in ((ACCEL, force, slice(0, 3)), (GYRO, rates, slice(3, 6))):
            turned = parts[:, :, j, j] + parts[:, :, k, k] - parts[:, :, j, k] - parts[:, :, k, j]
            exchanges[f"{names[j]}, {names[k]}"] = filled(at, turned)
    return Linear(np.stack(zeros, axis=2), scales, angles, exchanges, usable)


def noise_of(misses: Array) -> Array:
    """(7,) what misses (windows, 7) scatter by, outliers aside; at least what sound ones do.

    About their median, or from one window to the next where that is less: a column that is off from the
    middle of a flight on has two medians.
    """
    about = np.median(np.abs(misses - np.median(misses, axis=0)), axis=0)
    if len(misses) > 1:
        about = np.minimum(about, np.median(np.abs(np.diff(misses, axis=0)), axis=0) / np.sqrt(2.0))
    return np.asarray(np.maximum(SIGMA_PER_MAD * about, FINEST))


def independent(misses: Array) -> Array:
    """(7,) how many independent windows one counts as, by what one tells of the next."""
    x = np.clip(misses - np.median(misses, axis=0), -3.0, 3.0)
    memory = np.sum(x[1:] * x[:-1], axis=0) / np.maximum(np.sum(x**2, axis=0), 1e-12)
    return np.asarray((1.0 - np.clip(memory, 0.0, 0.99)) / (1.0 + np.clip(memory, 0.0, 0.99)))


def _robust(y: Array, x: Array, sigma: Array, at: Mask, low: Array, high: Array) -> Array:
    """(K,) by which columns x (windows, 7, K), within bounds, take most from -y; outliers as Student's t."""
    x, y = (x[at] / sigma[:, None]).reshape(-1, x.shape[2]), (-y[at] / sigma).ravel()
    size = np.sqrt(np.sum(x**2, axis=0)) + 1e-12
    x = x / size
    fit: Array = np.zeros(len(size))
    for _ in range(REWEIGHTINGS):
        weight = (HEAVY + 1.0) / (HEAVY + (y - x @ fit) ** 2)
        weighed = x * weight[:, None]
        gram, target = weighed.T @ x + 1e-9 * np.eye(len(size)), weighed.T @ y
        fit = np.asarray(np.linalg.solve(gram, target))
        if np.any((fit < low * size) | (fit > high * size)):
            factor = np.linalg.cholesky(gram)
            bounds = (low * size, high * size)
            fit = lsq_linear(factor.T, np.linalg.solve(factor, target), bounds, method="bvls").x
    return np.asarray(fit / size)
