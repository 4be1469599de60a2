"""Numbers, bars, marks and colours: the smallest pieces of every panel.

A number that is no longer of the present carries STALE behind it: colour alone tells nobody who cannot see
it, or prints in grey, or has set NO_COLOR. Upper and lower are blue and orange, which people with any of the
usual colour blindness tell apart (Okabe and Ito 2008, jfly.uni-koeln.de/color).
"""

from __future__ import annotations

import math

from rich.text import Text

UPPER, LOWER = "#5cc8ff", "#ffb454"
GOOD, BAD, WARN, DIM = "#7bd88f", "#ff6b6b", "#ffd866", "#8a8f98"
ARMS = ("#5cc8ff", "#ffb454", "#7bd88f", "#ff7eb6", "#c3a6ff", "#ffd866", "#6fe3d6", "#ff9e80")
NONE = "--"
STALE = "*"
_BLOCKS = " ▏▎▍▌▋▊▉"


def number(value: float | None, digits: int = 1, signed: bool = False, *, stale: bool = False) -> str:
    """A number, or `--`; never "-0.0", and short even when it is absurd; `25.0*` where it is stale."""
    if value is None or not math.isfinite(value):
        return NONE
    mark = STALE if stale else ""
    if abs(value) >= 1e5:
        return f"{value:.0e}{mark}"
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    if float(text) == 0.0 and text[0] == "-":
        text = text.replace("-", "+" if signed else "", 1)
    return text + mark


def percent(share: float | None, digits: int = 0, *, stale: bool = False) -> str:
    """A share of 0..1 as `51 %`, stale as `51* %`."""
    return NONE if share is None else f"{number(100.0 * share, digits, stale=stale)} %"


def seconds(value: float) -> str:
    """An age as a person says it."""
    if value < 10.0:
        return f"{value:.1f} s"
    return f"{value:.0f} s" if value < 120.0 else f"{value / 60.0:.0f} min"


def clock(time_s: float | None) -> str:
    """A time since boot or since the start of a log, as `12:34.5`."""
    if time_s is None or not math.isfinite(time_s):
        return NONE
    tenths = round(10.0 * time_s)
    sign, tenths = ("-", -tenths) if tenths < 0 else ("", tenths)
    minutes, rest = divmod(tenths, 600)
    hours, minutes = divmod(minutes, 60)
    ahead = f"{hours}:{minutes:02d}" if hours else f"{minutes}"
    return f"{sign}{ahead}:{rest / 10:04.1f}"


def bar(fraction: float | None, width: int, style: str) -> Text:
    """A bar of `width` cells, in eighths of a cell; what is beyond 0..1 stops at the edge."""
    if fraction is None:
        return Text("·" * width, DIM)
    eighths = round(min(max(fraction, 0.0), 1.0) * 8 * width)
    full, part = divmod(eighths, 8)
    text = "█" * full + (_BLOCKS[part] if part else "")
    return Text.assemble((text, style), ("·" * (width - len(text)), f"{DIM} dim"))


def overlaid(text: Text, word: str, style: str) -> Text:
    """`text` with `word` over its end; where it is too long for that, as much of it as fits."""
    word = word[: len(text)]
    return Text.assemble(text[: len(text) - len(word)], (word, style))
