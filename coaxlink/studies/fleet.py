"""A fleet's logs: what is found in each, and what that says of each vehicle over time.

A log belongs to the vehicle whose folder it lies in, and to the date in its name; FOLDER/fleet.csv (log,
vehicle, date) says otherwise. What is found in a log is the word of whoever analyses it (`refine`, `health`):
here only findings of one kind on one vehicle are put in a row. One finding in one log is not believed: of n
logs k must hold it, more than false alarms at FALSE_ALARM a log would bring once in a thousand fleets
(binomial, Bonferroni over all vehicles and kinds). How it grows is a straight line through its sizes by least
squares, with Student's interval.
"""

from __future__ import annotations

import csv
import datetime
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coaxlink import files
from coaxlink.errors import CoaxlinkError, InputError
from coaxlink.studies.engine import Machine, Row, run

SUFFIXES = (".ulg", ".bin", ".tlog", ".csv")
INDEX = "fleet.csv"
FALSE_ALARM = 0.02  # of a log without anything in it; docs/measured.md has fewer
CHANCE = 1e-3  # of one false word about a fleet
_DATE = re.compile(r"(20\d\d)[-_.]?(\d{1,2})[-_.]?(\d{1,2})(?:[T_/ -]+(\d{1,2})[-_:]?(\d{2}))?")


@dataclass(frozen=True)
class Log:
    """One log of a fleet; `address` is its path."""

    address: str
    name: str  # under the fleet's folder
    vehicle: str
    date: datetime.datetime


@dataclass(frozen=True)
class LogFinding:
    """One thing found in one log."""

    name: str  # of the effect or fault
    part: str  # rotor 3, or nothing
    value: float
    ci: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class Trend:
    """One kind of finding on one vehicle over time."""

    vehicle: str
    name: str
    part: str
    unit: str
    dates: tuple[str, ...]  # of the logs that hold it
    values: tuple[float, ...]
    logs: int  # of the vehicle, from the first that holds it on
    p_value: float  # of so many by false alarms
    believed: bool
    per_week: float  # growth
    per_week_ci: tuple[float, float]

    @property
    def grows(self) -> bool:
        """Whether its size moves away from nothing beyond chance."""
        ends = self.per_week_ci
        return ends[0] > 0.0 if np.mean(self.values) >= 0.0 else ends[1] < 0.0

    def words(self) -> str:
        """As it is reported."""
        what = f"{self.vehicle}: {self.name}" + (f", {self.part}" if self.part else "")
        size = f"{self.values[-1]:.3g} {self.unit}".rstrip(" 1").rstrip()
        occurrence = f"in {len(self.dates)} of {self.logs} logs since {self.dates[0][:10]}, last {size}"
        ends = " .. ".join(f"{100 * x:+.2g}" if self.unit == "1" else f"{x:+.2g}" for x in self.per_week_ci)
        unit = "%" if self.unit == "1" else self.unit
        return f"{what}: {occurrence}" + (f", growing by {ends} {unit} a week" if self.grows else "")


@dataclass(frozen=True)
class Fleet:
    """What a fleet's logs say."""

    logs: int
    vehicles: tuple[str, ...]
    problems: Mapping[str, str]  # log: why it says nothing
    trends: tuple[Trend, ...]  # the believed first
    rows: tuple[tuple[str, str, tuple[LogFinding, ...]], ...]  # vehicle, date, findings; a log each

    @property
    def believed(self) -> tuple[Trend, ...]:
        """What false alarms do not explain."""
        return tuple(c for c in self.trends if c.believed)

    def to_json(self) -> dict[str, Any]:
        """As `refine FOLDER --json` writes it."""

        def safe(x: float) -> float | None:
            return x if math.isfinite(x) else None

        findings = [
            {
                **vars(t),
                "grows": t.grows,
                "dates": list(t.dates),
                "values": list(t.values),
                "per_week": safe(t.per_week),
                "per_week_ci": [safe(x) for x in t.per_week_ci],
            }
            for t in self.trends
        ]
        return {
            "kind": "fleet",
            "logs": self.logs,
            "vehicles": list(self.vehicles),
            "problems": dict(self.problems),
            "findings": findings,
        }


