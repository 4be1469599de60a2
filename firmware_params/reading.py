"""Parameters of either autopilot from whatever text or packed file holds them, recognised by content.

| form | rows |
|---|---|
| QGroundControl's, of either autopilot | `system component NAME VALUE TYPE`, between tabs or blanks |
| Mission Planner, MAVProxy, mavros, spreadsheets | `NAME`, a comma, semicolon, `=`, tab, blanks, `VALUE` |
| `ulog_params` | `NAME,value` or `NAME,first,later,...`, `timestamp,...` rows between |
| `param show` of PX4's shell | `x + NAME [3,17] : VALUE` among other lines |
| PX4 airframe files | `param set-default NAME VALUE`, `param set NAME VALUE` among other lines |
| ArduPilot's `@PARAM/param.pck` | packed, see `ardupilot.packed` |

Comments (`#`, `//`) may follow a value. Text is UTF-8, UTF-16 or Latin-1, with or without a mark, and its
lines end in any way. ArduPilot's `@include FILE` is followed within the file's own folder. Integers that a
tool took for floats (their bits are subnormal) are read as what they are.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from firmware_params import ardupilot, bounded, px4
from firmware_params.ardupilot import packed
from firmware_params.bounded import DIGITS, lines_of
from firmware_params.errors import ParamsFileError, TableError
from firmware_params.parameters import FLOAT, INT32
from firmware_params.plain import is_parameter_name, plain
from firmware_params.text import number

PX4, ARDUPILOT = "px4", "ardupilot"
_INTEGER = re.compile(r"[+-]?[0-9]+")
_RANGES = {1: (0, 2**8), 2: (-(2**7), 2**7), 3: (0, 2**16), 4: (-(2**15), 2**15), 5: (0, 2**32)}
_RANGES |= {6: (-(2**31), 2**31), 7: (0, 2**63), 8: (-(2**63), 2**63)}  # no autopilot has one of 64 bits
_SMALLEST = 2.0**-126  # of a normal float32: below it are the bits of an integer
_PROMPT = re.compile(r"^[A-Za-z][\w .-]{0,30}> ?")
_NAME = r"([A-Z][A-Z0-9_]{0,15})"
_SHOWN = re.compile(rf"^[x ]? ?[+* ]? *{_NAME} \[\d+,\d+\] *: *(\S+)")  # px4 systemcmds/param
_SET = re.compile(rf"^param\s+set(?:-default)?(?:\s+-s)?\s+{_NAME}\s+(\S+)")
_ROW = re.compile(rf"^{_NAME}(\s*[,;=:]\s*|\s+)(.*)$")
_QGC = re.compile(r"^\s*\d+\s+\d+\s+\S+\s+\S+\s+\d+\s*$")
_INCLUDE = re.compile(r"@include\s+(\S.*)", re.IGNORECASE)
_INCLUDES = 8  # files in files, judgement: one that includes itself has no end
_COMMENT = re.compile(r"\s*(?:#|//).*$")
_HEADING = ("NAME", "PARAM", "PARAMETER", "COMMAND")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # of a copied terminal
_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_NUMERIC = re.compile(r"[+-]?(\.?\d|nan|inf)", re.IGNORECASE)
_WHOLE_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|\.\d+)(e[+-]?\d+)?|nan|[+-]?inf", re.IGNORECASE)
_DIGITS = re.compile(r"\d+(?:[eE][+-]?\d+)?")
_TELLS = {
    PX4: re.compile(r"CA_AIRFRAME|CA_ROTOR.*|CA_METHOD|SYS_AUTOSTART"),
    ARDUPILOT: re.compile(r"(Q_)?FRAME_CLASS|FRAME|SYSID_THISMAV|MAV_SYSID"),
}
_USUAL = {
    PX4: re.compile(r"(MC|MPC|EKF2|COM|CAL|SYS|PWM|UAVCAN|NAV|SENS|SDLOG|CBRK|BAT1|THR_MDL)_.*"),
    ARDUPILOT: re.compile(
        r"(MOT|ATC|SCR|CXL|ARMING|INS|BATT|EK3|PSC|WPNAV|Q|FS|LOG|COMPASS|AHRS|SERVO\d+)_.*"
    ),
}


@dataclass(frozen=True)
class ParamsFile:
    """Contents of one file, in its order; ArduPilot's values are floats, PX4's integers int."""

    params: dict[str, float | int]
    firmware: str = ""  # px4 or ardupilot; "" where no name of the file tells
    types: dict[str, int] = field(default_factory=dict)  # MAV_PARAM_TYPE by name, where it is known
    header: tuple[str, ...] = ()  # comment lines without '#'
    notes: tuple[str, ...] = ()  # what was assumed in reading it, in words
    system: int = 0  # whose they are, where it was asked for and the file says it line by line


@dataclass(frozen=True)
class _Row:
    line: int
    name: str
    shown: str
    type: int = 0  # 0 where the file does not state it
    address: tuple[int, int] = (1, 1)


def read_params(
    path: Path, *, finite: bool = True, system: int | None = None, includes: int = _INCLUDES
) -> ParamsFile:
    """Read a file of any form of the module's table, and what it includes, `includes` files deep.

    Raises ParamsFileError naming the line, also for a name with two values and, unless `finite` is False,
    for a NaN.

    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "x8.param"
    >>> _ = file.write_text("FRAME_CLASS,4  # octa-quad\\nFRAME_TYPE 1\\n")
    >>> read = read_params(file)
    >>> read.firmware, read.params
    ('ardupilot', {'FRAME_CLASS': 4.0, 'FRAME_TYPE': 1.0})
    """
    try:
        data = bounded.read_bytes(path)
        if struct.unpack("<H", data[:2].ljust(2, b"\0"))[0] in (packed.MAGIC, packed.MAGIC_DEFAULTS):
            found = packed.unpack(data)
            return ParamsFile(
                {n: v for n, (v, _) in found.items()}, ARDUPILOT, {n: t for n, (_, t) in found.items()}
            )
        text = decoded(data)
    except OSError as error:
        raise ParamsFileError(path, 0, f"cannot be read ({error.strerror})") from error
    except (bounded.Unreadable, TableError) as error:
        raise ParamsFileError(path, 0, str(error)) from error
    text = _COLOUR.sub("", text)
    lines = list(lines_of(text if "\n" in text else text.replace("\r", "\n")))
    header = tuple(plain(line.lstrip()[1:].strip()) for _, line in lines if line.lstrip().startswith("#"))
    body = [(n, line) for n, line in lines if line.strip() and not line.lstrip().startswith("#")]
    rows, notes = _rows(path, body, includes)
    if not rows:
        problem = "no parameters: lines NAME,VALUE, or 'system component NAME VALUE TYPE', are expected"
        raise ParamsFileError(path, 0, "; ".join([problem, *notes]))
    loose = {row.name for row in rows if row.type < 0}
    rows, notes, own = _one_vehicle(path, rows, notes, system)
    firmware = firmware_of(path, [row.name for row in rows], header)
    params: dict[str, float | int] = {}
    types: dict[str, int] = {}
    for row in rows:
        value, kind = _value(path, row, firmware, finite)
        if row.name in params and params[row.name] != value and row.name not in loose:
            raise ParamsFileError(path, row.line, f"{row.name} stands twice")
        params[row.name] = value
        if kind:
            types[row.name] = kind
    return ParamsFile(params, firmware, types, header, tuple(notes), own)


def decoded(data: bytes) -> str:
    """Text of a file in UTF-8, UTF-16 or Latin-1. Raises bounded.Unreadable for what is none of these."""
    head = data[:200]
    odd, even = head[1::2].count(0), head[::2].count(0)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        encoding = (
            "utf-16-le" if 3 * odd > len(head) else "utf-16-be" if 3 * even > len(head) else "utf-8-sig"
        )
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8-sig" or any(byte < 9 for byte in data):
            raise bounded.Unreadable(f"byte {error.start}", "not text (UTF-8 expected)") from error
        text = data.decode("latin-1")
    if "\0" in text:
        raise bounded.Unreadable(f"character {text.index(chr(0))}", "not text (UTF-8 expected)")
    return text


def _rows(path: Path, lines: list[tuple[int, str]], includes: int) -> tuple[list[_Row], list[str]]:
    """The rows of whichever form the lines have. Raises ParamsFileError."""
    plain_lines = [(n, _PROMPT.sub("", line)) for n, line in lines]
    if any(_QGC.match(line) or line.count("\t") == 4 for _, line in lines[:50]):
        return [_qgc(path, n, line) for n, line in lines], []
    if shown := [(n, m) for n, line in plain_lines if (m := _SHOWN.match(line.rstrip()))]:
        note = "PX4's shell shows four decimals of a float: what is finer stands elsewhere"
        return [_Row(n, m[1], m[2]) for n, m in shown], [note]
    if any(_SET.match(line.strip()) for _, line in plain_lines):
        return _script(plain_lines)
    added: list[_Row] = []
    left: list[str] = []
    for n, line in plain_lines:
        if line.lstrip().startswith("@"):
            found, note = _included(path, n, _COMMENT.sub("", line).strip(), includes)
            added, left = [*added, *found], [*left, note]
    rows, notes = _list(path, lines, plain_lines)
    return sorted([*added, *rows], key=lambda row: row.line), [*left, *notes]


def _included(path: Path, n: int, line: str, includes: int) -> tuple[list[_Row], str]:
    """What ArduPilot's `@include FILE` in line n adds: its rows, which others may replace, and in words.

    Raises ParamsFileError, for what is read and is wrong.
    """
    found = _INCLUDE.fullmatch(line)
    named = path.parent / found[1].strip("\"'") if found else None
    inside = named is not None and named.resolve().is_relative_to(path.parent.resolve())
    if named is None or not inside or not named.is_file():
        lacks = " (it is not beside this file)" if found else ""
        shown = plain(line, 40)
        return [], f"line {n}: '{shown}' was not followed{lacks}: what it adds or changes is not known"
    if not includes:
        raise ParamsFileError(path, n, f"'{plain(line, 40)}': {_INCLUDES} files in one another are too many")
    read = read_params(named, finite=False, includes=includes - 1)
    rows = [_Row(n, name, repr(value), -1) for name, value in read.params.items()]
    return rows, "; ".join([f"line {n}: {plain(found[1], 40)} was read too" if found else "", *read.notes])


def _script(lines: list[tuple[int, str]]) -> tuple[list[_Row], list[str]]:
    """PX4's airframe file: what it sets in any case; the last one of a name holds."""
    rows, left, depth = [], [], 0
    for n, line in lines:
        word = line.strip().split(" ", 1)[0]
        depth += (word == "if") - (word == "fi")
        if match := _SET.match(line.strip()):
            if depth > 0:
                left.append(match[1])
            else:
                rows.append(_Row(n, match[1], match[2].strip("\"'"), -1))
    note = f"set on a condition, and left out: {', '.join(dict.fromkeys(left))}"
    return rows, [note] if left else []


