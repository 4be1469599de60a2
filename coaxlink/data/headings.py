"""What a foreign heading means: quantity, rotor, unit. "Thrust Left [g]" is the thrust of 'left', in gf.

Which rotor a letter, a number or a hand stands for is not decided here: only words (upper, lower) say it.
Vocabulary: RCbenchmark and Tyto (1520, 1585, 1780, Flight Stand), the platform of Buzzatto and Liarokapis,
pyBEMT's data, spreadsheets in English and German.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from coaxlink.data.units import QUANTITIES, UNWRITTEN, Unit, find_unit, plain, unit_names

_WORDS = {
    "thrust": ("thrust", "force", "lift", "fz", "schub", "kraft", "schubkraft"),
    "torque": ("torque", "moment", "trq", "mz", "drehmoment"),
    "speed": ("speed", "rpm", "erpm", "omega", "rps", "drehzahl", "velocity"),
    "throttle": ("throttle", "pwm", "esc", "duty", "gas"),
    "voltage": ("voltage", "volt", "volts", "spannung"),
    "current": ("current", "amps", "strom"),
    "power": ("power", "watts", "leistung"),
    "time": ("time", "timestamp", "zeit"),
}
_QUANTITY = {word: quantity for quantity, words in _WORDS.items() for word in words}
# symbols count only alone and with a unit of theirs, or with none: "T (C)" is no thrust
_SYMBOLS = {"t": ("thrust", "time"), "f": ("thrust",), "q": ("torque",), "n": ("speed",), "p": ("power",)}
_SYMBOLS |= {"i": ("current",), "u": ("voltage",), "v": ("voltage",)}
_UPPER = {"upper", "top", "upr", "oben", "obere", "oberer", "oberes"}
_LOWER = {"lower", "bottom", "lwr", "btm", "unten", "untere", "unterer", "unteres"}
_LABELS = {"left", "right", "front", "rear", "back", "first", "second", "one", "two", "cw", "ccw"}
_LETTERS = {"a", "b", "c", "d", "l", "r", "u"}
# sums and ratios of other columns of the same row, statistics: they can only mislead a fit
_DERIVED = {
    *("total", "sum", "net", "efficiency", "centre", "center", "ratio", "coefficient", "coeff", "loading"),
    *(
        "per",
        "std",
        "stdev",
        "min",
        "max",
        "error",
        "raw",
        "tare",
        "gesamt",
        "combined",
        "average",
        "settling",
    ),
}
# what a pulse in microseconds may be called: nothing else on a stand is counted in them but stamps of time
_PULSE = {"signal", "pulse", "pulsewidth", "width", "input", "output", "motor", "powertrain", "rotor", "ppm"}
_SET_POINT = {"target", "setpoint", "cmd", "command", "commanded", "desired"}
_ELSEWHERE = {
    *("acc", "servo", "vibration", "temperature", "temp", "acceleration", "pressure", "humidity", "fx", "fy"),
    *("mx", "my", "air", "wind", "airspeed", "angle", "sound", "cell", "fuel", "flow", "message"),
}


@dataclass(frozen=True)
class Heading:
    """One recognised heading."""

    index: int  # column in the table
    text: str
    quantity: str  # key of QUANTITIES
    label: str  # the rotor as the heading calls it: upper, lower, a, left, 1; "" when it names none
    unit: Unit | None  # None when none is written
    shaft: bool = False  # mechanical power: torque times speed
    optical: bool = False

    @property
    def suffix(self) -> str:
        """Our column name without the rotor."""
        return QUANTITIES[self.quantity][0]


class UnknownUnitError(ValueError):
    """A known quantity in a unit that is not known; its text says which are."""

    def __init__(self, quantity: str, written: str) -> None:
        self.quantity = quantity
        known = ", ".join(unit_names(quantity))
        super().__init__(f"unit of a {quantity} expected ({known}), found '{written}'")


def is_derived(text: str) -> bool:
    """Whether the column is computed from others of its row (totals, efficiencies), or of no rotor."""
    return bool(_DERIVED & set(words_of(text)))


def words_of(text: str) -> list[str]:
    """Words and numbers of a heading, in its order: M1_thrustUpper is m, 1, thrust, upper."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text.replace("eRPM", "erpm"))
    return re.findall(r"[^\W\d_]+|\d+", plain(parted))


def letters_name_rotors(headings: Iterable[str]) -> bool:
    """Whether single letters behind quantities are rotors: then "Current A" is a rotor's, not amperes."""
    found = {w for text in headings for w in words_of(_without_unit(text)[0])[1:] if w in _LETTERS}
    return len(found) > 1 or "b" in found


def _without_unit(text: str) -> tuple[str, str]:
    """The heading without its last brackets, and what stands in them."""
    found = list(re.finditer(r"[\[(]\s*([^\[\]()]*?)\s*[\])]", text))
    if not found:
        return text, ""
    last = found[-1]
    return f"{text[: last.start()]} {text[last.end() :]}", last[1]


