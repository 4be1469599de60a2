"""Work for the engine's tests, in a module of its own: workers are processes that import it."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path

COLUMNS = {"cell": "int64", "law": "string", "value": "float64"}


def work(payload: dict[str, object], cells: Sequence[int]) -> dict[str, list[object]]:
    """Rows that follow from the cell; whoever first does cell `dies` (once, by a flag file) is killed."""
    flag, dies = payload.get("flag"), payload.get("dies")
    if flag and dies in cells and not Path(str(flag)).exists():
        Path(str(flag)).write_text("dead")
        os.kill(os.getpid(), signal.SIGKILL)
    if payload.get("always") in cells:
        os.kill(os.getpid(), signal.SIGKILL)
    return {
        "cell": list(cells),
        "law": ["ab"[c % 2] for c in cells],
        "value": [None if c % 7 == 0 else c**0.5 for c in cells],
    }
