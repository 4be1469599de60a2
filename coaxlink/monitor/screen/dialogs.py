"""What opens over the pages: the help, and the question for a place in a recording."""

from __future__ import annotations

import math
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.events import Key
from textual.screen import ModalScreen
from textual.widgets import Input, Static

from coaxlink.monitor.screen.marks import LOWER, UPPER

_NUMBERS = """\
Thrust and torque are the rotor model's at the speeds that the vehicle
panel names: measured ones (ESC) before commanded ones. Under each arm its
thrust, split upper : lower, and the split of least power for this moment.
model   what the rotors make, by the rotor model
table   what the mixer table on board means by the same commands; demand:
        on PX4 up to 1.13 what its controllers ask for
error   model less table (or demand): the allocation error
*       behind a number: old, nothing newer was heard
! max   the motor's command is at the end of its range; min: in the air
"""
_KEYS = (
    ("1 2 3 4 5", "split, error over time, parameters, messages, health"),
    ("p  s  q", "pause the picture, save it as SVG, quit"),
    ("← → end", "plots: earlier, later, now"),
    ("+ -", "plots: shorter, longer time (the mouse wheel too)"),
)
_MOVING = ("up", "down", "pageup", "pagedown", "home", "end")  # the help, where it is longer than the screen
_REPLAY = (
    ("space  [ ]", "replay: stop or go on, slower, faster"),
    (", .  < >", "replay: 10 s back, on; 1 min back, on"),
    ("g", "replay: go to a time"),
)


class Help(ModalScreen[None]):
    """The keys and what the numbers are; any key closes it."""

    def __init__(self, *, replay: bool = False) -> None:
        super().__init__()
        self._keys = (*_KEYS, *(_REPLAY if replay else ()))

    def compose(self) -> ComposeResult:
        text = Text.assemble(
            ("coaxlink monitor", "bold"),
            "  ",
            ("▲ upper", UPPER),
            "  ",
            ("▼ lower", LOWER),
            "\n\n",
            _NUMBERS,
        )
        for key, what in self._keys:
            text.append_text(Text.assemble("\n", (f"{key:<12}", "bold"), what))
        text.append("\n\nany key closes this (the arrows and Page Up, Down move it)", "bold")
        with VerticalScroll(id="help"):
            yield Static(text)

    def on_key(self, event: Key) -> None:
        """Close, but for keys that move the text, and give the key to nobody else."""
        if event.key not in _MOVING:
            event.stop()
            event.prevent_default()
            self.dismiss()


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
