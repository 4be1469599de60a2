"""The pages of the screen that only show: split, error over time, health, messages. They compute nothing."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Grid, Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.events import MouseScrollDown, MouseScrollUp
from textual.message import Message
from textual.widgets import Static

from coaxlink.monitor.screen import format as words
from coaxlink.monitor.screen import health, plots
from coaxlink.monitor.screen.history import History, Window
from coaxlink.monitor.screen.marks import STALE, clock, seconds
from coaxlink.monitor.screen.themes import Palette, dress
from coaxlink.monitor.state import ArmView, View

_FEW = 10  # points of a plot that is drawn at every look


@dataclass(frozen=True)
class Picture:
    """All that is shown at one moment."""

    view: View
    history: History
    window: Window
    palette: Palette
    day: datetime | None  # the time of day of `view`; None in a replay

    def content(self, text: Text) -> Content:
        """`text` in the theme's colours, for a border."""
        return Content.from_rich_text(dress(text, self.palette))

    @property
    def plot_range(self) -> Text:
        """What a plot's time axis means, and whether it stands still."""
        window = self.window
        span = f"{seconds(window.span_s)} of the vehicle's clock"
        if window.back_s > 0:
            return Text(f"{span}, up to {clock(self.history.range_s(window)[1])}")
        if words.speeds_old(self.view):
            return Text(f"the last {span} before it fell silent{STALE}")
        return Text(f"the last {span}")


def put(widget: Static, text: Text, palette: Palette) -> None:
    """Show `text` in the theme's colours; what has not changed is not drawn again."""
    shown = dress(text, palette)
    if getattr(widget, "shown", None) != shown:
        widget.shown = shown  # type: ignore[attr-defined]
        widget.update(shown)


class Zoomed(Message):
    """The mouse wheel was turned over a plot."""

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor


class Plot(Static):
    """A plot that the mouse wheel zooms."""

    def on_mouse_scroll_up(self, event: MouseScrollUp) -> None:
        event.stop()
        self.post_message(Zoomed(0.8))

    def on_mouse_scroll_down(self, event: MouseScrollDown) -> None:
        event.stop()
        self.post_message(Zoomed(1.25))


class ArmPanel(Static):
    """One arm; its border carries name, ESC readings and split."""

    def show(self, arm: ArmView, stale: bool, escs_stale: bool, picture: Picture) -> None:
        """Draw `arm`."""
        self.border_title = picture.content(words.arm_title(arm, escs_stale))
        self.border_subtitle = picture.content(words.arm_split(arm, stale))
        body = words.arm_body(arm, max(self.content_size.width, 24), stale)
        put(self, body, picture.palette)


class SplitPage(Vertical):
    """Arms, balance, vehicle, table, and the split over time."""

    def __init__(self, arms: int) -> None:
        super().__init__(id="split")
        self._count = arms
        self._drawn: object = None  # what the plot was last drawn for

    def compose(self) -> ComposeResult:
        yield Grid(*(ArmPanel(id=f"arm{k}") for k in range(self._count)), id="arms")
        with Horizontal(id="info"):
            yield Static(id="balance")
            yield Static(id="vehicle")
            yield Static(id="board")
        yield Plot(id="plot")

    def on_mount(self) -> None:
        for name, title in (("balance", "balance"), ("vehicle", "vehicle"), ("board", "table on board")):
            self.query_one(f"#{name}").border_title = title

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        view = picture.view
        stale = words.speeds_old(view)
        for k, arm in enumerate(view.arms):
            panel = self.query_one(f"#arm{k}", ArmPanel)
            panel.show(arm, stale, view.escs_stale or stale, picture)
        for name, text in (
            ("balance", words.balance(view)),
            ("vehicle", words.vehicle(view)),
            ("board", words.board(view)),
        ):
            put(self.query_one(f"#{name}", Static), text, picture.palette)
        self.query_one("#balance").border_subtitle = picture.content(words.weight_and_split(view))
        self.query_one("#vehicle").border_subtitle = picture.content(words.speeds_source(view))
        plot = self.query_one("#plot", Plot)
        plot.border_title = picture.content(plots.legend())
        plot.border_subtitle = picture.content(picture.plot_range)
        size = plot.content_size
        mark = STALE if stale else ""
        # a minute is 300 looks: the plot needs no new drawing for each of them, and it is the dearest part
        points = len(picture.history.points)
        end_s = int(2.0 * picture.history.points[-1].time_s) if points else 0
        drawn = (size, picture.window, mark, end_s, points < _FEW and points, id(picture.palette))
        if drawn == self._drawn:
            return
        self._drawn = drawn
        text = plots.split_plot(
            picture.history, view.arms, picture.window, size.width, size.height, mark=mark
        )
        put(plot, text, picture.palette)


class ErrorPage(Vertical):
    """The allocation error over time."""

    def compose(self) -> ComposeResult:
        yield Plot(id="errors")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        plot = self.query_one("#errors", Plot)
        meant = "the demand" if picture.view.balance.basis == "demand" else "what the table means"
        plot.border_title = f"allocation error: the rotors' wrench less {meant}"
        plot.border_subtitle = picture.content(picture.plot_range)
        size = plot.content_size
        text = plots.error_plot(picture.history, picture.window, size.width, size.height)
        put(plot, text, picture.palette)


class HealthPage(Vertical):
    """A line a rotor, and how likely it is that the most suspected one lost thrust."""

    def compose(self) -> ComposeResult:
        yield Static(id="rotors")
        yield Plot(id="suspicion")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        view = picture.view
        rotors, plot = self.query_one("#rotors", Static), self.query_one("#suspicion", Plot)
        rotors.border_title = "rotors' health in the air"
        rotors.border_subtitle = picture.content(health.health_words(view))
        put(rotors, health.rotor_table(view, stale=words.speeds_old(view)), picture.palette)
        plot.border_title = "probability that the most suspected rotor lost thrust; called at 95 %"
        plot.border_subtitle = picture.content(picture.plot_range)
        size = plot.content_size
        put(
            plot,
            health.health_plot(picture.history, picture.window, size.width, size.height),
            picture.palette,
        )


class MessagesPage(VerticalScroll):
    """What the autopilot said."""

    def compose(self) -> ComposeResult:
        yield Static(id="said")

    def draw(self, picture: Picture) -> None:
        """Show a picture."""
        self.border_title = "what the autopilot said, newest first"
        self.border_subtitle = "vehicle's clock, time of day" if picture.day else "vehicle's clock"
        put(self.query_one("#said", Static), words.said(picture.view, picture.day), picture.palette)
