"""The help of the screen: keys, and what the numbers are."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from coaxlink.monitor.screen.marks import LOWER, UPPER
from coaxlink.monitor.screen.themes import Palette, dress

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
    ("p  s  t  q", "pause the picture, save it as SVG, theme, quit"),
    ("← → end", "plots: earlier, later, now"),
    ("+ -", "plots: shorter, longer time (the mouse wheel too)"),
    ("ctrl+p", "all of this by name"),
)
_REPLAY = (
    ("space  [ ]", "replay: stop or go on, slower, faster"),
    (", .  < >", "replay: 10 s back, on; 1 min back, on"),
    ("g", "replay: go to a time"),
)


class Help(ModalScreen[None]):
    """The keys and what the numbers are."""

    BINDINGS: ClassVar[list[BindingType]] = [("escape,question_mark,q,enter,space", "dismiss", "Close")]

    def __init__(self, palette: Palette, *, replay: bool = False) -> None:
        super().__init__()
        self._palette, self._keys = palette, (*_KEYS, *(_REPLAY if replay else ()))

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
        with VerticalScroll(id="help"):
            yield Static(dress(text, self._palette))
