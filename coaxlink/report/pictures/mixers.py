"""Mixers in one picture: ceiling, yaw authority and power of each, and how a hard turn sinks the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from coaxlink.mixer.worth import Worth, front
from coaxlink.report.pictures.figures import SIZE, new_figure, plain_axis, stamped
from coaxlink.report.pictures.looks import LOOKS, Look
from coaxlink.tables.worth import Worths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#222222"
ROOM = 0.09  # of the axis, between two labels


def draw_comparison(name: str, worths: Worths, shown: Sequence[Worth], stamp: str = "") -> Figure:
    """Two panels, legible at 400 px: every table and law above, the sink of those in `shown` below."""
    figure = new_figure(8.0)
    above, below = figure.subplots(2, 1)
    looks = {row.name: look for row, look in zip(worths.rows, LOOKS, strict=False)}
    _draw_front(above, name, worths, looks)
    for row in shown:
        if len(row.sink_kg):
            below.plot(row.sink_kg, row.sink_m_s2, **looks[row.name].line, label=row.name, lw=2.2)
            if row.held_kg > row.sink_kg[0]:
                at = float(np.interp(row.held_kg, row.sink_kg, row.sink_m_s2))
                below.plot(row.held_kg, at, **looks[row.name].points, ms=9)
    below.axvline(worths.rows[0].mass_kg, color=INK, lw=1, ls=":")
    roll, _, yaw = worths.rows[0].hard_Nm
    below.set_title(f"sink in {roll:.0f} N m of roll, {yaw:.1f} N m of yaw; mark: the most held")
    below.set_xlabel("load: the vehicle's whole mass, kg (dotted: as it is)")
    below.set_ylabel("downward, m/s\N{SUPERSCRIPT TWO}")
    below.legend()
    for axes in (above, below):
        plain_axis(axes)
    return stamped(figure, stamp)


def _draw_front(axes: Axes, name: str, worths: Worths, looks: dict[str, Look]) -> None:
    """Ceiling and yaw authority as places, power in words; filled: on the Pareto front of the three."""
    flyable = [
        (row, best) for row, best in zip(worths.rows, front(worths.rows), strict=True) if len(row.sink_kg)
    ]
    for row, best in flyable:
        look, at = looks[row.name], (row.ceiling_N, row.limits[2].moment_Nm)
        fill = look.colour if best else "white"
        axes.plot(*at, look.marker, ms=11, mfc=fill, mec=look.colour, mew=1.8, ls="none")
        if row.name == worths.used:
            axes.plot(*at, "o", ms=22, mfc="none", mec=INK, mew=1.5, ls="none")
    axes.margins(0.16, 0.14)
    low, high = axes.get_ylim()
    left, right = axes.get_xlim()
    last = {True: -np.inf, False: -np.inf}
    for row, _ in sorted(flyable, key=lambda d: d[0].limits[2].moment_Nm):
        ceiling, yaw = row.ceiling_N, row.limits[2].moment_Nm
        far = ceiling > (left + right) / 2
        y = max(yaw, last[far] + ROOM * (high - low))
        last[far] = y
        text = f"{row.name}, {row.drawn[0]:.0f} W"
        away = (-16, 0) if far else (16, 0)
        axes.annotate(
            text, (ceiling, y), away, textcoords="offset points", ha="right" if far else "left", va="center",
            fontsize=SIZE, fontweight="bold" if row.name == worths.used else "normal",
        )  # fmt: skip
    axes.set_title(f"{name}: filled: none better in all three; ring: in use")
    axes.set_xlabel("ceiling, N")
    axes.set_ylabel("yaw authority in hover, N m")