# what is found in a log on disk; raises CoaxlinkError where it says nothing
Analyse = Callable[[Path], Sequence[LogFinding]]


def find_logs(folder: str) -> list[Log]:
    """All logs under a folder, by vehicle and date.

    Raises InputError where there are none, or one whose date nobody can tell.
    """
    names = _listed(folder)
    listed = _index(folder) if INDEX in names else {}
    logs = []
    for name in names:
        if not name.lower().endswith(SUFFIXES) or name == INDEX:
            continue
        vehicle, date = listed.get(name, (_vehicle(name), _date(name)))
        if date is None:
            problem = f"no date (2026-03-28) in its path: rename it, or say it in {INDEX} (log,vehicle,date)"
            raise InputError(f"{folder}/{name}", "", problem)
        logs.append(Log(f"{folder.rstrip('/')}/{name}", name, vehicle, date))
    if not logs:
        raise InputError(folder, "", f"no logs there ({', '.join(SUFFIXES)})")
    return sorted(logs, key=lambda log: (log.vehicle, log.date, log.name))


def _listed(folder: str) -> list[str]:
    root = Path(folder)
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file())


def _vehicle(name: str) -> str:
    """The first folder; of a file without one what its name says before the date."""
    head, slash, _ = name.partition("/")
    if slash:
        return head
    found = _DATE.search(name)
    return (name[: found.start()] if found else Path(name).stem).strip("-_. ") or "vehicle"


def _date(name: str) -> datetime.datetime | None:
    for found in reversed(list(_DATE.finditer(name))):
        year, month, day, hour, minute = (int(x) if x else 0 for x in found.groups())
        try:
            return datetime.datetime(year, month, day, hour, minute)
        except ValueError:
            continue
    return None


def _index(folder: str) -> dict[str, tuple[str, datetime.datetime | None]]:
    address = f"{folder.rstrip('/')}/{INDEX}"
    rows = csv.DictReader(io.StringIO(files.read_text(Path(address))))
    if not {"log", "vehicle", "date"} <= set(rows.fieldnames or ()):
        raise InputError(address, "line 1", "the columns log, vehicle, date are expected")
    listed: dict[str, tuple[str, datetime.datetime | None]] = {}
    for row in rows:
        date = _date(row["date"] or "")
        if date is None:
            raise InputError(address, f"line {rows.line_num}", f"a date is expected, found {row['date']!r}")
        listed[row["log"] or ""] = (row["vehicle"] or "", date)
    return listed


def analyse_logs(task: tuple[Analyse, Sequence[Log]], numbers: Sequence[int]) -> list[Row]:
    """What is found in each of these logs, for the engine."""
    analyse, logs = task
    rows = []
    for number in numbers:
        log = logs[number]
        problem, found = "", tuple[LogFinding, ...]()
        try:
            found = tuple(analyse(Path(log.address)))
        except CoaxlinkError as error:
            problem = str(error)
        except OSError as error:
            problem = f"{log.address}: cannot be read ({error})"
        rows.append({"number": number, "log": log, "problem": problem, "findings": found})
    return rows


def look_through(
    logs: Sequence[Log], analyse: Analyse, machine: Machine, tell: Callable[[int], None] = lambda _: None
) -> Fleet:
    """Analyse all logs and put them in a row; `analyse` must be a function that workers can import.

    Raises what the engine raises; a log that cannot be analysed is a problem of its own, not an error.
    """
    rows: list[Row] = []
    for done in run(analyse_logs, (analyse, logs), range(len(logs)), machine):
        rows += done
        tell(len(rows))
    return fleet_of(sorted(rows, key=lambda row: int(row["number"])))


