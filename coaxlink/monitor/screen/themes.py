"""Colours of the screen by theme: dark, light, none. Panels name styles, only this module knows colours.

The pairs that must be told apart (upper and lower, good and bad) differ in lightness too, and no meaning is
told by colour alone: the theme without colour shows the same screen. Upper and lower are blue and orange,
which people with any of the usual colour blindness tell apart (Okabe and Ito 2008, jfly.uni-koeln.de/color).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.text import Span, Text
from textual.theme import Theme

Palette = Mapping[str, str]

DARK: Palette = {
    "upper": "#5cc8ff",
    "lower": "#ffb454",
    "good": "#7bd88f",
    "bad": "#ff6b6b",
    "warn": "#ffd866",
    "quiet": "#8a8f98",
    "arm0": "#5cc8ff",
    "arm1": "#ffb454",
    "arm2": "#7bd88f",
    "arm3": "#ff7eb6",
    "arm4": "#c3a6ff",
    "arm5": "#ffd866",
    "arm6": "#6fe3d6",
    "arm7": "#ff9e80",
}
LIGHT: Palette = {
    "upper": "#005f9e",
    "lower": "#a04a00",
    "good": "#1a6b2d",
    "bad": "#b00020",
    "warn": "#7a5a00",
    "quiet": "#5c6370",
    "arm0": "#005f9e",
    "arm1": "#a04a00",
    "arm2": "#1a6b2d",
    "arm3": "#a3195b",
    "arm4": "#5a3ea6",
    "arm5": "#7a5a00",
    "arm6": "#00665c",
    "arm7": "#9c3a1a",
}
NONE: Palette = {
    **dict.fromkeys(("upper", "lower", "good"), ""),
    "bad": "bold reverse",
    "warn": "bold",
    "quiet": "",
    **dict.fromkeys((f"arm{k}" for k in range(8)), ""),
}
PALETTES: Mapping[str, Palette] = {"dark": DARK, "light": LIGHT, "none": NONE}

_GREYS: dict[str, Any] = dict.fromkeys(
    ("secondary", "warning", "error", "success", "accent", "primary", "foreground"), "#d0d0d0"
)
TEXTUAL: Mapping[str, str | Theme] = {
    "dark": "textual-dark",
    "light": "textual-light",
    "none": Theme(
        name="none",
        background="#000000",
        surface="#000000",
        panel="#202020",
        dark=True,
        variables={"footer-key-foreground": "#ffffff"},
        **_GREYS,
    ),
}


def dress(text: Text, palette: Palette) -> Text:
    """A copy of `text` whose style names are the palette's colours.

    >>> dress(Text("25.0 N", "bold upper"), DARK).style
    'bold #5cc8ff'
    """
    dressed = text.copy()
    dressed.style = _style(text.style, palette)
    dressed.spans = [Span(s.start, s.end, _style(s.style, palette)) for s in text.spans]
    return dressed


def _style(style: Any, palette: Palette) -> Any:
    if not isinstance(style, str) or not style:
        return style
    return " ".join(palette.get(word, word) for word in style.split()).strip()
