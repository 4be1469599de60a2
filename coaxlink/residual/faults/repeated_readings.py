"""Readings of a flight that repeat: a sensor that is stuck, a stretch that was copied, or coarse steps.

A sensor of fine resolution does not read the same twice; a coarse one does whenever little moves. A coarse
one is called stuck where the rest of the log tells that it should have read something else (a gyro: the
attitude turned; an accelerometer: the velocity changed), and a stretch copied where its sequence is none
that the log's own changes from one reading to the next would bring by chance.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import GRAVITY_NED, IMU_COLUMNS, Array
from coaxlink.residual.faults.states import Mask, runs_of

Windows = tuple[NDArray[np.intp], NDArray[np.intp], int]  # first rows, rows behind the last, length
Finding = tuple[str, Mask, str]  # column, rows, why
ATTITUDE = ("roll", "pitch", "yaw")
UPRIGHT = 0.1  # cosine: nearer to the vertical these angles say nothing
KINDS = {"accel": "m_s2", "gyro": "rad_s"}
STUCK_S, STUCK_TIMES = 0.5, 12  # how long, and how many times longer than the log's own repeats
DEAD = 0.5  # of the log: an axis that reads the same for so long never worked
REPEATED_ROWS = 12
BY_CHANCE = 1e-6  # logs in which a sequence comes again by accident
LAGS = 50  # the most common distances between equal readings are looked at
WINDOW_S = 0.5  # over which the rest of the log tells what a sensor should have read
SIGMAS = 3.0


def stuck(log: Samples) -> list[Finding]:
    """Axes that read exactly the same for long while the vehicle flies, and angles while its gyros turn."""
    found: list[Finding] = []
    flying = flying_rows(log)
    step_s = float(np.nanmedian(np.diff(log["time_s"]))) if log.rows > 2 else 1.0
    for kind, unit in {**KINDS, "": "rad"}.items():
        names = [f"{kind}_{axis}_{unit}" for axis in "xyz"] if kind else [f"{n}_rad" for n in ATTITUDE]
        held = np.stack([held_rows(log[name], flying, step_s) for name in names], axis=1)
        if not held.any():
            continue
        step, coarse = 0.0, [True] * 3  # an angle may stand still with the vehicle
        if kind:
            steps = [log.resolution.get(name, resolution_of(log[name])) for name in names]
            # an axis that never moves has its neighbours' resolution
            step = min([s for s in steps if np.isfinite(s)], default=float("nan"))
            coarse = [
                is_coarse(log[n], s) if np.isfinite(s) else any(is_coarse(log[m], step) for m in names)
                for n, s in zip(names, steps, strict=True)
            ]
        if any(coarse):
            at = windows(log, WINDOW_S)
            proven = _proven(log, held, _due(log, kind, at) - _read(log, kind, names, at), at, step)
            held &= proven | ~np.array(coarse)
        while_ = "the vehicle flies" if kind else "the gyros tell that the vehicle turns"
        why = f"one reading repeats exactly while {while_}"
        found += [(name, held[:, k], why) for k, name in enumerate(names) if held[:, k].any()]
    return found


def copied(log: Samples) -> list[Finding]:
    """Stretches of all six axes that stand in the log before, in the same order."""
    values = np.stack([log[name] for name in IMU_COLUMNS], axis=1)
    finite = np.isfinite(values).all(axis=1)
    fresh = finite & np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    rows = np.flatnonzero(fresh)
    mask = np.zeros(len(values), bool)
    if len(rows) > REPEATED_ROWS:
        _, code = np.unique(values[rows], axis=0, return_inverse=True)
        code = code.ravel()
        surprise = _surprise(code)
        for lag in _lags(code):
            same = code[lag:] == code[:-lag]
            for a, b in ((a + lag, b + lag) for a, b in runs_of(same)):
                information = surprise[a:b].sum() - 2.0 * np.log(
                    len(rows)
                )  # wherever it begins, whatever the lag
                if b - a >= REPEATED_ROWS and information > -np.log(BY_CHANCE):
                    mask[rows[a] : rows[b - 1] + 1] = True
    why = "these readings stand in the log before, digit by digit"
    return [("accel_*, gyro_*", mask, why)] if mask.any() else []


def flying_rows(log: Samples) -> Mask:
    """(rows,) whether the motors' commands change: a vehicle that stands may well read the same twice."""
    names = [n for n in log.columns if n.startswith("motor") and n[5:].isdigit()]
    total = np.sum([np.clip(np.nan_to_num(log[n]), 0.0, 1.0) for n in names], axis=0)
    return np.asarray(total > 0.4 * float(np.median(total)), bool)


def held_rows(values: Array, flying: Mask, step_s: float) -> Mask:
    """(rows,) in runs of one reading, longer than the column's others."""
    same = np.concatenate([[False], (values[1:] == values[:-1]) & np.isfinite(values[1:])])
    first = np.flatnonzero(~same)
    length = np.diff(np.append(first, len(same)))
    usual = float(np.quantile(length, 0.9))
    rows = np.zeros(len(values), bool)
    if length.max() > DEAD * len(values):
        usual = 1.0  # nothing else was ever read
    lasting = (length * step_s > STUCK_S) & (length > STUCK_TIMES * usual)
    for a, n in zip(first[lasting], length[lasting], strict=True):
        if flying[a : a + n].mean() > (0.5 if n > DEAD * len(values) else 0.9):
            rows[a : a + n] = True
    return rows


