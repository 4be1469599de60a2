"""Asks for a place in a recording."""

from __future__ import annotations

import math
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.screen import ModalScreen
from textual.widgets import Input


def parse_time(text: str) -> float | None:
    """Seconds of `90`, `1:30` or `0:01:30`; None for what is no time.

    >>> parse_time("1:30.5")
    90.5
    """
    try:
        parts = [float(part) for part in text.strip().split(":")]
    except ValueError:
        return None
    if len(parts) > 3 or any(p < 0 or not math.isfinite(p) for p in parts):
        return None
    return sum(part * 60.0**k for k, part in enumerate(reversed(parts)))


class GoTo(ModalScreen[float | None]):
    """Gives seconds from the start, None when it was left."""

    AUTO_FOCUS = "#time"

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "dismiss", "Close")]

    def compose(self) -> ComposeResult:
        field = Input(placeholder="go to: 90, 1:30 or 0:01:30 from the start", id="time")
        field.border_title = "go to"
        yield field

    def on_input_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        to_s = parse_time(event.value)
        if to_s is None:
            self.notify("a time is expected: 90, 1:30 or 0:01:30", severity="error")
        else:
            self.dismiss(to_s)
