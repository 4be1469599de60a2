"""One table of measurements: named columns of equal length, SI units in every name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.errors import InputError


@dataclass(frozen=True)
class Samples:
    """Columns of a log after reading: known names, units converted, unusable rows gone.

    `notes` say in words what the reader recognised, converted and dropped.
    """

    columns: Mapping[str, NDArray[np.float64]]  # each (rows,)
    source: str = ""
    notes: tuple[str, ...] = field(default=())
    lines: NDArray[np.int64] | None = None  # (rows,) line of each row in the source, where rows are lines
    upper_label: str = ""  # what the source calls the upper rotor, where it had to be told
    # smallest step of a column as it was logged, where the rows are no longer the logged ones
    resolution: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shapes = {name: np.shape(column) for name, column in self.columns.items()}
        if len(set(shapes.values())) > 1:
            raise ValueError(f"columns of unequal length: {shapes}")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The column (rows,). Raises InputError naming it when the log has none."""
        if name not in self.columns:
            self.require(name)
        return self.columns[name]

    def has(self, *names: str) -> bool:
        """Whether every one of these columns is there."""
        return all(name in self.columns for name in names)

    def require(self, *names: str) -> None:
        """Raises InputError naming the first column that is missing."""
        for name in names:
            if name not in self.columns:
                found = ", ".join(self.columns) or "none"
                raise InputError(self.source, f"column {name}", f"missing (columns found: {found})")

    def take(self, index: ArrayLike) -> Samples:
        """The rows of a boolean mask (rows,) or of an index array, in that order."""
        chosen = np.asarray(index)
        if chosen.size == 0:
            chosen = chosen.astype(int)
        columns = {name: column[chosen] for name, column in self.columns.items()}
        return replace(self, columns=columns, lines=None if self.lines is None else self.lines[chosen])

    def place(self, row: int) -> str:
        """Where a row (counted from 0) stands in the source: "line 12", or "row 12" counted from 1."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"

    def with_columns(self, **columns: ArrayLike) -> Samples:
        """A copy with these columns added or replaced, each (rows,)."""
        added = {name: np.asarray(column, float) for name, column in columns.items()}
        return replace(self, columns={**self.columns, **added})

    def without(self, *names: str) -> Samples:
        """A copy without these columns."""
        kept = {name: column for name, column in self.columns.items() if name not in names}
        return replace(self, columns=kept)

    def with_notes(self, *notes: str) -> Samples:
        """A copy with remarks added."""
        return replace(self, notes=self.notes + notes)
