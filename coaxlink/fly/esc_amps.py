"""Amps of every ESC in the split's hover, held against the battery monitor's: two sensors of one current.

ESC n is taken for motor n. A sum that is another share of the battery's amps is a sensor scaled wrong (or
what the avionics draw), which changes watts, not the share of least power; the share by the ESCs alone tells
whether more than a scale is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.fly.split_answer import LEVEL, Interval, SplitAnswer, best_split, dwells_of

REPEATED = 4  # ESCs a message: PX4 of the v1.14 era sends the first four in the second one too
HEARD = 0.9  # of the battery's readings that must have every ESC's beside them
STALE_S = 1.0
LEAST_DWELLS = 5
RESTS = "; the answer rests on the battery monitor"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EscAmps:
    """What the ESCs say beside the battery monitor."""

    ratio: float  # sum of the ESCs' amps over the battery's
    ratio_ci: Interval
    share: tuple[float, ...]  # of the upper rotors, a dwell each, as are the next two
    upper_A: tuple[float, ...]
    lower_A: tuple[float, ...]
    answer: SplitAnswer | None  # by the ESCs' amps alone; None where the hover does not tell

    @property
    def agree(self) -> bool:
        """Whether the two may be of one current."""
        return self.ratio_ci[0] <= 1.0 <= self.ratio_ci[1]

    def words(self) -> list[str]:
        """A line of the sum, and one of what it means for the share where a share was sought."""
        low, high = self.ratio_ci
        line = f"the ESCs' amps sum to {self.ratio:.3f} ({low:.3f} to {high:.3f}) of the battery monitor's: "
        if self.agree:
            line += "they agree"
        elif self.ratio < 1.0:
            line += "the rest is the avionics' current, or a sensor's scale or zero" + RESTS
        else:
            line += "more than the pack gives, so one sensor's scale or zero is wrong" + RESTS
        if self.answer is None:
            return [line]
        ends = (int(np.argmin(self.share)), int(np.argmax(self.share)))
        sides = ", ".join(
            f"{self.upper_A[n]:.1f} A above and {self.lower_A[n]:.1f} A below with {self.share[n]:.3f}"
            for n in ends
        )
        return [line, f"by the ESCs alone: {self.answer.words()}; {sides} (ESC n taken for motor n)"]

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        mine = {k: v for k, v in asdict(self).items() if k != "answer"}
        return {**mine, "agree": self.agree, "by_escs": self.answer and self.answer.as_json()}


def esc_amps(rows: Array, amps: Array, upper: Sequence[bool], settle_s: float, on_board: float) -> EscAmps:
    """Of the hover's `rows` (dwell, s, W, share, then what else moves the watts).

    `amps` (rows, 1 + N): the battery's, then those of the ESCs by motor, NaN where one is missing; `upper`
    (N,). Raises InputError where an ESC's amps are not there, or too little was flown.
    """
    _refuse_missing(amps[:, 1:])
    there = np.isfinite(amps).all(axis=1) & (amps[:, 0] > 0.0)
    rows, amps = rows[there], amps[there]
    number, t, watts, share = rows[:, :4].T
    columns = {f"esc{k}": column for k, column in enumerate(amps[:, 1:].T)}
    of = dwells_of(number, t, amps[:, 0], share, settle_s, columns)
    if len(of.watts) < LEAST_DWELLS:
        raise InputError("the ESCs", "dwells", f"{len(of.watts)} with amps, {LEAST_DWELLS} are needed")
    ratio, reach = _mean(of.columns.sum(axis=1) / of.watts)
    above = np.array(upper, bool)
    others = {f"other{k}": column for k, column in enumerate(rows[:, 4:].T)}
    by_escs = dwells_of(
        number, t, watts * amps[:, 1:].sum(axis=1) / amps[:, 0], share, settle_s, others
    )  # watts at the battery's own volts
    answer = None
    with suppress(InputError):  # one share, or too few dwells
        answer = best_split(by_escs, on_board)
    return EscAmps(
        ratio,
        (ratio - reach, ratio + reach),
        tuple(of.share.tolist()),
        tuple(of.columns[:, above].sum(axis=1).tolist()),
        tuple(of.columns[:, ~above].sum(axis=1).tolist()),
        answer,
    )


def _refuse_missing(escs: Array) -> None:
    """Raises InputError unless every ESC says amps that move."""
    heard = np.isfinite(escs)
    if not heard.any():
        raise InputError("the ESCs", "current", "none of them says any")
    for k in range(escs.shape[1]):
        given = escs[heard[:, k], k]
        if len(given) < HEARD * len(escs):
            raise InputError("the ESCs", "current", f"ESC {k + 1} says none")
        if np.ptp(given) == 0.0:
            what = f"{given[0]:g} A all the time: none that it measures"
            raise InputError("the ESCs", "current", f"ESC {k + 1} says {what}")
    again = escs[:, REPEATED : 2 * REPEATED]
    usual = escs[:, : again.shape[1]]
    if again.shape[1] and np.array_equal(again, usual, equal_nan=True):
        problem = f"ESC_STATUS repeats those of ESCs 1 to {REPEATED} for the next"
        raise InputError("the ESCs", "current", problem)


def _mean(values: Array) -> tuple[float, float]:
    """Mean of dwells whose neighbours may be alike, and half its 95 % interval."""
    from scipy.stats import t

    off = values - values.mean()
    square = float(off @ off)
    like = max(float(off[1:] @ off[:-1]) / square, 0.0) if square > 0.0 else 0.0
    count = len(values)
    spread = math.sqrt(square / (count - 1) / count * (1.0 + like) / (1.0 - like))
    return float(values.mean()), float(t.ppf(0.5 + 0.5 * LEVEL, count - 1)) * spread