def fleet_of(rows: Sequence[Row]) -> Fleet:
    """The fleet of rows (log, problem, findings), sorted by vehicle and date."""
    problems = {row["log"].name: str(row["problem"]) for row in rows if row["problem"]}
    findings = tuple(
        (row["log"].vehicle, row["log"].date.isoformat(), tuple(row["findings"]))
        for row in rows
        if not row["problem"]
    )
    vehicles = tuple(dict.fromkeys(row["log"].vehicle for row in rows))
    trends = sorted(
        _trends(findings, len(vehicles)), key=lambda t: (not t.believed, t.p_value, t.vehicle, t.name)
    )
    return Fleet(len(rows), vehicles, problems, tuple(trends), findings)


def _trends(rows: Sequence[tuple[str, str, tuple[LogFinding, ...]]], vehicles: int) -> Iterator[Trend]:
    from scipy.stats import binom

    kinds = {(f.name, f.part) for _, _, found in rows for f in found}
    limit = CHANCE / max(vehicles * len(kinds), 1)
    for vehicle in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == vehicle]
        for name, part in sorted({(f.name, f.part) for _, _, found in mine for f in found}):
            held = [
                (k, date, f)
                for k, (_, date, found) in enumerate(mine)
                for f in found
                if (f.name, f.part) == (name, part)
            ]
            # any stretch of logs up to the last may be the one that ails: the rarest counts, times so many
            p_value = min(float(binom.sf(len(held) - n - 1, len(mine) - k, FALSE_ALARM)) for n, (k, _, _) in
                          enumerate(held))  # fmt: skip
            p_value = min(p_value * len(mine), 1.0)
            dates, values = [d for _, d, _ in held], [f.value for _, _, f in held]
            slope, ends = growth(dates, values)
            yield Trend(
                vehicle, name, part, held[0][2].unit, tuple(dates), tuple(values), len(mine) - held[0][0],
                p_value, p_value < limit, slope, ends,
            )  # fmt: skip


def growth(dates: Sequence[str], values: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Slope a week of values at ISO dates by least squares, and Student's 95 % interval, or NaN."""
    from scipy.stats import t as student

    days = [datetime.datetime.fromisoformat(d).timestamp() / 86400.0 for d in dates]
    x, y = np.array(days) / 7.0, np.asarray(values, float)
    x = x - x.mean()
    if len(x) < 3 or not np.any(x != 0.0):
        return math.nan, (math.nan, math.nan)
    slope = float(x @ y / (x @ x))
    left = y - y.mean() - slope * x
    half = float(student.ppf(0.975, len(x) - 2) * math.sqrt((left @ left) / (len(x) - 2) / (x @ x)))
    return slope, (slope - half, slope + half)


@dataclass(frozen=True)
class RefineLog:
    """`refine` of one flight log as a fleet's analysis: the vehicle's files, or those beside its logs."""

    airframe: Path | None
    rotor: Path | None = None

    def __call__(self, log: Path) -> list[LogFinding]:
        """Everything that refine names; raises CoaxlinkError."""
        from coaxlink.airframe import load_airframe
        from coaxlink.data import read_flights
        from coaxlink.residual import refine
        from coaxlink.vehicle import load_rotors

        beside = log.parent / "airframe.toml"
        file = beside if beside.is_file() else self.airframe
        if file is None:
            raise InputError(log, "", f"whose flight is it? An {beside.name} beside it, or `airframe`")
        frame = load_airframe(file)
        model = self.rotor or frame.rotor_model
        if model is None:
            raise InputError(
                frame.source or "airframe", "rotor_model", "missing: name a rotor file (`rotor`)"
            )
        answer = refine(read_flights(log), frame, load_rotors(model))
        found = []
        for e in answer.effects:
            by_name = {p.name: p for p in e.parameters}
            rotor = by_name.pop("rotor", None)
            main = next(iter(by_name.values()), None)
            if main is not None:
                part = f"rotor {rotor.value:.0f}" if rotor is not None else ""
                found.append(LogFinding(e.name, part, main.value, (main.ci[0], main.ci[1]), main.unit))
        suspects = sorted({s.column for s in answer.suspect_data})
        found += [LogFinding("suspect_data", column, 1.0, (math.nan, math.nan), "1") for column in suspects]
        return found
