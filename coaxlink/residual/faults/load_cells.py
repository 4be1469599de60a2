"""Load cells that stand still, repeat themselves, run into a limit, or show what no rotor could give."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data.resolution import is_coarse, resolution_of
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.load import Load
from coaxlink.residual.channels.stand import COLUMN_OF, dictionary_of, fitted_model
from coaxlink.residual.faults.row_ranges import Mask, robust_fit
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.polynomial import design_matrix

STUCK_ROWS = 4
REPEATED_ROWS, BY_CHANCE = 3, 1e-3  # a run of them; logs that have one as long by accident
CLIPPED_ROWS = 6
MARGIN = 0.02  # of the reference load: this near a limit the noise is cut off on one side
# a load that is gone for some rows (judgement: no effect of physics takes so much): the share of it that is
# left, where it is a fair share of the reference; what the nearest rows at like speeds (of full speed) read
GONE, LOADED, THERE, LIKE, PLACES = 0.05, 0.25, 0.5, 0.05, 2
BESIDE = 2  # rows before and after a plug came off: a filter may smear one of them
TURNS = 0.2  # of full speed, judgement: a rotor near rest has no load to lose, whatever wake it stands in
LEAST_GONE, MOST_GONE = 3, 0.4  # rows; share of the log
ARM = (0.002, 0.5)  # m: torque over thrust of any rotor between a hand's width and 4 m
USUAL_ARM = 0.03


def stuck_rows(frame: StandFrame, channel: int) -> Mask:
    """(rows,) where one reading repeats exactly although it should not."""
    values = frame.measured[:, channel]
    same = np.concatenate([[False], np.diff(values) == 0.0])
    start = np.flatnonzero(~same)
    out = np.zeros(len(values), bool)
    need = max(STUCK_ROWS, len(values) // 100)
    # a cell that else never shows one reading twice is stuck even where the load should stand still
    noisy = float(np.mean(same)) < 0.2 and len(values) > 50
    long = max(3 * STUCK_ROWS, len(values) // 50)
    for first, end in zip(start, np.append(start[1:], len(values)), strict=True):
        expected = np.ptp(frame.predicted[first:end, channel])
        level = np.max(np.abs(frame.predicted[first:end, channel]))
        still = noisy and end - first >= long and level > 0.05 * frame.reference[channel]
        moved = end - first >= need and expected > 0.02 * frame.reference[channel]
        if values[first] != 0.0 and (moved or still):
            out[first:end] = True
    return out


def dropped_rows(frame: StandFrame, channel: int, usable: Mask) -> Mask:
    """(rows,) where a cell reads next to nothing, and at the same speeds the load in other rows.

    Not where the other cells of the rotor read nothing either: it may rest.
    """
    none = np.zeros(len(usable), bool)
    usable = usable & np.isfinite(frame.speeds).all(axis=1) & np.isfinite(frame.measured[:, channel])
    if not usable.any():
        return none
    load = _expected(frame, channel, usable)
    size = float(frame.reference[channel])
    measured = frame.measured[:, channel]
    gone = usable & (np.abs(load) > LOADED * size) & (np.abs(measured) < GONE * np.abs(load))
    gone &= frame.speeds[:, channel // 2] > TURNS
    other = channel + 1 if channel % 2 == 0 else channel - 1
    if other in frame.present:
        gone &= np.abs(frame.measured[:, other]) > THERE * np.abs(_expected(frame, other, usable))
    elif frame.driven:
        return none
    if not LEAST_GONE <= gone.sum() <= MOST_GONE * len(gone):
        return none
    # at the same speeds it reads the load at other times: else the rotor has none there, whatever a fit says
    rows, others = np.flatnonzero(gone), np.flatnonzero(usable & ~gone)
    far, near = cKDTree(frame.speeds[others]).query(frame.speeds[rows], k=PLACES, distance_upper_bound=LIKE)
    share = np.append(measured[others] / load[others], np.nan)  # the tree's number for none
    found = np.isfinite(far).all(axis=1)
    none[rows[found]] = np.min(share[near[found]], axis=1, initial=np.inf) > THERE
    loaded = usable & (np.abs(load) > LOADED * size)
    none &= ~_gradual(gone, np.where(loaded, measured / np.where(loaded, load, 1.0), np.nan))
    return none if none.sum() >= LEAST_GONE else np.zeros(len(usable), bool)


def _gradual(gone: Mask, share: Array) -> Mask:
    """(rows,) of runs of `gone` rows beside which less than the load is read: it goes through zero by itself.

    `share` (rows,) of the load that is read; NaN where there is none.
    """
    out = np.zeros(len(gone), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], gone, [False]])))
    for first, end in edges.reshape(-1, 2):
        for beside in (share[max(first - BESIDE, 0) : first], share[end : end + BESIDE]):
            known = beside[np.isfinite(beside)]
            out[first:end] |= bool(len(known)) and float(np.max(known)) < THERE
    return out


def _expected(frame: StandFrame, channel: int, usable: Mask) -> Array:
    """(rows,) what the model gives at these speeds, or without one what most rows agree on."""
    if not frame.free_nuisance:
        return np.asarray(frame.loads_at(frame.speeds)[:, channel])
    x = design_matrix(dictionary_of(LOADS[channel], 2), frame.speeds[:, 0], frame.speeds[:, 1])
    return np.asarray(x @ robust_fit(x, frame.measured[:, channel], usable))


def repeated_rows(frame: StandFrame) -> Mask:
    """(rows,) whose loads, coarse ones aside, stand in the log before, all of them digit by digit."""
    measured = frame.measured
    # a coarse cell reads the same whenever the rotors turn alike
    fine = [
        c for c in frame.present if c < 4 and not is_coarse(measured[:, c], resolution_of(measured[:, c]))
    ]
    values, out = measured[:, fine], np.zeros(len(measured), bool)
    if len(fine) < 2:
        return out
    _, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    turning = np.any(np.abs(values) > 1e-9, axis=1)
    twin = (first[inverse.ravel()] != np.arange(len(values))) & turning
    rows = np.flatnonzero(twin)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        by_chance = (len(rows) - len(run)) / max(len(twin) - len(run), 1)  # that a row has a twin
        if len(run) >= REPEATED_ROWS and len(twin) * by_chance ** len(run) < BY_CHANCE:
            out[run] = True
    return out


def clipped_rows(frame: StandFrame, channel: int) -> tuple[Mask, float] | None:
    """(rows,) at a limit or so near it that it cuts the noise, and the limit; None for a cell without one."""
    values = frame.measured[:, channel]
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < 10:
        return None
    for limit, count, sign in ((levels[-1], counts[-1], 1.0), (levels[0], counts[0], -1.0)):
        usual = float(np.quantile(counts, 0.95))
        if limit == 0.0 or count < max(CLIPPED_ROWS, len(values) // 100, 5.0 * usual):
            continue
        at = values == limit
        loads = frame.loads_at(frame.speeds)[:, channel]
        if frame.free_nuisance:
            own = fitted_model(frame.speeds[~at], frame.measured[~at], [channel], frame.model.speed_max_rpm)
            pair = own.loads(frame.speeds[:, 0], frame.speeds[:, 1])
            loads = pair[Load(channel)]
        size = float(frame.reference[channel])
        beyond = sign * (loads - limit)
        if np.ptp(loads[at]) > 0.05 * size and np.mean(beyond[at] > -MARGIN * size) > 0.8:
            return at | (beyond > -MARGIN * size), float(limit)
    return None


def odd_arms(frame: StandFrame, usable: Mask) -> list[tuple[tuple[int, ...], str]]:
    """Load channels of rotors whose torque over thrust no rotor has, with what they may be instead."""
    arms: dict[int, float] = {}
    for side in (0, 1):
        if {2 * side, 2 * side + 1} <= set(frame.present):
            thrust, torque = np.quantile(
                np.abs(frame.measured[usable][:, 2 * side : 2 * side + 2]), 0.95, axis=0
            )
            if min(thrust, torque) > 0.0:
                arms[side] = float(torque / thrust)
    sound = [arm for arm in arms.values() if ARM[0] < arm < ARM[1]]
    usual = sound[0] if sound else USUAL_ARM
    out: list[tuple[tuple[int, ...], str]] = []
    for side, arm in arms.items():
        if ARM[0] < arm < ARM[1]:
            continue
        t, q = 2 * side, 2 * side + 1
        guesses: dict[str, tuple[float, tuple[int, ...]]] = {
            "torque and thrust exchanged?": (1.0 / arm, (t, q)),
            "torque in N cm?": (arm / 100.0, (q,)),
            "torque in N mm?": (arm / 1000.0, (q,)),
            "thrust in gf?": (arm * 1000.0 / GRAVITY_M_S2, (t,)),
        }
        guess = min(guesses, key=lambda name: abs(np.log(guesses[name][0] / usual)))
        channels = guesses[guess][1]
        out.append((channels, f"torque over thrust is {arm:.3g} m, which no rotor has: {guess}"))
    return out


def names_of(channels: tuple[int, ...]) -> str:
    """Columns of load channels."""
    return ", ".join(COLUMN_OF[STAND_CHANNELS[c]] for c in channels)
