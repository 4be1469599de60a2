"""A flight log with what every check of its columns goes by, worked out once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.data.logs.flight import MOTOR
from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.instruments.findings import Mask

REACHED = 0.95  # of the rows: a flight of a twentieth of the log is seen, a short pull is none


@dataclass(frozen=True)
class FlownLog:
    """The samples, by name as well, and where they fly."""

    samples: Samples
    rotors: tuple[int, ...]  # numbers of the airframe's
    flying: Mask  # (rows,) whether the motors carry it: a vehicle that stands may well read the same twice
    step_s: float  # from one row to the next, as usual
    steps: Mapping[str, float]  # the smallest of every column as it was logged; NaN of one that never moves

    @classmethod
    def of(cls, log: Samples, rotors: Sequence[int] = ()) -> FlownLog:
        """Of a log of an airframe with these rotors."""
        step_s = float(np.nanmedian(np.diff(log["time_s"]))) if log.rows > 2 else 0.0
        steps = {n: log.resolution.get(n, resolution_of(values)) for n, values in log.columns.items()}
        return cls(log, tuple(rotors), _flying(log), step_s, steps)

    @property
    def rows(self) -> int:
        """Count."""
        return self.samples.rows

    def __getitem__(self, name: str) -> Array:
        """(rows,) a column."""
        return self.samples[name]

    def has(self, name: str) -> bool:
        """Whether there is such a column."""
        return self.samples.has(name)

    @property
    def motors(self) -> tuple[str, ...]:
        """Columns of the rotors' commands."""
        return tuple(f"motor{n}" for n in self.rotors)

    @property
    def commands(self) -> Array:
        """(rows, N) of the rotors."""
        return np.stack([self[name] for name in self.motors], axis=1)


def _flying(log: Samples) -> Mask:
    """By the usual total of rows with more than half of what it reaches: a log may rest for most of its
    time."""
    total = np.zeros(log.rows)
    for name in filter(MOTOR.fullmatch, log.columns):
        total += np.clip(np.nan_to_num(log[name]), 0.0, 1.0)
    carrying = total[total >= 0.5 * np.quantile(total, REACHED)]
    return np.asarray(total > 0.4 * float(np.median(carrying)), bool)
