"""Tables of one rotor: a motor maker's, UIUC's and APC's data bases, a stand's log.

A maker's sheet (T-Motor and its like) is a CSV or a spreadsheet with throttle, rpm, thrust in grams and
torque or electrical power, often with cells merged over the rows. UIUC's static files hold RPM, CT and CP
(Brandt and Selig 2011), APC's PER3 files one block a speed with Ct and Cp, computed and not measured; both
in the units of propellers: T = CT rho n^2 D^4, P = CP rho n^3 D^5, n in 1/s.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import RAD_S_PER_RPM, STANDARD_DENSITY_KG_M3
from coaxlink.data.aliases import OWN_COLUMNS, PAIR, QUANTITIES, SIDES, words_of
from coaxlink.data.averaging import conditions
from coaxlink.data.lines import read_lines
from coaxlink.data.samples import Samples
from coaxlink.data.stand import read_stand_log
from coaxlink.data.table import is_spreadsheet, read_headings, read_table
from coaxlink.data.tare import without_tares
from coaxlink.errors import InputError

Array = NDArray[np.float64]
_LOADS = tuple(QUANTITIES[q].suffix for q in ("thrust", "torque"))
DENSITY_KG_M3 = STANDARD_DENSITY_KG_M3  # what tables without a density mean
FEWEST_SPEEDS = 4  # rows: a level, a slope over the speed, and something left over
ONE_PROPELLER = 0.15  # scatter of thrust over speed squared: Reynolds' number alone gives less over a sheet
SAME_ROW = 0.30  # of thrust over speed squared, between a row at speed and the middle one: twice that scatter
# T^1.5 / sqrt(2 rho A) over the shaft's power, in hover: Deters, Ananda and Selig 2014 have 0.3 to 0.75
MERIT, MOTOR = (0.2, 0.9), 0.5  # a motor with its ESC gives at least half of what it takes, at speed
READS = 0.01  # of the largest thrust and power: what a cell is off by
APC_HEAD = 200  # lines in which the first block of an APC file stands
_BLOCK = re.compile(r"PROP RPM\s*=\s*(\S+)")
ANOTHER_PACK = 0.08  # one cell more of twelve; between rows of a pack that sags lie 3 % at most
STANDS_STILL = 0.05  # of the fastest: a row in which the propeller does not turn


@dataclass(frozen=True)
class Origin:
    """Where a table comes from, and how far its level may be off (1 sd, shares of the load)."""

    name: str
    words: str
    thrust: float
    torque: float


# Stands: runs of one rotor on the platform of Buzzatto and Liarokapis differ by 1 to 3 % in thrust and 1 to
# 10 % in torque. Brandt and Selig 2011 repeat within 2 %. Makers print no uncertainty and APC's figures are
# computed: their shares are ours, and reported to be.
STAND = Origin("stand", "measured on a stand", 0.02, 0.05)
UIUC = Origin("uiuc", "measured at UIUC", 0.02, 0.03)
MAKER = Origin("maker", "a maker's sheet", 0.05, 0.07)
APC = Origin("apc", "computed by APC", 0.08, 0.10)


@dataclass(frozen=True)
class SingleTable:
    """One rotor alone, hovering; each column (rows,)."""

    rpm: Array
    thrust_N: Array
    torque_Nm: Array | None
    power_W: Array | None  # electrical
    origin: Origin
    source: str
    voltage_V: float | None = None
    notes: tuple[str, ...] = field(default=())
    lines: NDArray[np.int64] | None = None  # (rows,) of the file

    def place(self, row: int) -> str:
        """Where a row (counted from 0) stands in the source."""
        return f"row {row + 1}" if self.lines is None else f"line {self.lines[row]}"


def read_single_table(
    path: Path,
    diameter_m: float,
    *,
    columns_map: Path | None = None,
    poles: int | None = None,
    sheet: str | None = None,
    trust_units: bool = False,
    voltage_V: float | None = None,
) -> SingleTable:
    """A table of one rotor alone. Raises InputError: no speed or thrust, two rotors, several propellers, rows
    at several supplies of which `voltage_V` names none.

    `diameter_m` is the propeller's: data bases give coefficients, and a log is held against it.
    """
    path = Path(path)
    if columns_map is None and not is_spreadsheet(path):
        if any(_BLOCK.search(line) for _, line in next(read_lines(path))[:APC_HEAD]):
            return _checked(_apc(path, diameter_m), diameter_m)
        names = {heading.casefold() for heading in read_headings(path)}
        if {"rpm", "ct", "cp"} <= names:
            return _checked(_uiuc(path, diameter_m), diameter_m)
        if {"j", "ct", "cp"} <= names:
            raise InputError(path, "line 1", "static data (RPM CT CP) are expected, found a table over J")
    log = read_stand_log(
        path, columns_map, poles=poles, diameter_m=diameter_m, sheet=sheet, trust_units=trust_units
    )
    headings = read_headings(path, sheet) if columns_map is None else OWN_COLUMNS
    logged = set(headings) & set(OWN_COLUMNS) or any("time" in words_of(h) for h in headings)
    return _checked(_of_log(_at(log, voltage_V), STAND if logged else MAKER), diameter_m)


def _at(log: Samples, voltage_V: float | None) -> Samples:
    """The rows at one supply. Raises InputError where there are several, and none or another is named."""
    name = next((n for n in ("upper_voltage_V", "voltage_V") if log.has(n)), "")
    volts = log[name] if name else np.zeros(0)
    order = np.argsort(volts)
    steps = np.flatnonzero(volts[order][1:] > (1.0 + ANOTHER_PACK) * volts[order][:-1])
    groups = [rows for rows in np.split(order, steps + 1) if len(rows) and volts[rows[0]] > 0.0]
    if voltage_V is None and len(groups) < 2:
        return log
    levels = [float(np.median(volts[rows])) for rows in groups]
    found = " and ".join(f"{level:.3g} V" for level in levels) or "no voltage"
    if voltage_V is None:
        raise InputError(log.source, f"column {name}", f"rows at {found}: which are yours? `voltage_V`")
    near = [
        rows for rows, level in zip(groups, levels, strict=True) if abs(level / voltage_V - 1) < ANOTHER_PACK
    ]
    if len(near) != 1:
        raise InputError(log.source, "`voltage_V`", f"no rows at {voltage_V:g} V: found {found}")
    return log.take(np.sort(near[0])).with_notes(f"the rows at {voltage_V:g} V, of {found}")


def _of_log(log: Samples, origin: Origin) -> SingleTable:
    """A maker's sheet, a stand's log of one rotor, or its rows in which the other one stands."""
    log = _alone(log)
    if not log.has("upper_thrust_N"):  # one cell under the pair, of which the upper one alone turns
        own = {f"upper_{s}": log[f"{PAIR}_{s}"] for s in _LOADS if log.has(f"{PAIR}_{s}")}
        log = log.with_columns(**{n: x * (float(np.sign(np.nanmedian(x))) or 1.0) for n, x in own.items()})
    for name, what, example in (("upper_rpm", "rpm", "RPM"), ("upper_thrust_N", "thrust", "Thrust (g)")):
        if not log.has(name):
            problem = f"no column of {what}: a heading such as '{example}' is expected"
            raise InputError(log.source, "", f"{problem} (found {', '.join(log.columns)})")
    log = conditions(without_tares(log))
    log = log.take(log["upper_rpm"] > 0.1 * log["upper_rpm"].max())  # of a ramp, what is above idling

    def column(*names: str) -> Array | None:
        return next((log[n] for n in names if log.has(n)), None)

    volts, amps = column("upper_voltage_V", "voltage_V"), column("upper_current_A")
    power = column("upper_power_W")
    if power is None and volts is not None and amps is not None:
        power = volts * amps
    return SingleTable(
        log["upper_rpm"], log["upper_thrust_N"], column("upper_torque_Nm"), power, origin, log.source,
        None if volts is None else float(np.median(volts)), log.notes, log.lines,
    )  # fmt: skip


def _alone(log: Samples) -> Samples:
    """The rows in which the lower rotor stands still; where the upper one never turns in them, those in which
    the upper one does, the lower one's loads as the upper's.

    Raises InputError where neither turns alone.
    """
    if not log.has("lower_rpm"):
        return log
    speeds = {
        side: log[f"{side}_rpm"] if log.has(f"{side}_rpm") else 0.0 * log["lower_rpm"] for side in SIDES
    }
    least = STANDS_STILL * max(float(np.nanmax(speed, initial=0.0)) for speed in speeds.values())
    turns = {side: speed > least for side, speed in speeds.items()}
    for side, other in (SIDES, SIDES[::-1]):
        if (turns[side] & ~turns[other]).any():
            own = log.take(~turns[other]).without(*(n for n in log.columns if n.startswith(f"{other}_")))
            if side == "upper":
                return own
            moved = {n: f"upper_{n.removeprefix('lower_')}" for n in own.columns if n.startswith("lower_")}
            note = "the lower rotor turns alone in it"
            return (
                own.with_columns(**{new: own[n] for n, new in moved.items()}).without(*moved).with_notes(note)
            )
    found = "two that turn: identify LOG" if turns["upper"].any() else "none that turns"
    raise InputError(log.source, "", f"a table of one rotor is expected, found {found}")


def _uiuc(path: Path, diameter_m: float) -> SingleTable:
    table = read_table(path)
    values = {name.casefold(): table.numbers(i) for i, name in enumerate(table.headings)}
    return _of_coefficients(path, values["rpm"], values["ct"], values["cp"], diameter_m, UIUC)


def _apc(path: Path, diameter_m: float) -> SingleTable:
    """The first row of each block: V = 0, the propeller at rest in the air."""
    rows = []
    speed: float | None = None
    names: list[str] = []
    for number, line in (numbered for piece in read_lines(path) for numbered in piece):
        block = _BLOCK.search(line)
        cells = line.split()
        if block:
            speed, names = _number(path, number, block[1]), []
        elif speed is not None and not names and {"v", "ct", "cp"} <= {c.casefold() for c in cells}:
            names = [c.casefold() for c in cells]
        elif speed is not None and names and cells and re.match(r"[-+.\d]", cells[0]):
            row = dict(zip(names, cells, strict=False))
            if _number(path, number, row["v"]) == 0.0:
                rows.append([speed, _number(path, number, row["ct"]), _number(path, number, row["cp"])])
            speed = None
    rpm, ct, cp = np.array(rows).reshape(-1, 3).T
    return _of_coefficients(path, rpm, ct, cp, diameter_m, APC)


def _of_coefficients(
    path: Path, rpm: Array, ct: Array, cp: Array, diameter_m: float, origin: Origin
) -> SingleTable:
    n = rpm / 60.0
    thrust = ct * DENSITY_KG_M3 * n**2 * diameter_m**4
    torque = cp * DENSITY_KG_M3 * n**2 * diameter_m**5 / (2 * math.pi)
    note = f"coefficients taken at {DENSITY_KG_M3} kg/m3"
    return SingleTable(rpm, thrust, torque, None, origin, str(path), None, (note,))


def _number(path: Path, line: int, cell: str) -> float:
    try:
        value = float(cell.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, f"line {line}", f"a number is expected, found '{cell[:30]}'")
    return value


def _checked(table: SingleTable, diameter_m: float) -> SingleTable:
    if len(table.rpm) < FEWEST_SPEEDS:
        raise InputError(
            table.source, "", f"{FEWEST_SPEEDS} speeds at least are expected, found {len(table.rpm)}"
        )
    if (table.rpm <= 0).any():
        row = int(np.argmax(table.rpm <= 0))
        raise InputError(
            table.source, table.place(row), f"an rpm above 0 is expected, found {table.rpm[row]:g}"
        )
    fast = table.rpm > 0.5 * table.rpm.max()
    constant = table.thrust_N[fast] / table.rpm[fast] ** 2
    middle = float(np.median(constant))
    if middle <= 0:
        raise InputError(table.source, "column thrust", "a thrust above 0 is expected at speed")
    low, high = np.percentile(constant / middle, (10, 90))
    spread = float(high - low) / 2
    if spread > ONE_PROPELLER:
        problem = (
            f"thrust over speed squared scatters by {100 * spread:.0f} %: several propellers in one table? "
            "keep the rows of one"
        )
        raise InputError(table.source, "", problem)
    odd = np.flatnonzero(fast)[np.abs(constant / middle - 1) > SAME_ROW]
    if len(odd):
        row = int(odd[0])
        found = f"{table.thrust_N[row]:.4g} N at {table.rpm[row]:g} rpm"
        usual = middle * table.rpm[row] ** 2
        problem = f"the other rows' propeller gives {usual:.4g} N there: two rows in one, or a cell is wrong"
        raise InputError(table.source, table.place(row), f"{found}, and {problem}")
    _refuse_merit(table, diameter_m, fast)
    return table


def _refuse_merit(table: SingleTable, diameter_m: float, fast: NDArray[np.bool_]) -> None:
    """Raises InputError for a row whose power no propeller of that size takes for its thrust."""
    low, high = MERIT
    if table.torque_Nm is not None:
        power, what = table.torque_Nm * table.rpm * RAD_S_PER_RPM, "torque times speed"
        least = np.full(len(power), low)
    elif table.power_W is not None:  # idling takes more than its share
        power, what = table.power_W, "electrical power"
        least = np.where(fast, low * MOTOR, 0.0)
    else:
        return
    disc = 2 * DENSITY_KG_M3 * math.pi * diameter_m**2 / 4
    lift, taken = (READS * float(np.median(column[fast])) for column in (table.thrust_N, power))
    ideal = [np.maximum(table.thrust_N + sign * lift, 0.0) ** 1.5 / math.sqrt(disc) for sign in (-1, 1)]
    wrong = (ideal[0] > high * (power + taken)) | (ideal[1] < least * (power - taken))
    if wrong.any():
        row = int(np.argmax(wrong))
        merit = table.thrust_N[row] ** 1.5 / math.sqrt(disc) / power[row] if power[row] > 0 else math.nan
        found = f"{table.thrust_N[row]:.4g} N for {power[row]:.4g} W ({what})"
        problem = (
            f"{found} is a figure of merit of {merit:.2g}; a propeller of {diameter_m:g} m has {low:g} to "
            f"{high:g}: is the row, a unit or `diameter_m` wrong? (a map leaves a wrong column out)"
        )
        raise InputError(table.source, table.place(row), problem)
