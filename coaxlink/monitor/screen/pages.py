"""The pages of the screen: split, error over time, parameters, messages, health. They compute nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Grid, Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.widgets import Static

from coaxlink.monitor.screen import words
from coaxlink.monitor.screen.history import History, Window
from coaxlink.monitor.screen.marks import DIM, GOOD, STALE, clock, seconds
from coaxlink.monitor.screen.plots import ErrorPlots, SplitPlots, SuspicionPlot
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.rotors import ArmView

_COLUMN = 16, 13  # cells of a parameter's name and of its number


@dataclass(frozen=True)
class Picture:
    """All that is shown at one moment."""

    view: Moment
    history: History
    window: Window
    day: datetime | None  # the time of day of `view`; None in a replay

    @property
    def plot_range(self) -> str:
        """What a plot's time axis means, and whether it stands still."""
        window = self.window
        span = seconds(window.span_s)
        if window.back_s > 0:
            return f"{span}, up to {clock(self.history.range_s(window)[1])}"
        if words.speeds_old(self.view):
            return f"the last {span} before it fell silent{STALE}"
        return f"the last {span}"


def put(widget: Static, text: Text) -> None:
    """Show `text`; what has not changed is not drawn again."""
    if getattr(widget, "shown", None) != text:
        widget.shown = text  # type: ignore[attr-defined]
        widget.update(text)


class ArmPanel(Static):
    """One arm; its border carries name, ESC readings and split."""

    def show(self, arm: ArmView, stale: bool, escs_stale: bool) -> None:
        """Draw `arm`."""
        self.border_title = Content.from_rich_text(words.arm_title(arm, escs_stale))
        room = max(self.content_size.width, 24)
        self.border_subtitle = Content.from_rich_text(words.arm_split(arm, stale, room))
        put(self, words.arm_body(arm, room, stale))


class SplitPage(Vertical):
    """Arms, balance, vehicle, table, and the split over time."""

    def __init__(self, arms: Sequence[ArmView]) -> None:
        super().__init__(id="split")
        self._arms = arms

    def compose(self) -> ComposeResult:
        yield Grid(*(ArmPanel(id=f"arm{k}") for k in range(len(self._arms))), id="arms")
        with Horizontal(id="info"):
            for name, title in (("balance", "balance"), ("vehicle", "vehicle"), ("board", "table on board")):
                panel = Static(id=name)
                panel.border_title = title
                yield panel
        yield SplitPlots(self._arms)

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        view = picture.view
        stale = words.speeds_old(view)
        for k, arm in enumerate(view.arms):
            self.query_one(f"#arm{k}", ArmPanel).show(arm, stale, view.escs_stale or stale)
        put(self.query_one("#balance", Static), words.balance(view))
        put(self.query_one("#vehicle", Static), words.vehicle(view))
        put(self.query_one("#board", Static), words.board(view))
        self.query_one("#balance").border_subtitle = Content.from_rich_text(words.weight_and_split(view))
        self.query_one("#vehicle").border_subtitle = Content.from_rich_text(words.speeds_source(view))
        self.query_one(SplitPlots).draw(
            view.arms, picture.history, picture.window, picture.plot_range, mark=STALE if stale else ""
        )


class ErrorPage(Vertical):
    """The allocation error over time."""

    def compose(self) -> ComposeResult:
        yield ErrorPlots()

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        meant = "the demand" if picture.view.balance.basis == "demand" else "what the table means"
        text = Text(f"allocation error: the rotors' wrench less {meant}, {picture.plot_range}")
        if not any(p.error is not None for p in picture.history.inside(picture.window)):
            text = Text("no allocation error in this window", DIM)
        self.query_one(ErrorPlots).draw(picture.history, picture.window, text)


class ParametersPage(VerticalScroll):
    """The mixer table on board, parameter by parameter, and the command that writes another."""

    def compose(self) -> ComposeResult:
        yield Static(id="table")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        self.border_title = "parameters of the table on board"
        put(self.query_one("#table", Static), parameter_words(picture.view, self.content_size.width))


class MessagesPage(VerticalScroll):
    """What the autopilot reported."""

    def compose(self) -> ComposeResult:
        yield Static(id="said")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        self.border_title = "messages of the autopilot, newest first"
        self.border_subtitle = "vehicle's clock, time of day" if picture.day else "vehicle's clock"
        put(self.query_one("#said", Static), words.reported(picture.view, picture.day))


class HealthPage(Vertical):
    """A line a rotor, and how likely it is that the most suspected one lost thrust."""

    def compose(self) -> ComposeResult:
        yield Static(id="rotors")
        yield SuspicionPlot()

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        view, rotors = picture.view, self.query_one("#rotors", Static)
        rotors.border_title = "rotors' health in the air"
        rotors.border_subtitle = Content.from_rich_text(words.health_words(view))
        put(rotors, words.rotor_table(view, stale=words.speeds_old(view)))
        what = "probability that the most suspected rotor lost thrust, flagged at 95 %"
        self.query_one(SuspicionPlot).draw(picture.history, picture.window, Text(what))


def parameter_words(view: Moment, width: int) -> Text:
    """Names and numbers in as many columns as fit, and how another table gets on board."""
    lines = [
        Text("to compare another table, and without --dry-run to back up and write it:"),
        Text(f"  coaxlink upload TABLE --connect {view.link.address} --dry-run", GOOD),
        Text("leave this screen first (q) where the line is for one program", DIM),
        Text(),
    ]
    name_cells, number_cells = _COLUMN
    cells = [f"{n:<{name_cells}}{v:>{number_cells}.7g}" for n, v in view.parameters.items()]
    if not cells:
        return Text("\n").join([*lines, Text("none of them was read yet", DIM)])
    columns = max((width + 3) // (name_cells + number_cells + 3), 1)
    rows = -(-len(cells) // columns)
    lines += [Text("   ".join(cells[row::rows])) for row in range(rows)]
    return Text("\n").join(lines)