def _qgc(path: Path, n: int, line: str) -> _Row:
    fields = [f.strip() for f in line.split("\t")] if "\t" in line else line.split()
    if len(fields) != 5:
        problem = (
            f"5 tab-separated fields are expected (system, component, NAME, VALUE, TYPE), found {len(fields)}"
        )
        raise ParamsFileError(path, n, problem)
    try:
        system, component, kind = _integer(fields[0]), _integer(fields[1]), _integer(fields[4])
    except ValueError as error:
        raise ParamsFileError(path, n, "system, component and type must be integers") from error
    if not (0 <= system <= 255 and 0 <= component <= 255):
        problem = f"system and component of 0..255 are expected, found {system}/{component}"
        raise ParamsFileError(path, n, problem)
    if not is_parameter_name(fields[2]):
        problem = f"'{plain(fields[2], 40)}' is not a parameter name (1..16 of A-Z, a-z, 0-9, _)"
        raise ParamsFileError(path, n, problem)
    if kind not in _RANGES and kind not in (9, 10):
        problem = f"{fields[2]}: type {kind} is unknown ({INT32} = int32, {FLOAT} = float)"
        raise ParamsFileError(path, n, problem)
    return _Row(n, fields[2], fields[3], kind, (system, component))


def _list(
    path: Path, lines: list[tuple[int, str]], plain_lines: list[tuple[int, str]]
) -> tuple[list[_Row], list[str]]:
    """Lines NAME, VALUE; of several values the last one, where commas are no decimal points."""
    console = any(a[1] != b[1] for a, b in zip(lines, plain_lines, strict=True))
    split: list[tuple[int, str, list[str]]] = []
    notes: list[str] = []
    stamps = False
    for n, line in plain_lines:
        body = _COMMENT.sub("", line).replace('"', "").strip()
        if body.startswith("timestamp"):
            stamps = True
            continue
        match = _ROW.match(body)
        fields = [] if match is None else _fields(match[2], match[3])
        if console and fields and not _NUMERIC.match(fields[0]):
            continue
        if match is None or not fields:
            heading = not split and re.split(r"[,;\t ]", body)[0].upper() in _HEADING
            if console or not body or body.startswith("@") or heading:
                continue
            raise ParamsFileError(path, n, f"NAME,VALUE is expected, found '{plain(body, 40)}'")
        if not split and match[1] in _HEADING and not _NUMERIC.match(fields[0]):
            continue
        split.append((n, match[1], fields))
    commas = [(n, name, f) for n, name, f in split if not stamps and _is_comma(f)]
    dots = next((n for n, _, fields in split if any("." in f for f in fields)), 0)
    if commas and not dots:
        notes.append("decimal commas were read as decimal points")
        split = [(n, name, [",".join(f).replace(",", ".")] if _is_comma(f) else f) for n, name, f in split]
    elif not stamps and (bad := next(((n, f) for n, _, f in commas if len(f) == 1), None)):
        problem = (
            f"a decimal comma ('{bad[1][0]}'), with decimal points in line {dots}: one of both is expected"
        )
        raise ParamsFileError(path, bad[0], problem)
    later = [name for _, name, fields in split if len(fields) > 1]
    if later:
        if not stamps and not any(_TELLS[PX4].fullmatch(name) for _, name, _ in split):
            n, name, fields = next(row for row in split if len(row[2]) > 1)
            raise ParamsFileError(
                path, n, f"{name}: one value is expected, found '{plain(', '.join(fields), 40)}'"
            )
        notes.append(f"changed in the log, the last value is taken: {', '.join(later)}")
    return [_Row(n, name, fields[-1]) for n, name, fields in split], notes


