"""Files of strangers, read within bounds: regular files of a bounded size, TOML and JSON of a bounded depth.

Whoever reads turns `Unreadable` and OSError into errors of its own.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from firmware_params.plain import name_problem

SETTINGS = 1 << 20  # bytes of a TOML file; the largest of ours, a rotor with its intervals, has 30 kB
TEXT = 16 << 20  # bytes of a parameter file, a script or a JSON file; PX4's list of parameters has 1.2 MB
LOG = 2 << 30  # bytes of a log
DEPTH = 16  # tables in tables; ours have four
KEY, STRING = 512, 4096  # characters; a path has no more
DIGITS = 20  # of an integer: 64 bits
_INT = 1 << 63
# Windows knows neither of the first two, and reads text unless told the third
_OPEN = os.O_RDONLY | sum(getattr(os, flag, 0) for flag in ("O_CLOEXEC", "O_NONBLOCK", "O_BINARY"))
_PIECE = 1 << 16
_KEY_PART = r"""(?>"[^"\n]*+"|'[^'\n]*+'|[A-Za-z0-9_-]++)[ \t]*+\.[ \t]*+"""
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?>{_KEY_PART}){{{DEPTH + 1}}}")


class Unreadable(Exception):
    """`where` in the file (line or key, may be empty) and what is wrong there."""

    def __init__(self, where: str, problem: str) -> None:
        self.where, self.problem = where, problem
        super().__init__(f"{where}: {problem}" if where else problem)


def read_bytes(path: Path | str, most: int = TEXT) -> bytes:
    """All of a regular file. Raises OSError, and Unreadable for a folder, a device, a pipe or too much."""
    _check_kind(Path(path).stat().st_mode)  # before it is opened: a serial port notices being opened
    handle = os.open(path, _OPEN)
    with os.fdopen(handle, "rb") as stream:
        about = os.fstat(handle)
        _check_kind(about.st_mode)
        data = b"" if about.st_size > most else stream.read(about.st_size + 1)
        while len(data) <= most and (more := stream.read(_PIECE)):  # it grew, or is of /proc and has no size
            data += more
    if about.st_size > most or len(data) > most:
        raise Unreadable("", f"cannot be read (more than the {_size(most)} that are expected)")
    return data


def check_regular(path: Path | str, most: int = LOG) -> None:
    """What `read_bytes` would refuse, for a library that opens the file itself."""
    about = Path(path).stat()
    _check_kind(about.st_mode)
    if about.st_size > most:
        raise Unreadable("", f"cannot be read (more than the {_size(most)} that are expected)")


def read_text(path: Path | str, most: int = TEXT) -> str:
    """A UTF-8 file without its byte order mark. Raises OSError, Unreadable."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Unreadable(f"byte {error.start}", "not text (UTF-8 expected)") from error


def lines_of(text: str) -> Iterator[tuple[int, str]]:
    """(number from 1, line). Only line feeds part lines, also where Unicode knows others: what a field
    holds must not become a line of its own."""
    for number, line in enumerate(text.split("\n"), start=1):
        yield number, line.removesuffix("\r")


def parse_toml(text: str) -> dict[str, Any]:
    """A TOML document whose strings and keys are plain. Raises Unreadable."""
    if _LONG_KEY.search(text):  # the parser takes minutes over a long one
        raise Unreadable("", f"not TOML of ours: a key of more than {DEPTH} parts")
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise Unreadable("", f"not TOML: {error}") from error
    except RecursionError:
        raise Unreadable("", f"nested deeper than the {DEPTH} levels that are expected") from None
    except ValueError:
        raise Unreadable("", f"a number of more than {DIGITS} digits or a date that is none") from None
    _check(document, strings=True)
    return document


def parse_json(text: str) -> Any:
    """A JSON document. Raises Unreadable."""
    try:
        document = json.loads(text, parse_int=_integer)
    except RecursionError:
        raise Unreadable("", f"nested deeper than the {DEPTH} levels that are expected") from None
    except ValueError as error:
        raise Unreadable("", f"not JSON: {error}") from error
    _check(document, strings=False)
    return document


def _integer(digits: str) -> int:
    if len(digits) > DIGITS:
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def _check(document: Any, *, strings: bool) -> None:
    """Depth, keys and integers of all that was read, without recursion. JSON's strings are the reader's."""
    waiting: list[tuple[str, Any, int]] = [("", document, 0)]
    while waiting:
        where, value, depth = waiting.pop()
        if depth > DEPTH:
            raise Unreadable(where[:KEY], f"nested deeper than the {DEPTH} levels that are expected")
        if isinstance(value, dict):
            for key, inside in value.items():
                if problem := name_problem(key, KEY):
                    raise Unreadable(where, f"a key: {problem}")
                waiting.append((f"{where}.{key}" if where else key, inside, depth + 1))
        elif isinstance(value, list):
            waiting += [(f"{where}[{n}]", inside, depth + 1) for n, inside in enumerate(value, start=1)]
        elif isinstance(value, int) and not -_INT <= value < _INT:
            raise Unreadable(where, "an integer of at most 64 bits is expected")
        elif strings and isinstance(value, str) and (problem := name_problem(value, STRING)):
            raise Unreadable(where, problem)


def _check_kind(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise Unreadable("", "cannot be read (a file is expected, found a folder)")
    if not stat.S_ISREG(mode):
        raise Unreadable(
            "", "cannot be read (a file is expected, found a pipe or a device: copy it to a file first)"
        )


def _size(most: int) -> str:
    return f"{most >> 30} GB" if most >= 1 << 30 else f"{most >> 20} MB" if most >= 1 << 20 else f"{most} B"
