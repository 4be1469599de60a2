# mypy: disallow-untyped-defs=False
"""`exact.solver` through numba: the same functions, compiled; nothing is written twice.

numba is imported here and nowhere else in the law, and only when a compiled law is made: it takes a second.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from inspect import isfunction
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.mixer.exact import solver

# fused multiply-add; no check of every division (a pivot is tested before it divides); no counting of
# references to rows, since nothing is allocated
OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy", "_nrt": False}


@cache
def function() -> Any:
    """`solver.optimum` compiled. Raises ImportError without numba."""
    import numba
    from numba.extending import register_jitable

    for part in vars(solver).values():
        if isfunction(part) and part.__module__ == solver.__name__:
            register_jitable(**OPTIONS)(part)  # it may call it
    with kept_code() as keep:
        made = numba.njit(solver.optimum, cache=keep, **OPTIONS)
        return one_at_a_time(made, Path(numba.config.CACHE_DIR)) if keep else made


@contextmanager
def kept_code() -> Iterator[bool]:
    """Where numba keeps what is compiled inside: a folder of ours for this very source; False: nowhere.

    numba itself looks at one file, and would run the old law after an upgrade of another.
    """
    import numba

    folder = files.code_folder(f"exact-{source_digest()}")
    config = numba.config
    before = config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES
    config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(folder), f"{__package__}.by_source.BySource"
    try:
        yield not files.keep_private(folder)
    finally:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = before


def one_at_a_time(function: Any, folder: Path) -> Any:
    """Of processes that start together one compiles; the others wait, and load what it wrote."""
    import portalocker
    from numba.core.compiler_lock import global_compiler_lock

    compiled = function.compile

    def compile_alone(signature: Any) -> Any:
        with global_compiler_lock, ExitStack() as stack:
            with suppress(
                OSError, portalocker.LockException
            ):  # where none can be had, each compiles for itself
                portalocker.lock(
                    stack.enter_context((folder / "lock").open("w")), portalocker.LockFlags.EXCLUSIVE
                )
            return compiled(signature)

    function.compile = compile_alone
    return function


def source_digest(folder: Path = Path(__file__).parent) -> str:
    """Of all sources of the law."""
    return hashlib.sha256(b"".join(p.read_bytes() for p in sorted(folder.glob("*.py")))).hexdigest()[:16]


def is_kept() -> bool:
    """Whether `function` is compiled already for this source: then it costs half a second, not twenty."""
    folder = files.code_folder(f"exact-{source_digest()}")
    made = folder.glob(f"**/solver.optimum-*.py{sys.version_info[0]}{sys.version_info[1]}.nbi")
    return next(made, None) is not None and not files.keep_private(folder)
