"""What is reported of a column that cannot be what it says, and in which rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array

Mask = NDArray[np.bool_]
Finding = tuple[str, Mask, str]  # column, rows, why


@dataclass(frozen=True)
class Suspect:
    """A column that cannot be what it says."""

    column: str
    rows: str
    why: str

    def line(self) -> str:
        """In one line."""
        return f"suspect: {self.column}, rows {self.rows}: {self.why}"


def runs_of(mask: Mask) -> list[tuple[int, int]]:
    """First rows, and rows behind the last, of the runs of a mask.

    >>> runs_of(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def rows_text(mask: Array | Mask) -> str:
    """Row ranges of a mask, counted from 1: "12-30, 44"."""
    runs = runs_of(np.asarray(mask, bool))
    shown = [f"{a + 1}-{b}" if b - a > 1 else f"{b}" for a, b in runs[:6]]
    return ", ".join(shown) + (f" and {len(runs) - 6} more" if len(runs) > 6 else "")
