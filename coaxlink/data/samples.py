"""One table of measurements: named columns of equal length, SI units in every name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coaxlink.errors import InputError

if TYPE_CHECKING:
    import pandas

OUTPUTS_AS_MOTORS, RANGE, DAMAGED, SIGNED_SPEEDS = "outputs_as_motors", "range", "damaged", "signed_speeds"
FEWEST_ROWS = 6  # of a load: below, nothing is fitted to it
PREMISES = {  # what a reader took for granted: in words, and what would tell
    OUTPUTS_AS_MOTORS: "no parameter in the log says which output drives which motor: output n is taken for "
    "motor n; give a log that holds the parameters",
    RANGE: "neither MOT_PWM_MIN and MOT_PWM_MAX nor RC3_MIN and RC3_MAX are in the log: motors are taken to "
    "run from 1000 to 2000 us; give a log that holds the parameters",
    SIGNED_SPEEDS: "the rpm of some rotors are negative, as of ESCs that tell the direction by the sign: "
    "their amounts are taken",
    DAMAGED: "the file is damaged, some of it could not be read: take the log from the card again",
}


@dataclass(frozen=True)
class Samples:
    """Columns of a log after reading: known names, units converted, unusable rows gone.

    `notes` say in words what the reader recognised, converted and dropped; `premises` name what it had to
    take for granted, so that no verdict goes beyond it (`PREMISES`).
    """

    columns: Mapping[str, NDArray[np.float64]]  # each (rows,)
    source: str = ""
    notes: tuple[str, ...] = field(default=())
    lines: NDArray[np.int64] | None = None  # (rows,) line of each row in the source, where rows are lines
    upper_label: str = ""  # what the source calls the upper rotor, where it had to be given
    # smallest step of a column as it was logged, where the rows are no longer the logged ones
    resolution: Mapping[str, float] = field(default_factory=dict)
    premises: tuple[str, ...] = ()  # keys of PREMISES
    motors: tuple[int, ...] = ()  # that the vehicle has by its own word; () where the log does not say
    map_hint: str = ""  # a map of the columns (`data.suggested_map`), for who lacks one
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the autopilot, where they are logged
    # time_s, severity 0..7 or None, and words of the autopilot
    texts: tuple[tuple[float, int | None, str], ...] = ()
    provenance: tuple[
        str, ...
    ] = ()  # of the file, to be reported with every answer: its stretches, other vehicles

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
                if name.endswith("_thrust_N") and "pair_thrust_N" in self.columns:
                    problem = "both rotors together: identify says what that tells, and which run is missing"
                    raise InputError(self.source, f"column {name}", problem)
                found = ", ".join(self.columns) or "none"
                lacking = InputError(self.source, f"column {name}", f"missing (columns found: {found})")
                raise lacking.with_map(self.map_hint)

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

    def rows_lost(self) -> str:
        """In words which filters took rows before, to stand behind a count that is too small; "" for none."""
        took = (note for note in self.notes if "rows" in note and ("left out" in note or "dropped" in note))
        return "".join(f"; {note}" for note in took)

    def with_columns(self, **columns: ArrayLike) -> Samples:
        """A copy with these columns added or replaced, each (rows,)."""
        added = {name: np.asarray(column, float) for name, column in columns.items()}
        return replace(self, columns={**self.columns, **added})

    def without(self, *names: str) -> Samples:
        """A copy without these columns."""
        rest = {name: column for name, column in self.columns.items() if name not in names}
        return replace(self, columns=rest)

    def to_dataframe(self) -> pandas.DataFrame:
        """The columns as a pandas DataFrame, one row a sample; source, notes and resolution in its attrs.

        Raises InputError when pandas is not installed (coaxlink[pandas]).

        >>> Samples({"time_s": np.array([0.0, 0.5]), "upper_thrust_N": np.array([10.0, 12.0])}).to_dataframe()
           time_s  upper_thrust_N
        0     0.0            10.0
        1     0.5            12.0
        """
        from coaxlink.data.frame import dataframe

        about = {
            "source": self.source,
            "notes": list(self.notes),
            "resolution": dict(self.resolution),
            "premises": list(self.premises),
        }
        return dataframe(dict(self.columns), about)

    @classmethod
    def from_dataframe(cls, frame: pandas.DataFrame, source: str = "") -> Samples:
        """Samples of a pandas DataFrame whose columns are named with their units (`upper_thrust_N`), in SI.

        A missing value is NaN. An index of times, or one named time_s, becomes `time_s` (s) where no column
        is; a note says so. `source` is what errors call the table; what `to_dataframe` left in attrs is kept.
        Raises InputError naming the column that holds no numbers, and when pandas is not installed.

        >>> import pandas
        >>> frame = pandas.DataFrame({"upper_rpm": [1200, 1500], "voltage_V": [24.1, None]})
        >>> log = Samples.from_dataframe(frame)
        >>> log.rows, log["voltage_V"].tolist()
        (2, [24.1, nan])
        """
        from coaxlink.data.frame import columns_of

        columns, notes = columns_of(frame)
        about = frame.attrs
        earlier = tuple(str(note) for note in about.get("notes", ()))
        resolution = {k: float(v) for k, v in about.get("resolution", {}).items() if k in columns}
        premises = tuple(name for name in about.get("premises", ()) if name in PREMISES)
        source = source or str(about.get("source", ""))
        return cls(columns, source, earlier + notes, resolution=resolution, premises=premises)

    def with_notes(self, *notes: str) -> Samples:
        """A copy with remarks added."""
        return replace(self, notes=self.notes + notes)

    def on_premises(self, *premises: str) -> Samples:
        """A copy that rests on these as well (keys of PREMISES), each reported once in the notes."""
        new = tuple(p for p in dict.fromkeys(premises) if p not in self.premises)
        return replace(self, premises=self.premises + new).with_notes(*(PREMISES[p] for p in new))
