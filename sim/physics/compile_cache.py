"""Compiled functions cached on disk by the source they were made of.

numba looks at the file of the function alone, and would run an old plant after an upgrade of another module.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import UserProvidedCacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import register_jitable

MODULES = (
    "layout", "blades", "drive", "forces", "kernel", "sensing", "wind", "compile_cache", "../flight_log",
    "../px4/loops", "../px4/track", "../quick/mix", "../quick/kernel",
)  # fmt: skip
# contraction and reordering of sums, not the assumption that all numbers are finite
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
# for what is compiled together with whoever calls it, within that: a function of its own has a copy beside
# each caller's and one alone, which round otherwise, and the first that a process has is run by all
inlined = register_jitable(forceinline=True, **OPTIONS)


def folder() -> Path:
    """Where this very source's code is cached."""
    here = Path(__file__).parent
    text = b"".join((here / f"{name}.py").read_bytes() for name in MODULES)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "coaxlink" / f"plant-{hashlib.sha256(text).hexdigest()[:16]}"


def private(folder: Path) -> bool:
    """Make a folder for code that will be run; whether nobody but this user can have put anything in it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        closed = not folder.lstat().st_mode & 0o077
        about = [p.lstat() for p in (folder, *folder.rglob("*"))]
        above = [p.stat().st_mode for p in folder.absolute().parents]
    except OSError:
        return False
    ours = all(
        a.st_uid == os.geteuid() and not stat.S_ISLNK(a.st_mode) and (closed or not a.st_mode & 0o022)
        for a in about
    )
    return ours and not any(mode & 0o002 and not mode & stat.S_ISVTX for mode in above)


class BySource(UserProvidedCacheLocator):
    """In that folder by the name of the source's own: checkouts of one source share what one compiled."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """As numba asks for it, without a hash of the path."""
        return Path(py_file).parent.name


def cached(**options: Any) -> Callable[[Callable[..., None]], Any]:
    """`numba.njit`, compiled once for this source; every time, where others could change the cache."""

    def decorate(function: Callable[..., None]) -> Any:
        cache_folder = folder()
        config = numba.config
        before = config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(cache_folder), f"{__name__}.BySource"
        try:
            keep = private(cache_folder)
            made = numba.njit(cache=keep, **options)(function)
            return one_at_a_time(made, cache_folder / f"{function.__name__}.lock") if keep else made
        except (RuntimeError, OSError):
            return numba.njit(**options)(function)
        finally:
            config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = before

    return decorate


def one_at_a_time(function: Any, lock: Path) -> Any:
    """Of processes that start together one compiles; the others wait, and load what it wrote."""
    compiled = function.compile

    def compile_alone(signature: Any) -> Any:
        with global_compiler_lock, contextlib.ExitStack() as stack:
            with contextlib.suppress(OSError):  # without room on the disk each compiles for itself
                fcntl.flock(stack.enter_context(lock.open("w")), fcntl.LOCK_EX)
            return compiled(signature)

    function.compile = compile_alone
    return function