def _fields(separator: str, rest: str) -> list[str]:
    """The values behind a name; what is no number behind the first is a comment, a unit, a range."""
    mark = separator.strip()
    parts = [part.split() for part in (rest.split(mark) if mark in (",", ";") else rest.split())]
    if not parts or not parts[0]:
        return []
    values = [parts[0][0]]
    for words in parts[1:]:
        if len(words) != 1 or len(parts[0]) > 1 or not _WHOLE_NUMBER.fullmatch(words[0]):
            break
        values.append(words[0])
    return values


def _is_comma(fields: list[str]) -> bool:
    """Whether a row is one number with a decimal comma, if commas are decimal points."""
    if len(fields) == 1:
        return _COMMA.fullmatch(fields[0]) is not None
    return len(fields) == 2 and bool(_INTEGER.fullmatch(fields[0]) and _DIGITS.fullmatch(fields[1]))


def _one_vehicle(
    path: Path, rows: list[_Row], notes: list[str], system: int | None
) -> tuple[list[_Row], list[str], int]:
    """The autopilot's rows (of `system`, if given), notes, its number: QGroundControl also saves gimbals.

    Raises ParamsFileError.
    """
    addresses = dict.fromkeys(row.address for row in rows)
    listed = rows[0].type > 0 and rows[0].line > 0  # an address in every line
    if len(addresses) == 1:
        own = rows[0].address[0] if listed else 0
        if own and system not in (None, own):
            raise ParamsFileError(path, rows[0].line, f"system {system} is not in it, {own} is")
        return rows, notes, own
    tells = [
        a
        for a in addresses
        if any(p.fullmatch(row.name) for row in rows if row.address == a for p in _TELLS.values())
        and system in (None, a[0])
    ]
    if len(tells) != 1:
        first = rows[0].address
        other = next(row for row in rows if row.address != first)
        problem = f"{other.address[0]}/{other.address[1]} beside {first}: one vehicle is expected (`system`)"
        raise ParamsFileError(path, other.line, problem)
    left = ", ".join(f"{s}/{c}" for s, c in addresses if (s, c) != tells[0])
    kept = [row for row in rows if row.address == tells[0]]
    return kept, [*notes, f"left out, of other components: {left}"], tells[0][0]


