"""Figures as files and bytes: PNG, SVG or PDF, whole or not there, stamped with how they were made."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink import files
from coaxlink.errors import InputError
from coaxlink.report.pictures.label import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
DPI = 130
WIDTH, SIZE = 6.4, 12  # inches and points: letters are 11 px high where a page shows the picture 400 px wide
LETTERS, KEY = 60, 6  # in a row of a key; what a line and its gap take of them
GREY, STAMP = "#8a8f98", "#6b7280"


def new_figure(height: float) -> Figure:
    """An empty figure so many inches high: no pyplot, so no global state and no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")


def plain_axis(axis: Axes) -> None:
    """Two spines, a faint grid, letters that a phone shows; to be called when title and labels are there."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color=GREY, alpha=0.25, lw=0.5)
    axis.tick_params(labelsize=SIZE - 1)
    room = _key_above(axis) if axis.get_legend() else None
    for place in ("left", "center"):
        axis.set_title(axis.get_title(place), loc=place, fontsize=SIZE, pad=room)
    for words in (axis.xaxis.label, axis.yaxis.label):
        words.set_fontsize(SIZE)


def _key_above(axis: Axes) -> float:
    """Put the key between the axis and its title, where it covers no data; the points that it takes."""
    legend = axis.get_legend()
    assert legend is not None
    handles, names = axis.get_legend_handles_labels()
    title = legend.get_title().get_text()
    columns = len(names) if sum(len(n) + KEY for n in names) <= LETTERS else 2
    axis.legend(
        handles, names, title=title or None, ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0),
        frameon=False, borderaxespad=0.2, columnspacing=1.2, fontsize=SIZE - 1, title_fontsize=SIZE - 1,
        alignment="left",
    )  # fmt: skip
    return (-(-len(names) // columns) + bool(title)) * 1.5 * SIZE + 6.0


def stamped(figure: Any, stamp: str) -> Any:
    """The figure with one small line below it: vehicle, file, date, commit. Nothing where there is none."""
    if stamp:
        figure.supxlabel(label(stamp, 200), x=0.995, ha="right", fontsize=6.5, color=STAMP)
    return figure


def drawn(figure: Any, kind: str = "png") -> bytes:
    """A matplotlib figure as bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=DPI)
    return stream.getvalue()


def format_of(path: Path) -> str:
    """png, svg or pdf, by a picture's name. Raises InputError for another ending."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise InputError(path, "", f"a name that ends in .{', .'.join(FORMATS)} is expected")
    return kind


def write_figure(path: Path, figure: Any) -> None:
    """Write a matplotlib figure atomically. Raises InputError for another ending or place."""
    files.write_atomic(path, drawn(figure, format_of(path)))


def write_figures(folder: Path, figures: Mapping[str, Any]) -> None:
    """Every figure by its name, as PNG, SVG and PDF. Raises InputError for a place that cannot be written."""
    for name, figure in figures.items():
        for kind in FORMATS:
            write_figure(folder / f"{name}.{kind}", figure)
