"""Text of strangers (files, vehicles, paths) that is to stand in one field of one line, and nowhere else.

Plain is what prints: letters, marks, digits, symbols, blanks. Not plain are line breaks of every kind,
terminal controls, marks that turn the direction of writing, halves of surrogate pairs, and characters without
a meaning (Unicode categories C*, Zl and Zp).
"""

from __future__ import annotations

import re
import unicodedata

LINE = 1000  # characters of a line of talk; a path has 4096 at most, and its ends say enough
NAME = 80  # characters of a name
PARAMETER = re.compile(r"[A-Za-z0-9_]{1,16}", re.ASCII)  # MAVLink's param_id has 16 bytes


def is_plain(character: str) -> bool:
    """Whether a character may stand in a name."""
    return character.isprintable() or unicodedata.category(character) == "Zs"


def plain(text: str, limit: int = LINE) -> str:
    """`text` on one line, what is not plain as Python would write it (`\\x1b`); its middle cut out beyond
    `limit` characters."""
    if len(text) > limit:
        text = f"{text[: 2 * limit // 3]} ... {text[len(text) - limit // 4 :]}"
    if text.isprintable():
        return text
    return "".join(_shown(c) for c in text)


def plain_lines(text: str, limit: int = 10 * LINE) -> str:
    """Text of several lines, each plain; only `\\n` parts them."""
    return "\n".join(plain(line, limit) for line in text.split("\n"))


def _shown(c: str) -> str:
    if not is_plain(c):
        return c.encode("unicode_escape").decode("ascii")
    return c if c.isprintable() else " "


def name_problem(text: str, longest: int = NAME) -> str:
    """What is wrong with a name, in words; empty when nothing is."""
    if len(text) > longest:
        return f"at most {longest} characters are expected, found {len(text)}"
    strange = next((c for c in text if not is_plain(c)), None)
    if strange is not None:
        return f"one line of printable text is expected, found '{plain(text, 60)}'"
    return ""


def is_parameter_name(name: str) -> bool:
    """Whether an autopilot can have a parameter of this name."""
    return PARAMETER.fullmatch(name) is not None
