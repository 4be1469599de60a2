"""The clocks of this process, slowed: what counts in milliseconds has as much longer on a busy machine.

Vehicle, companion and test share them, so every limit keeps its meaning. `python slow_clock.py FACTOR
coaxlink WORDS...` runs a verb under them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SLOWED = ("monotonic", "perf_counter", "time")
factor = 1.0  # real seconds a second


@contextmanager
def slowed(by: float) -> Iterator[None]:
    """All of `SLOWED` run `by` times slower, and so does the compiled loop's own clock."""
    global factor
    from coaxlink.live.compiled import Exchange

    real = {name: getattr(time, name) for name in SLOWED}
    start = {name: now() for name, now in real.items()}
    call, answered = Exchange.__call__, Exchange.answered

    def slow(name: str) -> Any:
        return lambda: start[name] + (real[name]() - start[name]) / by

    def called(self: Any, number: int, peer: Any, last_s: float, quiet_s: float, turn_s: float) -> int:
        last_s = start["monotonic"] + (last_s - start["monotonic"]) * by
        return call(self, number, peer, last_s, quiet_s * by, turn_s)

    def slow_answered(self: Any) -> Iterator[Any]:
        zero = start["monotonic"] * 1e9
        for stamp, came, sent, *rest in answered(self):
            yield (stamp, *(round(zero + (ns - zero) / by) for ns in (came, sent)), *rest)

    factor = by
    Exchange.__call__, Exchange.answered = called, slow_answered  # type: ignore[method-assign]
    for name in SLOWED:
        setattr(time, name, slow(name))
    try:
        yield
    finally:
        for name, now in real.items():
            setattr(time, name, now)
        Exchange.__call__, Exchange.answered = call, answered  # type: ignore[method-assign]
        factor = 1.0


def command(*words: str) -> list[str]:
    """`coaxlink WORDS...` as a process on this clock."""
    return [sys.executable, __file__, str(factor), "coaxlink", *words]


if __name__ == "__main__":
    _, slower, *sys.argv = sys.argv
    from coaxlink._start import main

    with slowed(float(slower)):
        main()
