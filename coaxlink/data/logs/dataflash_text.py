"""DataFlash logs as the text that Mission Planner and pymavlink make of them: one message a line.

    FMT, 133, 23, ATT, QccccCC, TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw
    ATT, 26043999, 0, 0.12, 0, -0.03, 0, 91.2

Fields stand there in the units in which pymavlink returns them from the binary log.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

from coaxlink import files
from firmware_params import bounded

_FORMAT = re.compile(r"^\ufeff?FMT, ?\d+, ?\d+, ?\w+, ?\w+", re.MULTILINE)
WORDS = frozenset("nNZa")  # format letters of what is no number


def is_dataflash_text(head: bytes) -> bool:
    """Whether a file that begins so is such a log; other lines may stand above the formats."""
    return _FORMAT.search(_text(head)) is not None


def _text(data: bytes) -> str:
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if wide else "utf-8", "replace")


class TextMessage(SimpleNamespace):
    """One message; its fields are attributes, as pymavlink has them."""

    def get_fieldnames(self) -> list[str]:
        """In the order of the log."""
        return list(vars(self))


def read_text(
    path: Path, types: Sequence[str]
) -> tuple[dict[str, list[tuple[int, TextMessage]]], list[int], bool]:
    """(line, message) of these types by name, lines after the first that tell the format of formats (another
    log was appended), and whether a line made no sense.

    A last line that was cut is no damage. Raises InputError.
    """
    found: dict[str, list[tuple[int, TextMessage]]] = {}
    begins: list[int] = []
    formats: dict[str, tuple[str, list[str]]] = {}
    odd: list[int] = []
    lines = _text(files.read_bytes(path, bounded.LOG)).splitlines()
    for number, line in enumerate(lines, 1):
        name, _, rest = line.lstrip("\ufeff").partition(",")
        if name == "FMT":
            cells = [cell.strip() for cell in rest.split(",")]
            if len(cells) > 4:
                formats[cells[2]] = cells[3], cells[4:]
            begins += [number] * (cells[2:3] == ["FMT"])
        elif name in types:
            message = _message(rest, *formats[name]) if name in formats else None
            if message is None:
                odd.append(number)
            else:
                found.setdefault(name, []).append((number, message))
    return found, begins[1:], any(number < len(lines) for number in odd)


def _message(text: str, letters: str, fields: list[str]) -> TextMessage | None:
    """A line's fields, None where they are not what its format says. A text may hold commas."""
    cells = [cell.strip() for cell in text.split(",", len(fields) - 1)]
    if len(cells) != len(fields):
        return None
    try:
        values = [c if form in WORDS else float(c) for c, form in zip(cells, letters, strict=True)]
    except ValueError:
        return None
    return TextMessage(**dict(zip(fields, values, strict=True)))
