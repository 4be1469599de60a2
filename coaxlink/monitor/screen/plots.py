"""Lines over the vehicle's clock, drawn by textual-plot: split of each arm, allocation error, suspicion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from rich.text import Text
from textual.app import ComposeResult, RenderResult
from textual.containers import Container
from textual.events import MouseScrollDown, MouseScrollUp
from textual.message import Message
from textual.widgets import Static
from textual_hires_canvas import Canvas
from textual_plot import HiResMode, PlotWidget
from textual_plot.axis_formatter import NumericAxisFormatter

from coaxlink.monitor.screen.history import History, Line, Window, errors, shares, suspicion
from coaxlink.monitor.screen.marks import ARMS, DIM, UPPER, clock, number
from coaxlink.monitor.state.rotors import ArmView

AXES = (("thrust", "N", 0.1), ("roll", "N m", 0.01), ("pitch", "N m", 0.01), ("yaw", "N m", 0.01))
_PERCENT, _NEWTONS = 6, 8  # cells of the numbers beside a plot
_STEPS = (5.0, 10.0, 25.0, 50.0)  # between the numbers beside a plot of shares, per cent
_APART = 3  # rows between two numbers
_FEW = 10  # points of a plot that is drawn at every look
Range = tuple[float, float]


class Zoomed(Message):
    """The mouse wheel was turned over a plot."""

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor


class _ClockAxis(NumericAxisFormatter):
    """Times of the vehicle's clock at both ends."""

    def get_ticks(self, min_: float, max_: float, max_ticks: int = 8) -> list[float]:
        return [min_, max_]

    def get_labels_for_ticks(self, ticks: Sequence[float]) -> list[str]:
        return [clock(t) for t in ticks]


class _NumberAxis(NumericAxisFormatter):
    """Numbers with the unit, as many decimals as their distance needs."""

    def __init__(self, unit: str = "") -> None:
        self._unit = unit

    def get_labels_for_ticks(self, ticks: Sequence[float]) -> list[str]:
        apart = abs(ticks[-1] - ticks[0]) if len(ticks) > 1 else 1.0
        digits = 0 if self._unit or apart >= 10.0 else 1 if apart >= 2.0 else 2 if apart >= 0.2 else 3
        return [f"{number(t, digits)}{self._unit}" for t in ticks]


