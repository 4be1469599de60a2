"""Throttle columns that are mislabelled: the speed of a rotor follows the other rotor's throttle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coaxlink.frames import Array, StandFrame
from coaxlink.residual.faults.row_ranges import (
    CAP,
    LEAST_PLACES,
    WHOLE,
    Mask,
    parts_of,
    places,
    robust_fit,
    stretches,
)

TOLERANCE = 0.03  # of the speeds' range: what a curve of the throttle may err by
CLOSER = 0.2  # of the capped squares under the labels as they stand
LEAST_ROWS = 12
LEAST_RANGE = 0.1  # of throttle


@dataclass(frozen=True)
class Crossed:
    """Rows in which both speeds follow the other's throttle."""

    rows: Mask

    @property
    def of_all_rows(self) -> bool:
        """Whether it concerns every row of the log."""
        return float(np.mean(self.rows)) > WHOLE

    why = "each rotor's measured speed follows the other's throttle: the commands are swapped"


def crossed_throttles(frame: StandFrame, usable: Mask) -> Crossed | None:
    """Rows in which the throttles are exchanged, or None; wants speeds and throttles of both rotors."""
    if frame.driven or frame.throttles is None or usable.sum() < 24:
        return None
    if min(*np.ptp(frame.throttles[usable], axis=0), *np.ptp(frame.speeds[usable], axis=0)) < LEAST_RANGE:
        return None
    if np.mean(np.abs(np.diff(frame.throttles[usable], axis=1)) > 0.02) < 0.1:
        return None  # both are told the same
    if _whole(frame, usable):
        return Crossed(usable.copy())
    best: tuple[float, Mask | None] = (np.inf, None)
    for number, part in enumerate(parts_of(len(usable))):
        trusted, rows = part & usable, None
        if trusted.sum() < 24:
            continue
        for _ in range(4):
            own, other = _costs(frame, trusted)
            rows = _stretch(frame, own, other, usable)
            now = usable & ~rows
            if now.sum() < 24 or np.array_equal(now, trusted):
                break
            trusted = now
        assert rows is not None
        total = float(own[usable & ~rows].sum() + other[rows].sum() + rows.sum())
        if total < best[0] and rows.sum() < 0.55 * usable.sum():
            best = total, rows
        if number == 0 and not rows.any() and np.mean(own[usable] > 9.0) < 0.01:
            break
    return Crossed(best[1]) if best[1] is not None and best[1].any() else None


def _curve(throttle: Array) -> Array:
    return np.stack([throttle**k for k in range(4)], axis=1)


def _costs(frame: StandFrame, trusted: Mask) -> tuple[Array, Array]:
    """(rows,) capped squares of both speeds' misses by the own and by the other's throttle."""
    assert frame.throttles is not None
    out = np.zeros((2, len(trusted)))
    for side in (0, 1):
        speed = frame.speeds[:, side]
        fit = robust_fit(_curve(frame.throttles[:, side]), speed, trusted)
        tolerance = TOLERANCE * float(np.ptp(speed))
        for k in (0, 1):
            miss = speed - _curve(frame.throttles[:, (side + k) % 2]) @ fit
            out[k] += np.minimum((miss / tolerance) ** 2, CAP)
    return out[0], out[1]


def _stretch(frame: StandFrame, own: Array, other: Array, usable: Mask) -> Mask:
    assert frame.throttles is not None
    rows = np.flatnonzero(usable)
    out = np.zeros(len(usable), bool)
    for piece in stretches((own - other)[rows]):
        mine = rows[piece]
        telling = np.abs(own[mine] - other[mine]) > 1.0
        enough = telling.sum() >= max(LEAST_ROWS, 0.02 * len(rows))
        enough = enough and places(frame.throttles[mine][telling]) >= LEAST_PLACES
        if enough and other[mine][telling].sum() < CLOSER * own[mine][telling].sum():
            out[mine] = True
    return out


def _whole(frame: StandFrame, usable: Mask) -> bool:
    """Whether both speeds follow the other's throttle throughout, and not their own."""
    assert frame.throttles is not None
    for side in (0, 1):
        speed = frame.speeds[usable, side]
        left = []
        for k in (side, 1 - side):
            x = _curve(frame.throttles[usable, k])
            left.append(float(np.median(np.abs(speed - x @ robust_fit(x, speed, np.ones(len(x), bool))))))
        if left[1] > CLOSER * left[0] or left[0] < TOLERANCE * float(np.ptp(speed)):
            return False
    return True
