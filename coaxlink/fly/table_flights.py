"""The split by whole flights: two tables in turn, for a board that cannot be mixed live.

Every flight is one hover with the table on board and a fresh pack. Of its dwells what time since take-off,
climb and tilt explain is taken off, all flights together; what is left is one number a flight. Two tables
differ by the means of their flights, and how well that is known, flights of the same table say: packs, air
and the day differ more between two flights than readings in one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.fly.split_answer import DRIFT_S, LEVEL, Dwells, Interval
from coaxlink.fly.split_plan import PowerRecord, SplitPlan, hearing
from coaxlink.live.module_end import ModuleEnd
from coaxlink.mavlink import Session
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mixer.split import upper_share
from coaxlink.tables.behaviour import behaviour
from coaxlink.uploading.beside import commands_on_board
from coaxlink.vehicle import Vehicle

SCATTER = 0.01  # of the watts: by so much two hovers of one vehicle differ; assumed until flights have told
SEEN = 0.02  # of the watts: the difference that a count of flights is given for
ALIKE = 0.005  # shares closer than this are of one table: a board rounds its entries
MOST_FLIGHTS = 99
FIND_HZ = 50.0  # of the module's demand, which tells that it is there


@dataclass(frozen=True)
class TablesAnswer:
    """What flights with two tables say; fractions are of the first table's watts."""

    shares: tuple[float, float]  # of the thrust by the upper rotors, first flown first
    flights: tuple[int, int]
    watts: float  # with the first
    saving: float  # by the second; fraction
    saving_ci: Interval
    scatter: float  # fraction, of one flight

    @property
    def worth_it(self) -> bool:
        """Whether the tables differ beyond chance."""
        return self.saving_ci[0] > 0.0 or self.saving_ci[1] < 0.0

    @property
    def better(self) -> float:
        """Share of the table that takes less."""
        return self.shares[self.saving > 0.0]

    def words(self) -> str:
        """The answer in one line."""
        first, second = self.shares
        low, high = (100 * v for v in self.saving_ci)
        reported = (
            f"{second:.3f} of the thrust from above takes {100 * self.saving:.1f} % less than {first:.3f} "
            f"({low:.1f} to {high:.1f})"
        )
        if not self.worth_it:
            return f"no difference that {sum(self.flights)} flights show: {reported}"
        return reported

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {**asdict(self), "worth_it": self.worth_it, "better": self.better}


def flights_for(difference: float, scatter: float) -> int:
    """Flights of each table, so that the half width of their difference's interval is `difference`.

    >>> flights_for(0.02, 0.01)
    4
    """
    from scipy.stats import t

    for n in range(2, MOST_FLIGHTS):
        if t.ppf(0.5 + 0.5 * LEVEL, 2 * n - 2) * scatter * math.sqrt(2.0 / n) <= difference:
            return n
    return MOST_FLIGHTS


def counted(flights: Sequence[Dwells]) -> tuple[int, int]:
    """Flights with the table that was flown first, and with others."""
    share = np.array([float(np.median(one.share)) for one in flights])
    second = np.abs(share - share[0]) > ALIKE
    return int(np.sum(~second)), int(np.sum(second))


def compare_tables(flights: Sequence[Dwells]) -> TablesAnswer:
    """Two tables by their flights, in any order. Raises InputError for too few, or three tables."""
    from scipy.stats import t

    share = np.array([float(np.median(one.share)) for one in flights])
    second = np.abs(share - share[0]) > ALIKE
    counts = counted(flights)
    if np.any(second) and np.ptp(share[second]) > ALIKE:
        raise InputError("the flights", "shares", "two tables are expected, more were flown")
    if min(counts) < 2:
        problem = f"{counts[0]} of one table and {counts[1]} of another, two of each are needed at least"
        raise InputError("the flights", "count", problem)
    watts = _levels(flights)
    means = watts[~second].mean(), watts[second].mean()
    spare = len(watts) - 2
    within = np.where(second, watts - means[1], watts - means[0])
    scatter = math.sqrt(float(within @ within) / spare)
    reach = float(t.ppf(0.5 + 0.5 * LEVEL, spare)) * scatter * math.sqrt(1.0 / counts[0] + 1.0 / counts[1])
    saved, whole = float(means[0] - means[1]), float(means[0])
    return TablesAnswer(
        (float(share[~second].mean()), float(share[second].mean())), counts, whole, saved / whole,
        ((saved - reach) / whole, (saved + reach) / whole), scatter / whole,
    )  # fmt: skip


def _levels(flights: Sequence[Dwells]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(flights,) watts of each, less what dwells explain; at the mean time, climb and tilt of all."""
    which = np.repeat(np.arange(len(flights)), [len(one.watts) for one in flights])
    since = np.concatenate([one.time_s for one in flights])
    powers = 1 + int(np.ptp(since) // DRIFT_S)
    drift = np.polynomial.legendre.legvander(2.0 * since / max(float(since.max()), 1.0) - 1.0, powers)[:, 1:]
    columns = np.column_stack([drift, np.concatenate([one.columns for one in flights])])
    columns = columns - columns.mean(axis=0)
    design = np.column_stack([which[:, None] == np.arange(len(flights)), columns])
    found = np.linalg.lstsq(design, np.concatenate([one.watts for one in flights]), rcond=None)[0]
    return np.asarray(found[: len(flights)])


class TableFlight:
    """A hover with the table on board: give `mixing` and `watch` to `Pilot.fly`; nothing is mixed live."""

    def __init__(self, session: Session, vehicle: Vehicle, *, dwells: int) -> None:
        """Reads the table on board.

        Raises SafetyRefusal where coaxlink's module has the motors, and as `commands_on_board` does.
        """
        if session.identity.is_px4 and ModuleEnd(session, vehicle, FIND_HZ).find():
            raise SafetyRefusal(
                "coaxlink's module flies the motors, whatever table is on board: take it back first, or fly "
                "this plan without `tables`"
            )
        commands = commands_on_board(vehicle, session)
        self.share = upper_share(vehicle, behaviour(vehicle, commands).hover_speeds)
        self.plan = SplitPlan((self.share,), self.share, dwells)
        self.record = PowerRecord(
            Telemetry(session.clock.monotonic),
            self.plan,
            upper=tuple(rotor.level == "upper" for rotor in vehicle.airframe.rotors),
        )
        self._session = session

    @contextmanager
    def mixing(self) -> Iterator[None]:
        """The battery is read meanwhile."""
        with hearing(self._session, self.record):
            yield

    def watch(self, t: float) -> None:
        """Where the plan is, at `t` s."""
        self.record.now_s = t
