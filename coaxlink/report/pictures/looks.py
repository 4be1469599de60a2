"""How series of one picture are told apart: never by hue alone, so that grey print and any eyes do.

Colours are Paul Tol's bright scheme (sronpersonalpages.nl/~pault), which the usual colour blindnesses tell
apart; lines differ in dashes, points in shape and bars in hatching besides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Look:
    """One series."""

    colour: str
    dashes: Any = "-"
    marker: str = "o"
    hatch: str = ""

    @property
    def line(self) -> dict[str, Any]:
        """Of a line without points."""
        return {"color": self.colour, "ls": self.dashes}

    @property
    def points(self) -> dict[str, Any]:
        """Of points, joined or not."""
        return {"color": self.colour, "marker": self.marker}

    @property
    def bar(self) -> dict[str, Any]:
        """Of bars."""
        return {"color": self.colour, "hatch": self.hatch, "edgecolor": "white", "lw": 0.0}


LOOKS = (
    Look("#4477aa", "-", "o", ""),
    Look("#66ccee", "--", "s", "//"),
    Look("#228833", "-.", "^", "\\\\"),
    Look("#ccbb44", ":", "D", ".."),
    Look("#ee6677", (0, (5, 1)), "v", "xx"),
    Look("#aa3377", (0, (3, 1, 1, 1)), "P", "--"),
    Look("#777777", (0, (1, 1)), "X", "||"),
    Look("#222222", (0, (8, 2)), "<", "oo"),
    Look("#bb8866", (0, (5, 1, 1, 1, 1, 1)), ">", "++"),
)
DARK = (LOOKS[0], LOOKS[2], LOOKS[4], LOOKS[5])  # lines that stand out on white
# of a model: as it came, corrected, and with what was found; 12 of 100 and more apart in lightness
GIVEN, BEFORE, AFTER = Look("#7d8590", ":", "^"), Look("#e08a50", "-", "s"), Look("#174d73", "-", "o")
STATES = tuple(zip(("as given", "corrected", "with effects"), (GIVEN, BEFORE, AFTER), strict=True))
THRUST, TORQUE = Look("#174d73", "-", "o"), Look("#e08a50", "--", "s")
