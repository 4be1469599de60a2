"""`exact.kernel` through numba: the same functions, compiled; nothing is written twice.

numba is imported here and nowhere else in the law, and only when a compiled law is asked for.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from coaxlink.mixer.exact import kernel

# callees before callers
HELPERS = (
    "surface", "value", "line", "expand_arm", "miss", "reduce_arm", "assemble", "give_up", "factor",
    "substitute", "step_arms", "revise", "box_arm", "dual_slope", "ascent", "along", "climb", "largest_step",
    "quadratic_step", "move", "correct", "worst_met", "expand", "merit", "promise", "persist", "solve",
)  # fmt: skip

# fused multiply-add, and no check of every division (a pivot is tested before it divides)
OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}


@cache
def compiled() -> tuple[Any, Any]:
    """(`kernel.optimum`, `kernel.batch`) compiled and cached on disk. Raises ImportError without numba."""
    import numba
    from numba.extending import register_jitable

    for name in HELPERS:
        register_jitable(**OPTIONS)(getattr(kernel, name))
    register_jitable(**OPTIONS)(kernel.optimum)
    return numba.njit(kernel.optimum, cache=True, **OPTIONS), numba.njit(kernel.batch, cache=True, **OPTIONS)
