"""What a log must have before anything is judged by it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from coaxlink.data.samples import DAMAGED, PREMISES, Samples
from coaxlink.frames import FlightFrame
from coaxlink.premises.answer import NotJudged
from coaxlink.premises.rotation import pairs_unmeasured

# what is judged lies below 4 Hz (`residual.channels.flight`), and a log shows half its rate (Nyquist)
LEAST_RATE_HZ = 8.0


def lacking(frame: FlightFrame) -> Iterator[NotJudged]:
    """What a flight's rows do not hold, or nobody measured of its pairs."""
    yield from pairs_unmeasured(frame.airframe, frame.model)
    rate = 1.0 / frame.step_s
    if rate < LEAST_RATE_HZ:
        why = (
            f"{rate:.1f} rows a second do not show how the vehicle answers, {LEAST_RATE_HZ:.0f} are the least"
        )
        yield NotJudged("log_rate", "a flight at 50 rows a second", why)


def damage(logs: Sequence[Samples], said: str = "") -> Iterator[NotJudged]:
    """Of every log that could not be read in full: what is missing may be what matters, and what is left may
    be wrong; `said` is what it would mean."""
    for log in logs:
        if DAMAGED in log.premises:
            left = f"; what is left of it says: {said}" if said else ""
            yield NotJudged(DAMAGED, "by an undamaged log", f"{log.source}: {PREMISES[DAMAGED]}{left}")
