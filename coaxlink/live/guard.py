"""When to answer and how much of the law to answer with: the state machine of silence and hand-over.

    waiting -- settle demands in a row --> fading -- fade_s --> live
    live -- no good demand for hold_after_s --> hold -- until ramp_after_s --> ramp -- ramp_s --> silent
    hold, ramp -- a good demand --> fading (from the share reached)
    silent -- settle demands in a row --> fading
    any -- stop(why) --> stopped (for good)

The answer is a blend: share 1 is the law, share 0 what the autopilot's own mixer would do with the same
demand. So the vehicle is taken over and handed back without a step. Time is any monotonic clock, handed in.
"""

from __future__ import annotations

from dataclasses import dataclass

WAITING, FADING, LIVE, HOLD, RAMP, SILENT, STOPPED = (
    "waiting", "fading", "live", "hold", "ramp", "silent", "stopped",
)  # fmt: skip
STATES = (WAITING, FADING, LIVE, HOLD, RAMP, SILENT, STOPPED)


@dataclass(frozen=True)
class Timing:
    """Seconds of wall time; the defaults are what docs/live.md states."""

    settle: int = 3  # good demands in a row before the first answer
    fade_s: float = 0.3  # from the autopilot's own mixer to the law
    hold_after_s: float = 0.012  # silence of the demand that counts as its end
    ramp_after_s: float = 0.030  # until then the autopilot is left with the last answer
    ramp_s: float = 0.050  # from the last answer to the autopilot's own mixer; then silence
    tick_s: float = 0.005
    # five periods of 250 Hz; a rate loop of a 20 kg vehicle crosses over near 3 Hz, where it costs 22 degrees
    oldest_s: float = 0.020  # a demand that may be older draws nothing; inf where simulated time waits for us
    sync_s: float = 5.0  # the vehicle's clock (TIMESYNC) is waited for so long, then arrival spacing counts

    @property
    def silent_after_s(self) -> float:
        """From the last good demand to the last thing reported."""
        return self.ramp_after_s + self.ramp_s


def timing_for(rate_hz: float) -> Timing:
    """The default, stretched where the demand itself comes more slowly than the waits allow."""
    base, period = Timing(), 1.0 / rate_hz
    hold = max(base.hold_after_s, 2.5 * period)
    return Timing(hold_after_s=hold, ramp_after_s=max(base.ramp_after_s, hold + 2 * period))


class Guard:
    """See the module's text. `good` for every demand fit to be answered, `tick` in between."""

    def __init__(self, timing: Timing | None = None) -> None:
        self.timing = timing or Timing()
        self.state = WAITING
        self.why = ""  # of a stop
        self.share = 0.0
        self.hand_overs = 0
        self.leaving = False
        self._streak = 0
        self._last = -1e9
        self._ramp_from = 0.0

    def good(self, now: float) -> float | None:
        """A demand worth an answer came at `now` (s): the share of the law in it, None for no answer."""
        t, quiet = self.timing, now - self._last
        self._last = now
        if self.state == STOPPED:
            return None
        if self.state in (FADING, LIVE, HOLD, RAMP) and quiet > t.silent_after_s:
            self._hand_over()  # this process slept through it
        if self.state in (WAITING, SILENT):
            self._streak = self._streak + 1 if quiet <= t.ramp_after_s else 1
            if self.leaving or self._streak < t.settle:
                return None
            self.state, self.share = (FADING, 0.0) if t.fade_s > 0 else (LIVE, 1.0)
            return self.share
        step = min(max(quiet, 0.0), t.hold_after_s) / (t.ramp_s if self.leaving else max(t.fade_s, 1e-9))
        self.share = max(self.share - step, 0.0) if self.leaving else min(self.share + step, 1.0)
        self.state = LIVE if self.share >= 1.0 else FADING
        if self.leaving and self.share <= 0.0:
            self._hand_over()
        return self.share

    @property
    def last(self) -> float:
        """When the last good demand came (s)."""
        return self._last

    def tick(self, now: float) -> float | None:
        """Time passed without a demand: the share to say once more, None to keep quiet."""
        if self.state not in (FADING, LIVE, HOLD, RAMP):
            return None
        t, quiet = self.timing, now - self._last
        if quiet <= t.hold_after_s:
            return None
        if quiet <= t.ramp_after_s:
            self.state = HOLD
            return None
        if self.state != RAMP:
            self.state, self._ramp_from = RAMP, self.share
        if quiet >= t.silent_after_s:
            self.share = 0.0
            # a ramp that nobody was awake for is not made up for: the autopilot has long taken over
            late = quiet > t.silent_after_s + 2 * t.tick_s
            self._hand_over()
            return None if late else 0.0
        self.share = self._ramp_from * (1.0 - (quiet - t.ramp_after_s) / t.ramp_s)
        return self.share

    def stop(self, why: str) -> None:
        """Say nothing ever again, for this reason (the first one counts)."""
        if self.state != STOPPED:
            self.state, self.why = STOPPED, why

    @property
    def answering(self) -> bool:
        """Whether the vehicle is flown by our answers now."""
        return self.state in (FADING, LIVE, HOLD, RAMP)

    def _hand_over(self) -> None:
        self.state, self.share, self._streak = SILENT, 0.0, 0
        self.hand_overs += 1