class TimePlot(PlotWidget, can_focus=False):
    """One plot, its title on its upper edge. The wheel zooms the window of all plots, not this one."""

    def __init__(self, unit: str = "", *, numbers: int = _PERCENT, times: bool = False) -> None:
        super().__init__(allow_pan_and_zoom=False)
        self._title = Text()
        self.set_reactive(PlotWidget.margin_top, 0)
        self.set_reactive(PlotWidget.margin_left, numbers)
        self.set_reactive(PlotWidget.margin_bottom, 1 if times else 0)
        self.set_x_formatter(_ClockAxis())
        self.set_y_formatter(_NumberAxis(unit))
        self.set_xticks(None if times else [])
        self._numbers = numbers

    def show(
        self, title: str, style: str, lines: Sequence[tuple[Line, str]], span: Range, y_range: Range
    ) -> None:
        """Draw (points, style) over `span`, s of the vehicle's clock; far apart they are not joined."""
        self._title = Text(title, style)
        self.clear()
        self.set_xlimits(*span)
        self.set_ylimits(*y_range)
        (low, high), rows = y_range, max(self.content_size.height - 2, 1)
        self.set_yticks(ticks(rows, low, high) if self._numbers else [])
        half_dot = (high - low) / (8 * rows)  # what lies on the edge would be drawn below the frame
        most = 4 * max(self.content_size.width, 1)  # points: two for each column of dots
        for line, of_line in lines:
            for part in parts(line[:: max(len(line) // most, 1)], (span[1] - span[0]) / 20):
                x, y = zip(*part, strict=True)
                inside = [min(max(value, low + half_dot), high - half_dot) for value in y]
                self.plot(x, inside, of_line, HiResMode.BRAILLE)

    def render(self) -> RenderResult:
        """The library's, and the title on the upper edge."""
        drawn = super().render()
        edge = self.query_one("#plot", Canvas)
        if self._title.plain and edge.size.width > 4:
            room = edge.size.width - 4
            name = self._title.plain
            name = name if len(name) <= room else "".join(w[0] for w in name.upper().split())[:room]
            edge.write_text(1, 0, f"[{self._title.style}] {name} ")
        return drawn

    def on_mouse_scroll_up(self, event: MouseScrollUp) -> None:
        event.stop()
        self.post_message(Zoomed(0.8))

    def on_mouse_scroll_down(self, event: MouseScrollDown) -> None:
        event.stop()
        self.post_message(Zoomed(1.25))


class _Plots(Container):
    """A line of words, and plots below it; drawn again when half a second has passed, the dearest part."""

    def __init__(self, plots: Sequence[TimePlot], *, id: str) -> None:
        super().__init__(id=id)
        self.plots = plots
        self._words = Static(classes="legend")
        self._drawn: object = None

    def compose(self) -> ComposeResult:
        yield self._words
        with Container(classes="side-by-side" if len(self.plots) > 1 and self.id == "splits" else ""):
            yield from self.plots

    def due(self, words: Text, history: History, window: Window, *also: object) -> bool:
        """Show the words; whether the plots are to be drawn."""
        self._words.update(words)
        points = len(history.points)
        end_s = int(2.0 * history.points[-1].time_s) if points else 0
        drawn = (self.size, window, end_s, points < _FEW and points, *also)
        due, self._drawn = drawn != self._drawn, drawn
        return due


class SplitPlots(_Plots):
    """Upper share of thrust over the vehicle's time, newest at the right: arms side by side on one scale, so
    that arms of equal split do not hide each other. The ideal split is the quiet line."""

    def __init__(self, arms: Sequence[ArmView]) -> None:
        self._pairs = [k for k, arm in enumerate(arms) if arm.lower is not None]
        super().__init__(
            [TimePlot("%", numbers=0 if k else _PERCENT) for k in range(len(self._pairs))], id="splits"
        )

    def on_resize(self) -> None:
        """The first plot has the numbers beside it, and is as wide as the others without them."""
        if self.plots:
            each = (self.content_size.width - _PERCENT) // len(self.plots)
            self.plots[0].styles.width = each + _PERCENT

    def draw(
        self, arms: Sequence[ArmView], history: History, window: Window, range_words: str, *, mark: str
    ) -> None:
        """`mark` is put behind the arms' names when what is shown is no longer of the present."""
        words = Text.assemble("upper share of thrust, ", ("ideal", DIM), f", {range_words}")
        if not any(share is not None for point in history.points for share in point.shares):
            words = Text("no split yet: no coaxial pair makes thrust", DIM)
        if not self.due(words, history, window, mark):
            return
        points = history.inside(window)
        lines = [(shares(points, k, ideal=True), shares(points, k)) for k in self._pairs]
        y_range = share_range([y for pair in lines for line in pair for _, y in line])
        for plot, k, (ideal, actual) in zip(self.plots, self._pairs, lines, strict=True):
            style = ARMS[k % len(ARMS)]
            plot.show(
                arms[k].name + mark,
                f"bold {style}",
                [(ideal, DIM), (actual, style)],
                history.range_s(window),
                y_range,
            )


class ErrorPlots(_Plots):
    """The allocation error of each axis, one below the other."""

    def __init__(self) -> None:
        super().__init__(
            [TimePlot(numbers=_NEWTONS, times=k == len(AXES) - 1) for k in range(len(AXES))], id="errors"
        )

    def draw(self, history: History, window: Window, words: Text) -> None:
        """Show the errors inside the window."""
        if not self.due(words, history, window):
            return
        points = history.inside(window)
        for k, (plot, (axis, unit, least)) in enumerate(zip(self.plots, AXES, strict=True)):
            line = errors(points, k)
            plot.show(
                f"{axis}, {unit}",
                "bold",
                [(line, UPPER)],
                history.range_s(window),
                around_zero([y for _, y in line], least),
            )


class SuspicionPlot(_Plots):
    """How likely it is that the most suspected rotor lost thrust, 0 to 100 %."""

    def __init__(self) -> None:
        super().__init__([TimePlot("%", times=True)], id="suspicion")

    def draw(self, history: History, window: Window, words: Text) -> None:
        """Show what is inside the window."""
        if self.due(words, history, window):
            line = suspicion(history.inside(window))
            title = "" if line else "no verdict in this window"
            self.plots[0].show(title, DIM, [(line, UPPER)], history.range_s(window), (0.0, 100.0))


def parts(line: Line, gap_s: float) -> list[Line]:
    """The line where its points are not further apart than `gap_s`, in pieces."""
    cuts = [k for k, (a, b) in enumerate(pairwise(line), 1) if b[0] - a[0] > max(gap_s, 1.0)]
    return [line[a:b] for a, b in pairwise((0, *cuts, len(line))) if b > a]


def share_range(values: Sequence[float], least: float = 10.0, step: float = 5.0) -> Range:
    """A range around shares on multiples of `step`, at least `least` wide; 40 to 60 % for no values."""
    if not values:
        return 40.0, 60.0
    low, high = math.floor(min(values) / step) * step, math.ceil(max(values) / step) * step
    while high - low < least:
        # grow on the side where the data is nearer to the edge
        if min(values) - low <= high - max(values):
            low -= step
        else:
            high += step
    return low, high


def around_zero(values: Sequence[float], least: float) -> Range:
    """A range of round numbers that holds the values and zero, at least `least` to either side."""
    low, high = min((*values, -least)), max((*values, least))
    step = 10.0 ** math.floor(math.log10(high - low)) / 2
    return math.floor(low / step) * step, math.ceil(high / step) * step


def ticks(rows: int, low: float, high: float) -> list[float]:
    """The numbers beside a plot: both ends, and round ones between them where they stand rows apart.

    >>> ticks(21, 40.0, 60.0)
    [40.0, 45.0, 50.0, 55.0, 60.0]
    """
    step = next((s for s in _STEPS if s * (rows - 1) >= _APART * (high - low)), None)
    if step is None:
        return [low, high]
    between = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    margin = _APART * (high - low) / max(rows - 1, 1)
    return [low, *(t for t in between if low + margin <= t <= high - margin), high]
