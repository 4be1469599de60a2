"""`exact.kernel` through numba: the same functions, compiled; nothing is written twice.

numba is imported here and nowhere else in the law, and only when a compiled law is asked for.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

from coaxlink import files
from coaxlink.mixer.exact import dual, kernel, loads, quadratic, schur, warm

# callees before callers
HELPERS = {
    loads: (
        "surface", "value", "line", "value_of_one", "expand_arm", "expand", "miss", "merit", "move",
        "largest_step", "worst_met",
    ),
    schur: ("reduce_arm", "assemble", "give_up", "factor", "substitute", "correct"),
    dual: ("box_arm", "dual_slope", "ascent", "along", "climb"),
    quadratic: ("step_arms", "revise", "quadratic_step"),
    warm: ("away", "keep", "recall", "start"),
    kernel: ("promise", "persist", "solve", "restart", "optimum"),
}  # fmt: skip
# what every call goes through, inlined by force: handing on the forty numbers that describe an arm's
# arrays costs as much as the arm's own arithmetic
INLINE = frozenset((
    "surface", "value", "line", "value_of_one", "expand_arm", "expand", "miss", "move", "largest_step",
    "worst_met", "reduce_arm", "assemble", "factor", "substitute", "step_arms", "revise", "away", "start",
))  # fmt: skip
# fused multiply-add; no check of every division (a pivot is tested before it divides); no counting of
# references to rows, since nothing is allocated
OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy", "_nrt": False}


@cache
def compiled() -> tuple[Any, Any]:
    """(`kernel.optimum`, `kernel.batch`) compiled, and cached on disk where only we can write.

    Raises ImportError without numba.
    """
    import numba

    register()
    folder = cache_folder()
    keep = not files.keep_private(folder)
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
    try:
        optimum = numba.njit(kernel.optimum, cache=keep, **OPTIONS)
        return optimum, numba.njit(kernel.batch, cache=keep, **OPTIONS)
    finally:
        numba.config.CACHE_DIR = before


def register(inline: bool = True) -> None:
    """Tell numba that it may compile the law's helpers where they are called.

    Without `inline` that takes half the time, and a call half a microsecond more.
    """
    from numba.extending import register_jitable

    for module, names in HELPERS.items():
        for name in names:
            register_jitable(**OPTIONS, forceinline=inline and name in INLINE)(getattr(module, name))


def cache_folder() -> Path:
    """Where the compiled law is kept: a folder for this very source.

    numba looks at the text of kernel.py alone, and would run the old law after an upgrade of another
    module of the law.
    """
    texts = [Path(str(module.__file__)).read_bytes() for module in HELPERS]
    texts.append(Path(__file__).read_bytes())
    return files.code_folder(f"exact-{hashlib.sha256(b''.join(texts)).hexdigest()[:16]}")