def firmware_of(path: Path, names: Iterable[str], header: tuple[str, ...] = ()) -> str:
    """px4, ardupilot or "", by names of parameters. Raises ParamsFileError where both speak."""
    names = set(names)
    for tells in (_TELLS, _USUAL):
        count = {firmware: sum(p.fullmatch(n) is not None for n in names) for firmware, p in tells.items()}
        px4_, ardupilot_ = count[PX4], count[ARDUPILOT]
        if tells is _TELLS and px4_ and ardupilot_:
            problem = (
                "parameters of PX4 (CA_*) and of ArduPilot (FRAME_CLASS) in one file: one vehicle is expected"
            )
            raise ParamsFileError(path, 0, problem)
        if px4_ != ardupilot_:
            return PX4 if px4_ > ardupilot_ else ARDUPILOT
    reported = " ".join(line for line in header if line.startswith(("Stack:", "Firmware:"))).lower()
    return PX4 if "px4" in reported else ARDUPILOT if "ardu" in reported else ""


def _value(path: Path, row: _Row, firmware: str, finite: bool) -> tuple[float | int, int]:
    """A row's value and MAV_PARAM_TYPE (0: not known). Raises ParamsFileError."""
    known = px4.PARAMETERS.get(row.name) if firmware != ARDUPILOT else ardupilot.PARAMETERS.get(row.name)
    whole = _INTEGER.fullmatch(row.shown) is not None
    # an ArduPilot keeps 3.7 of an int8 as 3: its own checks name that
    integer = row.type in _RANGES or (firmware != ARDUPILOT and known is not None and known.type != FLOAT)
    whole &= integer or (row.type <= 0 and firmware != ARDUPILOT)  # -0 of a float has its sign
    try:
        value: float | int = _integer(row.shown) if whole else number(row.shown)
    except ValueError as error:
        raise _wrong(path, row, "an integer is expected" if integer else str(error)) from error
    if not whole and 0.0 < abs(value) < _SMALLEST and (integer or row.type <= 0):
        value, whole = struct.unpack("<i", struct.pack("<f", value))[0], True
    if finite and not math.isfinite(value):
        raise _wrong(path, row, "a finite number is expected")
    if row.type in _RANGES:
        low, high = _RANGES[row.type]
        if value != int(value):
            raise _wrong(path, row, "an integer is expected")
        if not low <= value < high:
            raise _wrong(path, row, f"{low}..{high - 1} is expected")
        if known is not None and known.type == FLOAT:
            raise ParamsFileError(path, row.line, f"{row.name}: type {FLOAT} is expected, found {row.type}")
    elif integer and math.isfinite(value) and value != int(value):
        raise _wrong(path, row, "an integer is expected")
    if firmware == ARDUPILOT:
        return float(value), row.type if row.type > 0 else 0
    kind = known.type if known is not None else max(row.type, 0)
    if kind in _RANGES or (not kind and whole and firmware == PX4):
        return int(value), kind
    return float(value), kind


def _wrong(path: Path, row: _Row, problem: str) -> ParamsFileError:
    return ParamsFileError(path, row.line, f"{row.name}: {problem}, found '{plain(row.shown, 40)}'")


def _integer(text: str) -> int:
    if len(text) > DIGITS or not _INTEGER.fullmatch(text.strip()):
        raise ValueError("an integer is expected")
    return int(text)
