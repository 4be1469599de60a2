"""What a foreign heading means: quantity, rotor, unit. "Thrust Left [g]" is upper_thrust_N times 0.00980665.

Known: the coaxial platform of Buzzatto and Liarokapis (Left = upper, Right = lower), pyBEMT's data
(A = lower, B = upper) and RCbenchmark / Tyto exports of one rotor (a rotor alone counts as upper).
"""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import dataclass

G = 9.80665  # standard gravity, m/s^2: what "grams" of thrust mean

_LOAD_UNITS = {"n": 1.0, "g": G / 1e3, "gf": G / 1e3, "kg": G, "kgf": G, "lbf": 4.4482216, "ozf": 0.27801385}
_TORQUE_UNITS = {
    "nm": 1.0,
    "mnm": 1e-3,
    "nmm": 1e-3,
    "kgfm": G,
    "kgfcm": G / 100,
    "gfcm": G / 1e5,
    "lbfin": 0.11298483,
    "lbfft": 1.3558179,
    "ozfin": 0.0070615518,
}
_SPEED_UNITS = {"rpm": 1.0, "rad/s": 30 / math.pi, "hz": 60.0, "rev/s": 60.0}
_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}

# quantity: (suffix of our name, units and what one of them is in ours, the unit taken when none is written)
QUANTITIES: dict[str, tuple[str, dict[str, float], str | None]] = {
    "thrust": ("thrust_N", _LOAD_UNITS, None),
    "torque": ("torque_Nm", _TORQUE_UNITS, None),
    "speed": ("rpm", _SPEED_UNITS, "rpm"),
    "pwm": ("pwm", {"us": 1.0}, "us"),
    "throttle": ("throttle", {"%": 0.01, "1": 1.0}, None),
    "voltage": ("voltage_V", {"v": 1.0, "mv": 1e-3}, "v"),
    "current": ("current_A", {"a": 1.0, "ma": 1e-3}, "a"),
    "power": ("power_W", {"w": 1.0}, "w"),
    "time": ("time_s", _TIME_UNITS, "s"),
}
_WORDS = {
    "thrust": "thrust",
    "t": "thrust",
    "torque": "torque",
    "q": "torque",
    "speed": "speed",
    "rpm": "speed",
    "pwm": "pwm",
    "esc": "pwm",
    "throttle": "throttle",
    "voltage": "voltage",
    "current": "current",
    "power": "power",
    "p": "power",
    "time": "time",
}
_UPPER, _LOWER = {"left", "upper", "top", "b"}, {"right", "lower", "bottom", "a"}
# sums and ratios of other columns of the same row, or sensors of no rotor: they can only mislead a fit
_DERIVED = {"total", "efficiency", "mechanical", "centre", "center", "omega"}


@dataclass(frozen=True)
class Heading:
    """One recognised heading."""

    index: int  # column in the table
    text: str
    quantity: str  # key of QUANTITIES
    side: str  # upper, lower, or "" when the heading names no rotor
    unit: str  # as in QUANTITIES
    scale: float  # ours = scale * theirs
    lettered: bool = False  # the side is a letter, A or B

    @property
    def name(self) -> str:
        """Our column name."""
        suffix = QUANTITIES[self.quantity][0]
        return f"{self.side}_{suffix}" if self.side else suffix


class UnknownUnitError(ValueError):
    """A known quantity in a unit that is missing or not known; its text says which are."""


def plain(text: str) -> str:
    """Lower case, with the look-alike characters of stand software folded together (micro, dot)."""
    folded = unicodedata.normalize("NFKC", text).casefold()
    return folded.replace("μ", "u").replace("⋅", "").replace("·", "").replace("∙", "").replace("º", "")


def is_derived(text: str) -> bool:
    """Whether the column is computed from others of its row (totals, efficiencies), or of no rotor."""
    return bool(_DERIVED & set(re.findall(r"[a-z]+", plain(text))))


def recognise(index: int, text: str) -> Heading | None:
    """The meaning of a foreign heading, or None. Raises UnknownUnitError."""
    match = re.fullmatch(r"(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?", plain(text).strip())
    if match is None or is_derived(text):
        return None
    words = re.findall(r"[a-z]+", match[1])
    quantities = [_WORDS[word] for word in words if word in _WORDS]
    if not quantities or (words and words[0] in ("acc", "servo", "vibration")):
        return None
    quantity = quantities[0]
    sides = [word for word in words if word in _UPPER | _LOWER]
    side = "" if not sides else "upper" if sides[0] in _UPPER else "lower"
    return _with_unit(index, text, quantity, side, match[2], bool(sides) and len(sides[0]) == 1)


def _with_unit(
    index: int, text: str, quantity: str, side: str, written: str | None, lettered: bool
) -> Heading:
    _, units, default = QUANTITIES[quantity]
    unit = re.sub(r"[.\s*]", "", written) if written else default
    if unit not in units:
        found = f"'{written}'" if written else "none"
        raise UnknownUnitError(f"unit of a {quantity} expected ({', '.join(units)}), found {found}")
    return Heading(index, text, quantity, side, unit, units[unit], lettered)
