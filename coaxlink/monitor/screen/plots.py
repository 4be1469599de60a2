"""The plots in words: the split of each arm in a plot of its own, and the allocation error over time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.text import Text

from coaxlink.monitor.screen.history import History, Line, Window, errors, shares
from coaxlink.monitor.screen.marks import ARMS, DIM, UPPER, clock, number
from coaxlink.monitor.screen.plot import Cell, braille, nice_range
from coaxlink.monitor.state import ArmView

_LABEL = 5  # cells of "100%▕"
_LEAST = 7  # cells a plot of one arm needs
_STEPS = (5.0, 10.0, 25.0, 50.0)  # between the numbers beside a plot, per cent
_APART = 3  # rows between two numbers
_AXIS = 14  # cells of "thrust  -12.3▕"
AXES = (("thrust", "N", 0.1), ("roll", "N m", 0.01), ("pitch", "N m", 0.01), ("yaw", "N m", 0.01))


def split_plot(
    history: History, arms: Sequence[ArmView], window: Window, width: int, height: int, *, mark: str = ""
) -> Text:
    """Upper share of thrust over the vehicle's time, newest at the right: arms side by side on one scale, so
    that arms of equal split do not hide each other. The ideal split is the quiet line.

    `mark` is put behind the arms' names when what is shown is no longer of the present.
    """
    pairs = [k for k, arm in enumerate(arms) if arm.lower is not None]
    points = history.inside(window)
    actual = {k: shares(points, k) for k in pairs}
    if not any(actual.values()) or height < 2 or width < _LABEL + _LEAST:
        return Text("no split yet: the rotors stand still", DIM)
    ideal = {k: shares(points, k, ideal=True) for k in pairs}
    shown = pairs[: max((width - _LABEL + 1) // (_LEAST + 1), 1)]
    room = (width - _LABEL - (len(shown) - 1)) // len(shown)
    low, high = nice_range([y for k in shown for _, y in (*actual[k], *ideal[k])], 10.0, 5.0)
    titled = height >= 3
    rows = height - titled
    grids = [
        braille(
            [ideal[k], actual[k]],
            room,
            rows,
            history.range_s(window),
            (low, high),
            gap=max(window.span_s / 20, 1.0),
        )
        for k in shown
    ]
    lines, numbers = [], ticks(rows, low, high)
    if titled:
        names = (_name(arms[k].name, room - len(mark)) + mark for k in shown)
        titles = [Text(f"{n:<{room}}", f"bold {ARMS[k % 8]}") for k, n in zip(shown, names, strict=True)]
        lines.append(Text.assemble(" " * _LABEL, Text(" ").join(titles)))
    for row in range(rows):
        share = numbers.get(row)
        line = Text(f"{share:3.0f}%▕" if share is not None else "    ▕", DIM)
        for k, grid in zip(shown, grids, strict=True):
            line.append("" if k == shown[0] else " ")
            _draw(line, grid[row], (DIM, ARMS[k % 8]))
        lines.append(line)
    return Text("\n").join(lines)


def error_plot(history: History, window: Window, width: int, height: int) -> Text:
    """The allocation error of each axis, one below the other, over the vehicle's clock."""
    points = history.inside(window)
    known = any(p.error is not None for p in points)
    rows = (height - 1) // len(AXES)
    if not known or rows < 2 or width < _AXIS + _LEAST:
        text = "no allocation error in this window" if not known else "too small for four plots"
        return Text(text, DIM)
    span = history.range_s(window)
    lines = []
    for k, (axis, unit, least) in enumerate(AXES):
        values = errors(points, k)
        low, high = _around([y for _, y in values], least)
        grid = braille([values], width - _AXIS, rows, span, (low, high), gap=max(window.span_s / 20, 1.0))
        digits = 1 if high - low >= 2.0 else 2 if high - low >= 0.2 else 3
        for row in range(rows):
            name = axis if row == 0 else unit if row == 1 else ""
            value = high if row == 0 else low if row == rows - 1 else None
            text = "" if value is None else number(value, digits, signed=True)
            line = Text(f"{name:<6}{text:>{_AXIS - 7}}▕", DIM)
            _draw(line, grid[row], (UPPER,))
            lines.append(line)
    lines.append(_times(span, _AXIS, width))
    return Text("\n").join(lines)


def one_plot(
    values: Line,
    y_range: tuple[float, float],
    unit: str,
    window: Window,
    span: tuple[float, float],
    width: int,
    height: int,
) -> Text:
    """One line over the vehicle's clock, its range and the times at its edges."""
    rows = height - 1
    if rows < 2 or width < _LABEL + _LEAST:
        return Text("too small for a plot", DIM)
    low, high = y_range
    grid = braille([values], width - _LABEL, rows, span, y_range, gap=max(window.span_s / 20, 1.0))
    lines, numbers = [], ticks(rows, low, high)
    for row in range(rows):
        share = numbers.get(row)
        line = Text(f"{share:3.0f}{unit}▕" if share is not None else "    ▕", DIM)
        _draw(line, grid[row], (UPPER,))
        lines.append(line)
    lines.append(_times(span, _LABEL, width))
    return Text("\n").join(lines)


def _times(span: tuple[float, float], indent: int, width: int) -> Text:
    """The line below a plot: the vehicle's clock at its edges."""
    first, last = (clock(t) for t in span)
    gap = width - indent - len(first) - len(last)
    return Text(" " * indent + first + " " * max(gap, 1) + last, DIM)


def legend() -> Text:
    """The title of the split plot."""
    return Text.assemble("upper share of thrust, ", ("ideal", DIM))


def _draw(line: Text, cells: Sequence[Cell], styles: Sequence[str]) -> None:
    """Append cells, neighbours of one series together."""
    start = 0
    for k in range(1, len(cells) + 1):
        if k == len(cells) or cells[k][1] != cells[start][1]:
            index = cells[start][1]
            text = "".join(c for c, _ in cells[start:k])
            line.append(text, "" if index is None else styles[index])
            start = k


def _around(values: Sequence[float], least: float) -> tuple[float, float]:
    """A range of round numbers that holds the values and zero, at least `least` to either side."""
    low, high = min((*values, -least)), max((*values, least))
    step = 10.0 ** math.floor(math.log10(high - low)) / 2
    return math.floor(low / step) * step, math.ceil(high / step) * step


def _name(name: str, room: int) -> str:
    """An arm's name, its initials where it does not fit."""
    return name if len(name) <= room else "".join(word[0] for word in name.upper().split())


def ticks(rows: int, low: float, high: float) -> dict[int, float]:
    """The share that stands beside a row: both ends, and between them round numbers a few rows apart.

    >>> ticks(21, 40.0, 60.0)
    {0: 60.0, 5: 55.0, 10: 50.0, 15: 45.0, 20: 40.0}
    """
    last = rows - 1
    found = {0: high, last: low}
    step = next((s for s in _STEPS if s * last >= _APART * (high - low)), high - low)
    for k in range(math.floor(high / step), math.floor(low / step), -1):
        row = round((high - k * step) / (high - low) * last)
        if _APART <= row <= last - _APART:
            found[row] = k * step
    return dict(sorted(found.items()))