def recognise(index: int, text: str, lettered: bool = True, unit_line: str = "") -> Heading | None:
    """The meaning of a foreign heading, or None. Raises UnknownUnitError.

    `lettered`: single letters name rotors; `unit_line`: the cell of a line of units below.
    """
    name, bracketed = _without_unit(text)
    words = words_of(text if unit_line else name)
    if set(words) & (_ELSEWHERE | _DERIVED):
        return None
    quantity = next((_QUANTITY[w] for w in words if w in _QUANTITY), None)
    if quantity == "speed" and "esc" in words:
        return None
    written = unit_line or bracketed
    if quantity is None and _is_pulse(words, written):
        return _heading(index, text, "throttle", words, find_unit("throttle", "us"), lettered)
    if quantity != "throttle" and _SET_POINT & set(words):
        return None
    if quantity is None:
        return _symbol(index, text, words, written, lettered)
    if quantity == "throttle" and "speed" in words:
        quantity = "speed"
    if "throttle" in words:
        quantity = "throttle"
    unit = find_unit(quantity, written) if written else None
    if written and unit is None and set(words_of(written)) & (set(_QUANTITY) | _DERIVED):
        words, written = [*words, *words_of(written)], ""  # brackets around a word, not a unit
    if written and unit is None:
        if quantity in ("power", "time", "throttle") or "/w" in plain(written):
            return None  # horse power, dates, counts, grams a watt: of no use to a fit
        raise UnknownUnitError(quantity, written)
    if unit is None:
        unit, words = _unit_in_words(quantity, words, lettered)
    return _heading(index, text, quantity, words, unit, lettered)


def _is_pulse(words: list[str], written: str) -> bool:
    """Whether a heading that names no quantity is an ESC's pulse: "Motor 1 (us)", "upper [us]"."""
    tail = words[-1:] if not written else []
    unit = find_unit("throttle", written or "".join(tail))
    if unit is None or unit.name != "us":
        return False
    rest = words[:-1] if tail else words
    named = _PULSE | _SET_POINT | _UPPER | _LOWER
    if not named & set(rest):
        return False  # a stamp of time may be called so as well
    labels = named | _LETTERS | _LABELS
    return all(word in labels or (word.isdigit() and len(word) == 1) for word in rest)


def _symbol(index: int, text: str, words: list[str], written: str, lettered: bool) -> Heading | None:
    """T_A (N), Q1, n2: a symbol with a rotor's label and a unit, in no other company."""
    if not words or words[0] not in _SYMBOLS:
        return None
    rest = words[1:]
    for quantity in _SYMBOLS[words[0]]:
        unit = find_unit(quantity, written) if written else None
        label_words = rest
        if not written and rest:
            unit, label_words = _unit_in_words(quantity, rest, lettered)
        if any(w not in _LETTERS | _LABELS | _UPPER | _LOWER and not w.isdigit() for w in label_words):
            continue
        if unit is None and (written or words[0] in "fiuvp"):
            continue
        if unit is None and quantity != "time" and plain(text)[:1] == "t" == text.strip()[:1]:
            continue  # a small t without a unit is the time
        return _heading(index, text, quantity, label_words, unit, True)
    return None


def _unit_in_words(quantity: str, words: list[str], lettered: bool) -> tuple[Unit | None, list[str]]:
    """A unit at the end of a heading without brackets (thrust_kgf, torque N m), and the words before it."""
    for count in (3, 2, 1):
        tail = words[-count:]
        if len(words) <= count - 1 or (lettered and count == 1 and tail[0] in _LETTERS):
            continue
        for joined in ("".join(tail), "/".join(tail)):
            unit = find_unit(quantity, joined)
            if unit is not None and not joined.isdigit():
                keep_word = count == 1 and tail[0] in _QUANTITY
                return unit, words if keep_word else words[:-count]
    if quantity == "speed":
        for word in ("rpm", "erpm", "rps"):
            if word in words:
                return find_unit("speed", word), words
    return None, words


def _heading(
    index: int, text: str, quantity: str, words: list[str], unit: Unit | None, lettered: bool
) -> Heading:
    if unit is None and quantity in UNWRITTEN:
        unit = find_unit(quantity, UNWRITTEN[quantity])
    if unit is not None and unit.name == "rpm" and "erpm" in words:
        unit = find_unit("speed", "erpm")
    label = ""
    for word in words:
        if word in _UPPER | _LOWER:
            label = "upper" if word in _UPPER else "lower"
            break
        if word in _LABELS or (lettered and word in _LETTERS) or (word.isdigit() and len(word) == 1):
            label = label or word
    shaft = quantity == "power" and bool({"mechanical", "mech", "shaft"} & set(words))
    return Heading(index, text, quantity, label, unit, shaft, "optical" in words)
