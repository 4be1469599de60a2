"""What a foreign heading means: quantity, rotor, unit. "Thrust Left [g]" is the thrust of 'left', in gf.

Which rotor a letter, a number or a hand is, is not decided here: only words (upper, lower) say it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from coaxlink.data import aliases
from coaxlink.data.aliases import QUANTITIES, QUANTITY_OF, Unit, find_unit, plain, unit_names, words_of
from coaxlink.data.table import TextTable
from coaxlink.errors import InputError


@dataclass(frozen=True)
class Heading:
    """One recognised heading."""

    index: int  # column in the table
    text: str
    quantity: str  # key of QUANTITIES
    label: str  # the rotor as the heading calls it: upper, lower, a, left, 1, PAIR; "" when it names none
    unit: Unit | None  # None when none is written
    problem: InputError | None = None  # its unit is not known
    shaft: bool = False  # mechanical power: torque times speed
    optical: bool = False

    @property
    def suffix(self) -> str:
        """Our column name without the rotor."""
        return QUANTITIES[self.quantity].suffix


class UnknownUnitError(ValueError):
    """A known quantity in a unit that is not known; its text says which are."""

    def __init__(self, quantity: str, written: str) -> None:
        self.quantity = quantity
        known = ", ".join(unit_names(quantity))
        super().__init__(f"unit of a {quantity} expected ({known}), found '{written}'")


def recognised(table: TextTable, skip: Iterable[int] = ()) -> list[Heading]:
    """Every heading of a table that is understood, `skip` left alone.

    A known quantity in an unknown unit has its `problem`, with the line of a map that states it.
    """
    free = [i for i in range(len(table.headings)) if i not in skip]
    lettered = letters_name_rotors(table.headings[i] for i in free)
    found = []
    for i in free:
        text = table.headings[i]
        if not text or table.column_is_empty(i):
            continue
        try:
            heading = recognise(i, text, lettered, table.units[i])
        except UnknownUnitError as error:
            label = _label(words_of(text), lettered)
            name = f"{label if label in aliases.SIDES else 'upper'}_{QUANTITIES[error.quantity].suffix}"
            line = line_for(name, text, unit_names(error.quantity)[0])
            problem = table.heading_error(text, f"{error}; a map states it (`columns`): {line}")
            heading = Heading(i, text, error.quantity, label, None, problem)
        if heading is not None:
            found.append(heading)
    letters = {h.label for h in found}
    names = {"u": "upper", "l": "lower"} if {"u", "l"} <= letters else {"l": "left", "r": "right"}
    return [replace(h, label=names.get(h.label, h.label)) for h in found]


def line_for(name: str, heading: str, unit: str) -> str:
    """The line of a map that states a unit."""
    return f'{name} = {{ column = "{_quoted(heading)}", unit = "{unit}" }}'


def plain_line(name: str, heading: str) -> str:
    """The line of a map that takes a column as its heading says."""
    return f'{name} = {{ column = "{_quoted(heading)}" }}'


def scale_line(name: str, heading: str, scale: float) -> str:
    """The line of a map that states a scale."""
    return f'{name} = {{ column = "{_quoted(heading)}", scale = {scale:.6g} }}'


def _quoted(heading: str) -> str:
    return heading.replace("\\", "\\\\").replace('"', '\\"')


def is_derived(text: str) -> bool:
    """Whether the column is computed from others of its row (totals, efficiencies), or of no rotor."""
    return bool(aliases.DERIVED & set(words_of(text)))


def rotor_and_unit(text: str, unit_line: str = "") -> tuple[str, str]:
    """The rotor that a heading names and the unit that it writes, "" where there is none."""
    name, written = _without_unit(text)
    return _label(words_of(name), lettered=True), unit_line or written


def letters_name_rotors(headings: Iterable[str]) -> bool:
    """Whether single letters behind quantities are rotors: then "Current A" is a rotor's, not amperes."""
    found = {w for text in headings for w in words_of(_without_unit(text)[0])[1:] if w in aliases.LETTERS}
    return len(found) > 1 or "b" in found


def recognise(index: int, text: str, lettered: bool = True, unit_line: str = "") -> Heading | None:
    """The meaning of a foreign heading, or None. Raises UnknownUnitError.

    `lettered`: single letters name rotors; `unit_line`: the cell of a line of units below.
    """
    name, bracketed = _without_unit(text)
    words = words_of(text if unit_line else name)
    if set(words) & aliases.ELSEWHERE:
        return None
    quantity = next((QUANTITY_OF[w] for w in words if w in QUANTITY_OF), None)
    if set(words) & aliases.DERIVED or _names_two(name):
        summed = set(words) & aliases.DERIVED <= aliases.SUMS and quantity in ("thrust", "torque")
        written = unit_line or bracketed
        unit = find_unit(quantity, written) if summed and quantity else None
        return Heading(index, text, quantity, aliases.PAIR, unit) if unit and quantity else None
    if quantity == "speed" and "esc" in words:
        return None
    written = unit_line or bracketed
    if quantity is None and _is_pulse(words, written):
        return _heading(index, text, "throttle", words, find_unit("throttle", "us"), lettered)
    if quantity != "throttle" and aliases.SET_POINT & set(words):
        return None
    if quantity is None:
        return _symbol(index, text, words, written, lettered)
    if quantity == "throttle" and "speed" in words:
        quantity = "speed"
    if "throttle" in words:
        quantity = "throttle"
    unit = find_unit(quantity, written) if written else None
    if written and unit is None and set(words_of(written)) & (set(QUANTITY_OF) | aliases.DERIVED):
        words, written = [*words, *words_of(written)], ""  # brackets around a word, not a unit
    if written and unit is None:
        if quantity in ("power", "time", "throttle") or "/w" in plain(written):
            return None  # horse power, dates, counts, grams a watt: of no use to a fit
        raise UnknownUnitError(quantity, written)
    if unit is None:
        unit, words = _unit_in_words(quantity, words, lettered)
    return _heading(index, text, quantity, words, unit, lettered)


