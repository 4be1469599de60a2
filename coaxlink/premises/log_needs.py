"""What a log must have before anything is judged by it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coaxlink.data.logs.flight import AT_REST, MOTOR
from coaxlink.data.samples import DAMAGED, PREMISES, Samples
from coaxlink.frames import FlightFrame
from coaxlink.premises.answer import NotJudged
from coaxlink.premises.rotation import pairs_unmeasured

FLYING = 0.5  # of the usual command in flight: less is the ground
GAP_S = 2.0  # as long as the slowest attitude loop needs to answer (`same_vehicle.QUICK_S`)
# what is judged lies below 4 Hz (`channels.flight`), and a log shows half its rate (Nyquist)
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


def damage(logs: Sequence[Samples], reported: str = "") -> Iterator[NotJudged]:
    """Of every log that could not be read in full: what is missing may be what matters, and what is left may
    be wrong; `reported` is what it would mean."""
    for log in logs:
        if DAMAGED in log.premises:
            left = f"; the rest of it reads: {reported}" if reported else ""
            yield NotJudged(DAMAGED, "by an undamaged log", f"{log.source}: {PREMISES[DAMAGED]}{left}")


def unseen(logs: Sequence[Samples]) -> Iterator[str]:
    """In words, what each log is of, and that it does not hold its flight from the ground to the ground."""
    yield from dict.fromkeys(words for log in logs for words in log.provenance)
    for log in logs:
        names = [name for name in log.columns if MOTOR.fullmatch(name)]
        if not names or log.rows < 2:
            continue
        time, mean = log["time_s"], np.nan_to_num(np.mean([log[n] for n in names], axis=0))
        flying = mean > FLYING * np.median(mean[mean > AT_REST]) if np.any(mean > AT_REST) else mean > 1.0
        gaps = np.where(flying[:-1] | flying[1:], np.diff(time), 0.0)
        words = ["begins in the air"] if flying[0] else []
        words += [f"has a gap of {gaps.max():.1f} s"] if gaps.max() > GAP_S else []
        words += [f"ends in the air, at {time[-1]:.1f} s"] if flying[-1] else []
        if words:
            name = log.source or "the log"
            yield f"{name} {' and '.join(words)}: what set in there, or before, is not seen"
