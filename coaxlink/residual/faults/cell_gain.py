"""A load cell that reads by another gain for a stretch of rows: a loose bridge, a touched amplifier.

No effect of a rotor scales one load and not the rotor's other one, between two rows of a log and back again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import f as f_test

from coaxlink.frames import Array, StandFrame
from coaxlink.residual.faults.row_ranges import Mask, largest_excursion, largest_run, nuisance_terms
from coaxlink.rotor.polynomial import design_matrix

LEAST_ROWS, LEAST_SHARE, MOST_SHARE = 12, 0.04, 0.4  # of the rows: the others say what the gain is
LEAST = 0.05  # of the load, judgement: spans of cells drift by less within a log
SURE = 8.0  # standard errors
ALONE = 3.0  # standard deviations of what is off elsewhere: where all of a log is off no stretch of it lies
LIKE = 0.05  # of full speed: rows at like speeds, before the stretch and after it, must say the same
AGREE, AMONG = 0.35, 0.4  # judgement: of the gain; of the stretch that has such neighbours on either side
OTHER = 0.25  # of the gain, judgement: the rotor's other load has not as much of it
ALIKE = 1e-3  # level of the F test that what is left in the stretch is noise as elsewhere: no bump, no ramp
ROUNDS = 6


@dataclass(frozen=True)
class GainStep:
    """What one cell does in some rows."""

    channel: int
    rows: Mask
    gain: float  # share of the load that it reads more than elsewhere

    @property
    def why(self) -> str:
        """In words."""
        return (
            f"reads {100 * self.gain:+.0f} % here, against what it reads at like speeds before and after,"
            " and the rotor's other load does not"
        )


def gain_steps(frame: StandFrame, usable: Mask) -> list[GainStep]:
    """Stretches in which a cell's gain is another one, at most one a cell."""
    loads = [c for c in frame.present if c < 4]
    found = []
    for c in loads:
        other = c + 1 if c % 2 == 0 else c - 1
        if other not in loads:
            continue
        step = _step(frame, c, usable)
        if step is not None and abs(_gain(frame, other, step.rows, usable)[0]) < OTHER * abs(step.gain):
            found.append(step)
    return found


def _columns(frame: StandFrame, c: int) -> Array:
    """(rows, K) what the load is made of: the given model's, or the nuisance model's own terms."""
    if not frame.free_nuisance:
        return frame.predicted[:, [c]]
    return np.asarray(design_matrix(nuisance_terms(frame.speeds, c), frame.speeds[:, 0], frame.speeds[:, 1]))


def _gain(frame: StandFrame, c: int, inside: Mask, usable: Mask) -> tuple[float, Array, Array]:
    """Gain in some rows, and what the other rows make of the load and of what is off (rows,)."""
    x, y = _columns(frame, c), frame.measured[:, c]
    rest = usable & ~inside
    usual = x @ np.linalg.lstsq(x[rest], y[rest], rcond=1e-8)[0]
    off = y - usual
    mine = usable & inside
    power = float(np.sum(usual[mine] ** 2))
    return (float(np.sum(off[mine] * usual[mine])) / power if power > 0.0 else 0.0), usual, off


def _step(frame: StandFrame, c: int, usable: Mask) -> GainStep | None:
    rows = np.flatnonzero(usable)
    inside = np.zeros(len(usable), bool)
    for number in range(ROUNDS):
        gain, usual, off = _gain(frame, c, inside, usable)
        o, u = off[rows], usual[rows]
        if number == 0:
            first, last = largest_excursion(o * u)
        else:  # the stretch whose squares the gain lowers most
            first, last = largest_run(o**2 - (o - gain * u) ** 2)
        now = np.zeros_like(inside)
        now[rows[first:last]] = True
        count = last - first
        if not max(LEAST_ROWS, LEAST_SHARE * len(rows)) <= count <= MOST_SHARE * len(rows):
            return None
        if np.array_equal(now, inside):
            break
        inside = now
    gain, usual, off = _gain(frame, c, inside, usable)
    left = off - gain * usual
    rest = usable & ~inside
    noise = float(np.mean(off[rest] ** 2))
    squares = gain**2 * usual[inside] ** 2
    if abs(gain) < LEAST or float(np.sum(squares)) < SURE**2 * noise:
        return None
    if float(np.mean(squares)) < ALONE**2 * noise:
        return None
    count = int(inside.sum())
    if f_test.sf(float(np.mean(left[inside] ** 2)) / noise, count, int(rest.sum())) < ALIKE:
        return None
    step = GainStep(c, inside, gain)
    return step if _neighbours_agree(frame, step, usual, rest) else None


def _neighbours_agree(frame: StandFrame, step: GainStep, usual: Array, rest: Mask) -> bool:
    """Whether rows at like speeds, before the stretch as after it, say that the gain is another one."""
    mine = np.flatnonzero(step.rows)
    share = frame.measured[:, step.channel] - usual
    for side in (np.arange(len(rest)) < mine[0], np.arange(len(rest)) > mine[-1]):
        others: NDArray[np.intp] = np.flatnonzero(rest & side)
        if not len(others):
            return False
        far, near = cKDTree(frame.speeds[others]).query(frame.speeds[mine], distance_upper_bound=LIKE)
        has = np.isfinite(far)
        if has.sum() < AMONG * len(mine):
            return False
        rows, beside = mine[has], others[near[has]]
        change = share[rows] - share[beside]
        gain = float(np.sum(change * usual[rows]) / np.sum(usual[rows] ** 2))
        if abs(gain - step.gain) > AGREE * abs(step.gain):
            return False
    return True
