"""Figures as files: PNG, SVG or PDF by the name's ending, whole or not there."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.errors import InputError

FORMATS = ("png", "svg", "pdf")


def write_figure(path: Path, figure: Any) -> None:
    """Write a matplotlib figure atomically. Raises InputError for another ending or place."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise InputError(path, "", f"a name that ends in .{', .'.join(FORMATS)} is expected")
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=110)
    files.write_atomic(path, stream.getvalue())
