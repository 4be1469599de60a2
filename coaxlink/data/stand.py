"""Stand logs: our own columns as they are, foreign headings recognised, or mapped by a TOML file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from coaxlink import files
from coaxlink.data.headings import Heading, UnknownUnitError, is_derived, recognise
from coaxlink.data.samples import Samples
from coaxlink.data.table import TextTable, read_table
from coaxlink.errors import InputError

OWN_COLUMNS = (
    "time_s",
    *(
        f"{side}_{what}"
        for side in ("upper", "lower")
        for what in ("rpm", "throttle", "thrust_N", "torque_Nm")
    ),
    "voltage_V",
    "upper_voltage_V",
    "lower_voltage_V",
    "upper_current_A",
    "lower_current_A",
    "motor_temperature_C",
    "air_temperature_C",
    "air_pressure_Pa",
    "rotor_spacing_m",
)
_OF_A_ROTOR = re.compile(r"(upper|lower)_(rpm|throttle|thrust_N|torque_Nm)")
_OWN_STYLE = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
PWM_STOP_US, PWM_SPAN_US = 1000.0, 1000.0  # what ESCs and both firmwares take for 0 and 0..1


class _Mapped(BaseModel):
    model_config = ConfigDict(extra="forbid")
    column: str
    scale: float = Field(default=1.0, allow_inf_nan=False)
    offset: float = Field(default=0.0, allow_inf_nan=False)


def read_stand_log(path: Path, columns_map: Path | None = None) -> Samples:
    """A stand log as Samples in the contract's columns, SI.

    A foreign file loses its sums and efficiencies, its rows before the motors turn, and the signs of its
    torques and thrusts (positive as the model has them). `columns_map` names further columns:
    `upper_thrust_N = { column = "Thrust Left [g]", scale = 0.00980665 }`.

    Raises InputError (file, line, column, what was expected).
    """
    table = read_table(Path(path))
    columns, used, notes = _mapped(table, columns_map) if columns_map else ({}, set(), [])
    own = [i for i, name in enumerate(table.headings) if name in OWN_COLUMNS and i not in used]
    for i in own:
        columns.setdefault(table.headings[i], table.numbers(i))
        used.add(i)
    # a foreign file to which somebody added a spacing or a temperature of ours is a foreign file
    foreign = (
        {} if any(_OF_A_ROTOR.fullmatch(table.headings[i]) for i in own) else _foreign(table, used, notes)
    )
    for name, column in foreign.items():
        columns.setdefault(name, column)
    context = _context(table, used, notes)
    samples = Samples({**columns, **context}, str(path), tuple(notes), np.array(table.lines))
    if foreign:
        samples = _positive(_turning(_without_dead_sensors(samples)))
    _check(samples, table)
    return samples


def _mapped(table: TextTable, path: Path) -> tuple[dict[str, NDArray[np.float64]], set[int], list[str]]:
    columns, used, notes = {}, set(), []
    for name, value in files.read_toml(path).items():
        try:
            entry = _Mapped.model_validate({"column": value} if isinstance(value, str) else value)
        except ValidationError as error:
            first = error.errors()[0]
            raise InputError(path, name, f'{first["msg"]}: {{ column = "HEADING", scale = 1.0 }}') from error
        heading = " ".join(entry.column.split())
        if heading not in table.headings:
            raise InputError(table.source, f"column {heading!r}", f"missing ({path} maps it to {name})")
        index = table.headings.index(heading)
        columns[name] = entry.scale * table.numbers(index) + entry.offset
        used.add(index)
        notes.append(
            f"{name} = {entry.scale:g} x '{heading}'" + (f" + {entry.offset:g}" * bool(entry.offset))
        )
    return columns, used, notes


def _foreign(table: TextTable, used: set[int], notes: list[str]) -> dict[str, NDArray[np.float64]]:
    """Every recognised foreign column under our name; marks the columns it has dealt with."""
    found: dict[str, list[Heading]] = {}
    for i, text in enumerate(table.headings):
        if i in used or table.column_is_empty(i):
            continue
        try:
            heading = recognise(i, text)
        except UnknownUnitError as error:
            raise InputError(table.source, f"line 1, column {text!r}", str(error)) from error
        if heading is not None:
            found.setdefault(_side_of(heading, table, used), []).append(heading)
    columns = {}
    for name, headings in found.items():
        used.update(h.index for h in headings)
        chosen = _preferred(table, headings)
        columns[name] = chosen.scale * table.numbers(chosen.index)
        notes.append(f"{name} from '{chosen.text}'")
    if any(h.lettered for headings in found.values() for h in headings):
        notes.append("A read as the lower rotor, B as the upper: map with --columns if it is the other way")
    for side in ("upper", "lower"):
        if f"{side}_pwm" in columns:
            pwm = columns.pop(f"{side}_pwm")
            columns[f"{side}_throttle"] = np.clip((pwm - PWM_STOP_US) / PWM_SPAN_US, 0.0, 1.0)
            notes.append(f"{side}_throttle = (PWM - {PWM_STOP_US:g}) / {PWM_SPAN_US:g}, 0..1")
    return columns


def _side_of(heading: Heading, table: TextTable, used: set[int]) -> str:
    """Our name of a heading; one that names no rotor belongs to the rotor its quantity has not named yet."""
    if heading.side or heading.quantity == "time":
        return heading.name
    named = set()
    for i, text in enumerate(table.headings):
        other = None if i in used or is_derived(text) else _recognised(i, text)
        if other is not None and other.side:
            named.add((other.quantity, other.side))
    if heading.quantity in ("voltage", "current", "power") and any(side == "lower" for _, side in named):
        return heading.name  # one supply for both rotors
    if heading.quantity == "voltage":
        return heading.name
    side = "lower" if (heading.quantity, "upper") in named else "upper"
    return f"{side}_{heading.name}"


def _recognised(index: int, text: str) -> Heading | None:
    try:
        return recognise(index, text)
    except UnknownUnitError:
        return None


def _preferred(table: TextTable, headings: list[Heading]) -> Heading:
    """Of several columns for one quantity: not all zero first, then SI, then the later (optical) one."""

    def rank(heading: Heading) -> tuple[bool, bool, int]:
        values = table.numbers_or_none(heading.index)
        return values is not None and bool(np.any(values)), heading.scale == 1.0, heading.index

    return max(headings, key=rank) if len(headings) > 1 else headings[0]


def _context(table: TextTable, used: set[int], notes: list[str]) -> dict[str, NDArray[np.float64]]:
    """Further numeric columns under their own headings; what cannot matter is left out, and said."""
    columns, left = {}, []
    for i, text in enumerate(table.headings):
        if i in used or not text or table.column_is_empty(i):
            continue
        values = None if is_derived(text) else table.numbers_or_none(i)
        if values is None and not is_derived(text) and _OWN_STYLE.fullmatch(text):
            values = table.numbers(i)  # written by our hand: what is wrong in it must be said
        if values is None or (not np.any(values) and not _OWN_STYLE.fullmatch(text)):
            left.append(text)
        else:
            columns[text] = values
    if left:
        notes.append(f"left out (sums, efficiencies, text or all zero): {', '.join(left)}")
    return columns


def _without_dead_sensors(samples: Samples) -> Samples:
    """Without a speed column that reads zero while its rotor is driven: no sensor was connected."""
    for side in ("upper", "lower"):
        rpm, throttle = f"{side}_rpm", f"{side}_throttle"
        if samples.has(rpm, throttle) and not np.any(samples[rpm]) and np.any(samples[throttle] > 0):
            left = {name: column for name, column in samples.columns.items() if name != rpm}
            note = f"{rpm} left out: zero throughout while the motor is driven, no speed sensor"
            samples = replace(samples, columns=left).with_notes(note)
    return samples


def _turning(samples: Samples) -> Samples:
    """Without the rows in which no commanded rotor turns; the load cells' mean there goes into the notes."""
    turning = np.zeros(samples.rows, bool)
    known = False
    for side in ("upper", "lower"):
        on = np.ones(samples.rows, bool)
        for name in (f"{side}_rpm", f"{side}_throttle"):
            if samples.has(name):
                known = True
                on &= samples[name] > 0
        if samples.has(f"{side}_rpm") or samples.has(f"{side}_throttle"):
            turning |= on
    if not known or turning.all():
        return samples
    idle = samples.take(~turning)
    places = [idle.place(i) for i in range(idle.rows)]
    shown = ", ".join(places[:6]) + (f" and {len(places) - 6} more" if len(places) > 6 else "")
    read = ", ".join(
        f"{name} {np.median(idle[name]):.3g}"
        for name in idle.columns
        if name.endswith(("thrust_N", "torque_Nm"))
    )
    note = f"{idle.rows} of {samples.rows} rows dropped, motors off ({shown}); they read {read}"
    return samples.take(turning).with_notes(note)