def _proven(
    log: Samples,
    held: Mask,
    differs: Array,
    at: Windows,
    step: float,
) -> Mask:
    """(rows, 3) runs of `held` in which the other sensors differ (windows, 3) by more than elsewhere.

    Compared are means over WINDOW_S; how far the two usually differ is told by what is not held.
    """
    first, last, size = at
    inside = np.stack([held[first + size // 2, k] for k in range(3)], axis=1)
    flying = flying_rows(log)[first + size // 2]
    proven = np.zeros_like(held)
    for k in range(3):
        free = flying & ~inside[:, k]
        others = differs[:, k][free] if free.sum() >= 8 else differs[flying][~inside[flying]]
        if not len(others) or not inside[:, k].any():
            continue
        usual = 1.4826 * float(np.median(np.abs(others - np.median(others))))
        limit = SIGMAS * max(usual, step)
        for a, b in runs_of(held[:, k]):
            here = (first >= a) & (last <= b)
            if here.any() and float(np.sqrt(np.mean(differs[here, k] ** 2))) > limit:
                proven[a:b, k] = True
    return proven


def windows(log: Samples, window_s: float) -> Windows:
    """First rows and rows behind the last of windows without a gap, and their length in rows."""
    time = log["time_s"]
    step_s = float(np.nanmedian(np.diff(time))) if log.rows > 2 else 0.0
    if not step_s > 0.0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp), 1
    size = max(round(window_s / step_s), 1)
    first = np.arange(0, log.rows - size, size)
    last = first + size
    gapless = np.isclose(time[last] - time[first], size * step_s, rtol=0.2)
    return first[gapless], last[gapless], size


def _read(log: Samples, kind: str, names: list[str], at: Windows) -> Array:
    """(windows, 3) what the axes read on average, or by how much the angles changed in a second."""
    first, _, size = at
    if not kind:
        return _turned(log, at)[0]
    rows = first[:, None] + np.arange(size)
    return np.stack([log[n][rows].mean(axis=1) for n in names], axis=1)


def _turned(log: Samples, at: Windows) -> tuple[Array, Array]:
    """(windows, 3) by how much roll, pitch and yaw changed in a second, and what they were amid."""
    first, last, _ = at
    angles = np.unwrap(np.stack([log[f"{n}_rad"] for n in ATTITUDE], axis=1), axis=0)
    time = (log["time_s"][last] - log["time_s"][first])[:, None]
    return (angles[last] - angles[first]) / time, angles[(first + last) // 2]


def _due(log: Samples, kind: str, at: Windows) -> Array:
    """(windows, 3) what the rest of the log says: body rates, specific force, or what the angles turn."""
    first, last, _ = at
    turned, angles = _turned(log, at)
    roll, pitch, yaw = angles.T
    sr, cr, sp, cp, sy, cy = (f(x) for x in (roll, pitch, yaw) for f in (np.sin, np.cos))
    if kind == "gyro":
        dr, dp, dy = turned.T
        return np.stack([dr - dy * sp, dp * cr + dy * sr * cp, -dp * sr + dy * cr * cp], axis=1)
    if not kind:
        x, y, z = _read(log, "gyro", [f"gyro_{axis}_rad_s" for axis in "xyz"], at).T
        about, upright = y * sr + z * cr, np.maximum(cp, UPRIGHT)  # the vertical's part, before its tilt
        return np.stack([x + about * sp / upright, y * cr - z * sr, about / upright], axis=1)
    velocity = np.stack([log[f"vel_{a}_m_s"] for a in "ned"], axis=1)
    time = (log["time_s"][last] - log["time_s"][first])[:, None]
    n, e, d = ((velocity[last] - velocity[first]) / time - GRAVITY_NED).T
    along = n * cy + e * sy
    across = e * cy - n * sy
    down = along * sp + d * cp
    return np.stack([along * cp - d * sp, across * cr + down * sr, down * cr - across * sr], axis=1)


def _lags(code: NDArray[np.intp]) -> list[int]:
    """Distances at which readings come again so often that a copy may be behind it."""
    order = np.argsort(code, kind="stable")
    again = code[order][1:] == code[order][:-1]
    found = Counter((order[1:] - order[:-1])[again].tolist())
    return [lag for lag, count in found.most_common(LAGS) if count >= REPEATED_ROWS // 2]


def _surprise(code: NDArray[np.intp]) -> Array:
    """(rows,) -log of the chance of a reading after the one before it, by the rest of the log.

    Neither the row itself nor the one that it may be a copy of counts.
    """
    count = np.maximum(np.bincount(code) - 2, 0) + 1.0
    before, now = code[:-1], code[1:]
    _, kind, moves = np.unique(before * len(count) + now, return_inverse=True, return_counts=True)
    out = np.zeros(len(code))
    out[1:] = np.log(count[before]) - np.log(np.maximum(moves[kind] - 2, 0) + count[now] / len(code))
    return out
