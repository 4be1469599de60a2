"""Between the live mixer and the compiled loop: when it may run, and what it did into everybody's books."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from coaxlink.live import hot_kernel as k
from coaxlink.live.hot import BUDGET_S, EFFECTS_BUDGET_S, Batch, HotLoop
from coaxlink.mavlink.transport import Udp
from coaxlink.mixer.exact import ExactLaw

if TYPE_CHECKING:
    from coaxlink.live.mixer import LiveMixer


IDLE, REST_S = 8, 0.05  # turns in a row that only brought what Python has to see, and then its own pace


class HotPath:
    """`serve` instead of a read, while the law flies alone on a datagram line.

    A turn of the compiled loop costs more than a read: where noise ends every one of them at once, the loop
    in Python has the line to itself for a while.
    """

    def __init__(self, live: LiveMixer, loop: HotLoop) -> None:
        self._live, self._loop = live, loop
        self.answers = 0
        self._idle, self._rest_until = 0, 0.0

    @classmethod
    def of(cls, live: LiveMixer, function: Any, target: tuple[int, int]) -> HotPath | None:
        """Ready to run `function` (`hot_build.load`); None for a law that is not the exact one."""
        core, session = live.core, live.session
        law = core.law
        if not isinstance(law, ExactLaw) or law.slew is not None:
            return None
        sequence = np.frombuffer(session.counter, np.uint8)
        loop = HotLoop(function, law, core.scale.matrix, core.count, sequence)
        timing = live.guard.timing
        loop.aim(target, session.source, timing.silent_after_s, timing.hold_after_s)
        loop.lead(*core.lead_s)
        loop.motors[:], loop.told[:] = core.motors, core.told
        core.motors, core.told = loop.motors, loop.told
        return cls(live, loop)

    def interrupt(self) -> None:
        """Let the interpreter have its turn soon; from any thread."""
        self._loop.interrupt()

    def serve(self, line: Any, peer: Any) -> list[tuple[bytes, Any]] | None:
        """See `session.Tap`."""
        live = self._live
        core, guard = live.core, live.guard
        last_us = core.last_us
        if not guard.steady or last_us is None or not isinstance(line, Udp):
            return None
        if self._idle >= IDLE:
            self._idle, self._rest_until = 0, time.monotonic() + REST_S
        if self._rest_until and time.monotonic() < self._rest_until:
            return None
        to = line.one_target(peer)
        if to is None:
            return None
        if core.compensation is not None:
            self._loop.compensate(core.compensation.wrench(core.speeds), core.compensation.factor)
        line.arm(live.tick_s)
        budget = BUDGET_S if core.compensation is None else EFFECTS_BUDGET_S
        batch = self._loop.run(line.fileno(), to, last_us, guard.last, budget)
        live.session.bound.strangers.passed(batch.foreign)
        self._idle = self._idle + 1 if batch.left and not len(batch.rows) else 0
        if len(batch.rows):
            self._book(batch)
        return batch.left

    def _book(self, batch: Batch) -> None:
        # in one go: twenty answers one by one would take long enough to keep the next demand waiting
        live, rows = self._live, batch.rows
        self.answers += len(rows)
        core = live.core
        last, stamps = rows[-1].tolist(), batch.stamps.tolist()
        core.caught_up(stamps[-1], len(rows), batch.dropped, batch.superseded)
        live.guard.answered(last[k.TIME])
        core.held, core.error = tuple(last[k.HELD : k.HELD + 4]), last[k.ERROR : k.ERROR + 4]
        core.speeds, core.wrench = last[k.SPEEDS : k.SPEEDS + core.count], core.scale.wrench(core.held)
        core.counters.many(rows[:, k.LATENCY], rows[:, k.ERROR : k.ERROR + 4])
        live.kept(rows, batch)
        live.session.count(batch.raw[:, 4])
        if live.session.keeps_frames:
            offset_us = time.time_ns() // 1000 - time.monotonic_ns() // 1000
            for at_s, (heard, said) in zip(rows[:, k.TIME].tolist(), batch.frames(), strict=True):
                live.session.book(heard, said, offset_us + round(at_s * 1e6))
