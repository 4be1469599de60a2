# mypy: disallow-untyped-defs=False
"""The exact law where time is short: so many quadratic steps from where the last call stood, and no more."""

from __future__ import annotations

from coaxlink.mixer.exact.kernel import restart, solve
from coaxlink.mixer.exact.warm import start


def settle(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, limit):
    """`kernel.optimum` without its sure ways; the same arrays, the same answer wherever it settles.

    Where that fails, the axis of the last rank (yaw) is left at none, as the first that would be given up.
    Returns the steps taken; negative when even that did not settle, and x is then no answer.
    """
    n = 2 * shape[0]
    start(n, x, act, lam, el, mu, past)
    for i in range(n):
        x[i] = min(max(x[i], lo[i]), hi[i])
        if hi[i] <= lo[i]:
            act[i] = -1
    steps, _ = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if steps > 0:
        return steps
    restart(lo, hi, x, act, lam, el)
    mu[3] = 0.0
    again, _ = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if again > 0:
        return again - steps
    restart(lo, hi, x, act, lam, el)
    return again + steps
