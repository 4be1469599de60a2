"""A line plot in braille characters: 2 x 4 dots a cell, one colour index a cell."""

from __future__ import annotations

import math
from collections.abc import Sequence

Point = tuple[float, float]
Cell = tuple[str, int | None]  # character, and the index of the series that drew it last

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # [column][row] of U+2800


def braille(
    series: Sequence[Sequence[Point]],
    width: int,
    height: int,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    *,
    gap: float = math.inf,
) -> list[list[Cell]]:
    """`height` rows of `width` cells; points further apart than `gap` in x are not joined.

    What lies outside the ranges is drawn at the edge in y, left out in x. Series are (x, y) in order of x.
    """
    columns, rows = 2 * width, 4 * height
    bits = [[0] * width for _ in range(height)]
    owner: list[list[int | None]] = [[None] * width for _ in range(height)]

    def dot(x: float, y: float, index: int) -> None:
        column, row = round(x), round(y)
        if 0 <= column < columns and 0 <= row < rows:
            bits[row // 4][column // 2] |= _DOTS[column % 2][row % 4]
            owner[row // 4][column // 2] = index

    def pixel(point: Point) -> tuple[float, float]:
        x = (point[0] - x_range[0]) / (x_range[1] - x_range[0]) * (columns - 1)
        y = (y_range[1] - point[1]) / (y_range[1] - y_range[0]) * (rows - 1)
        return x, min(max(y, 0.0), rows - 1.0)

    for index, points in enumerate(series):
        previous: Point | None = None
        for point in points:
            x, y = pixel(point)
            if previous is None or point[0] - previous[0] > gap:
                dot(x, y, index)
            else:
                x0, y0 = pixel(previous)
                steps = max(math.ceil(abs(x - x0)), math.ceil(abs(y - y0)), 1)
                for k in range(1, steps + 1):
                    dot(x0 + (x - x0) * k / steps, y0 + (y - y0) * k / steps, index)
            previous = point
    return [
        [(chr(0x2800 + b) if b else " ", o) for b, o in zip(line, owners, strict=True)]
        for line, owners in zip(bits, owner, strict=True)
    ]


def nice_range(values: Sequence[float], least: float, step: float) -> tuple[float, float]:
    """A range around `values` on multiples of `step`, at least `least` wide; (0, least) for no values."""
    if not values:
        return 0.0, least
    low, high = math.floor(min(values) / step) * step, math.ceil(max(values) / step) * step
    while high - low < least:
        # grow on the side where the data is nearer to the edge
        if min(values) - low <= high - max(values):
            low -= step
        else:
            high += step
    return low, high
