"""A learning curve as a table for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coaxlink.rotor.learning import Lesson


def curve_table(curve: Sequence[Lesson]) -> Any:
    """Rich table: blocks and rows fitted, and the error each channel then has on blocks left out."""
    from rich.table import Table

    table = Table(title="learning curve: RMSE on blocks left out", title_justify="left")
    channels = list(curve[-1].rmse) if curve else []
    for heading in ("blocks fitted", "rows", *channels):
        table.add_column(heading.replace("_", " "), justify="right")
    for lesson in curve:
        errors = (f"{lesson.rmse[c]:.4g}" if c in lesson.rmse else "" for c in channels)
        table.add_row(str(lesson.blocks), str(lesson.rows), *errors)
    return table