def _names_two(name: str) -> bool:
    """Whether a heading names two rotors with a sign of addition between them: Thrust A + B."""
    found = re.search(r"(\w+)\s*[+&]\s*(\w+)", plain(name))
    return found is not None and all(w in aliases.ROTOR_NAMES or w.isdigit() for w in found.groups())


def _without_unit(text: str) -> tuple[str, str]:
    """The heading without its last brackets, and what stands in them."""
    found = list(re.finditer(r"[\[(]\s*([^\[\]()]*?)\s*[\])]", text))
    if not found:
        return text, ""
    last = found[-1]
    return f"{text[: last.start()]} {text[last.end() :]}", last[1]


def _is_pulse(words: list[str], written: str) -> bool:
    """Whether a heading that names no quantity is an ESC's pulse: "Motor 1 (us)", "upper [us]"."""
    tail = words[-1:] if not written else []
    unit = find_unit("throttle", written or "".join(tail))
    if unit is None or unit.name != "us":
        return False
    rest = words[:-1] if tail else words
    named = aliases.PULSE | aliases.SET_POINT | aliases.UPPER | aliases.LOWER
    if not named & set(rest):
        return False  # a stamp of time may be called so as well
    known = named | aliases.ROTOR_NAMES
    return all(word in known or (word.isdigit() and len(word) == 1) for word in rest)


def _symbol(index: int, text: str, words: list[str], written: str, lettered: bool) -> Heading | None:
    """T_A (N), Q1, n2: a symbol with a rotor's label and a unit, in no other company."""
    if not words:
        return None
    symbol, *rest = words
    for quantity in (q for q, about in QUANTITIES.items() if len(symbol) == 1 and symbol in about.symbols):
        unit = find_unit(quantity, written) if written else None
        label_words = rest
        if not written and rest:
            unit, label_words = _unit_in_words(quantity, rest, lettered)
        if not all(word in aliases.ROTOR_NAMES or word.isdigit() for word in label_words):
            continue
        if unit is None and (written or symbol in "fiuvp"):
            continue
        if unit is None and quantity != "time" and plain(text)[:1] == "t" == text.strip()[:1]:
            continue  # a small t without a unit is the time
        return _heading(index, text, quantity, label_words, unit, True)
    return None


def _unit_in_words(quantity: str, words: list[str], lettered: bool) -> tuple[Unit | None, list[str]]:
    """A unit at the end of a heading without brackets (thrust_kgf, torque N m), and the words before it."""
    for count in (3, 2, 1):
        tail = words[-count:]
        if len(words) <= count - 1 or (lettered and count == 1 and tail[0] in aliases.LETTERS):
            continue
        for joined in ("".join(tail), "/".join(tail)):
            unit = find_unit(quantity, joined)
            if unit is not None and not joined.isdigit():
                keep_word = count == 1 and tail[0] in QUANTITY_OF
                return unit, words if keep_word else words[:-count]
    if quantity == "speed":
        for word in ("rpm", "erpm", "rps"):
            if word in words:
                return find_unit("speed", word), words
    return None, words


def _heading(
    index: int, text: str, quantity: str, words: list[str], unit: Unit | None, lettered: bool
) -> Heading:
    if unit is None and QUANTITIES[quantity].unwritten:
        unit = find_unit(quantity, QUANTITIES[quantity].unwritten)
    if unit is not None and unit.name == "rpm" and "erpm" in words:
        unit = find_unit("speed", "erpm")
    label = _label(words, lettered)
    shaft = quantity == "power" and bool({"mechanical", "mech", "shaft"} & set(words))
    return Heading(index, text, quantity, label, unit, None, shaft, "optical" in words)


def _label(words: list[str], lettered: bool) -> str:
    """The rotor that the words of a heading name, "" where they name none."""
    label = ""
    for word in words:
        if word in aliases.UPPER | aliases.LOWER:
            return "upper" if word in aliases.UPPER else "lower"
        named = word in aliases.LABELS or (lettered and word in aliases.LETTERS)
        if named or (word.isdigit() and len(word) == 1):
            label = label or word
    return label