def _positive(samples: Samples) -> Samples:
    """Thrusts and torques positive while their rotor works: stands differ in the sign they give."""
    for side in ("upper", "lower"):
        effort = next((f"{side}_{w}" for w in ("rpm", "throttle") if samples.has(f"{side}_{w}")), None)
        for name in (f"{side}_thrust_N", f"{side}_torque_Nm"):
            if effort is None or not samples.has(name) or samples[name] @ samples[effort] ** 2 >= 0:
                continue
            samples = samples.with_columns(**{name: -samples[name]}).with_notes(f"sign of {name} turned")
    return samples


def _check(samples: Samples, table: TextTable) -> None:
    if not any(samples.has(f"{s}_{w}") for s in ("upper", "lower") for w in ("rpm", "throttle")):
        expected = "expected upper_rpm and lower_rpm, upper_throttle and lower_throttle, or headings to map"
        found = ", ".join(table.headings[:8])
        raise InputError(table.source, "line 1", f"no speed column: {expected} (found {found})")
    if not samples.rows:
        raise InputError(table.source, "", "no rows in which a motor turns")
    for side in ("upper", "lower"):
        name = f"{side}_throttle"
        if samples.has(name) and not ((samples[name] >= 0) & (samples[name] <= 1)).all():
            row = int(np.argmax((samples[name] < 0) | (samples[name] > 1)))
            problem = f"0..1 is expected, found {samples[name][row]:g} (--columns can scale percent by 0.01)"
            raise InputError(table.source, f"{samples.place(row)}, column {name}", problem)
