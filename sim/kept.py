"""Compiled functions kept on disk by the source they were made of.

numba looks at the file of the function alone, and would run an old plant after an upgrade of another module.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

MODULES = ("layout", "lanes", "blades", "drive", "forces", "kernel", "stand_blades", "kept")


def folder() -> Path:
    """Where this very source's code is kept."""
    here = Path(__file__).parent
    text = b"".join((here / f"{name}.py").read_bytes() for name in MODULES)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coaxlink" / f"plant-{hashlib.sha256(text).hexdigest()[:16]}"


def kept(**options: Any) -> Callable[[Callable[..., None]], Any]:
    """`numba.njit`, compiled once for this source; every time, where nothing can be kept."""

    def decorate(function: Callable[..., None]) -> Any:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder())
        try:
            return numba.njit(cache=True, **options)(function)
        except (RuntimeError, OSError):
            return numba.njit(**options)(function)
        finally:
            numba.config.CACHE_DIR = before

    return decorate
