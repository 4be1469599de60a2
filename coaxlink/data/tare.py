"""What load cells read while nothing turns: a tare, taken off. In a model it would be thrust at no speed.

A load's tare is the median of its rows at rest, where it stands out of their noise at four standard errors,
or where the rows are so many that what they leave open is less than what any tare may be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.aliases import QUANTITIES, SIDES
from coaxlink.data.samples import Samples

STANDS = 0.01  # of a rotor's fastest, of full throttle: sensors at rest tell less
SIGMAS = 4.0  # of its standard error: one sound load in 16,000
FEW = 4  # rows at rest: below, their noise is that of all rows
MANY = 16  # rows at rest: their mean is known to a quarter of what one reading scatters by
LEAST = 12  # of those: fewer tell no noise
TAKEN = "tare taken off"
NORMAL_MAD = 1.4826  # sd over the median absolute deviation


def at_rest(samples: Samples) -> NDArray[np.bool_]:
    """(rows,) whether no rotor turns or is driven; none where neither speed nor throttle is known."""
    rest = np.ones(samples.rows, bool)
    known = False
    for name in (f"{side}_{what}" for side in SIDES for what in ("rpm", "throttle")):
        if samples.has(name):
            known = True
            full = 1.0 if name.endswith("throttle") else float(np.nanmax(samples[name], initial=0.0))
            rest &= samples[name] <= STANDS * full
    return rest if known else np.zeros(samples.rows, bool)


def without_tares(samples: Samples) -> Samples:
    """Loads less what they read at rest; the notes say how much of which."""
    rest, off = _stopped(at_rest(samples)), {}
    if not rest.any() or rest.all():
        return samples
    for name in (f"{side}_{QUANTITIES[q].suffix}" for side in SIDES for q in ("thrust", "torque")):
        if not samples.has(name):
            continue
        read = samples[name][rest]
        read = read[np.isfinite(read)]
        if not len(read):
            continue
        noise = float(np.std(read, ddof=1)) if len(read) >= FEW else _noise(samples[name])
        tare = float(np.median(read))
        if len(read) >= MANY or abs(tare) > SIGMAS * noise / np.sqrt(len(read)):
            off[name] = tare, noise, len(read)
    if not off:
        return samples
    reported = (
        f"{name} {tare:.3g} in {rows} rows at rest, noise {noise:.2g}"
        for name, (tare, noise, rows) in off.items()
    )
    less = {name: samples[name] - tare for name, (tare, _, _) in off.items()}
    return samples.with_columns(**less).with_notes(f"{TAKEN}: {'; '.join(reported)}")


def _stopped(rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(rows,) of the rows at rest those beyond the first third of a stretch after a run: it runs out."""
    first = np.concatenate([[0], np.flatnonzero(np.diff(rest)) + 1, [len(rest)]])
    length = np.diff(first)
    out = np.where(first[:-1] > 0, length // 3, 0)
    return rest & (np.arange(len(rest)) >= np.repeat(first[:-1] + out, length))


def _noise(load: NDArray[np.float64]) -> float:
    """sd of a load by its second differences, which hold little of a sweep."""
    known = load[np.isfinite(load)]
    if len(known) < LEAST:
        return float("inf")
    bend = np.diff(known, 2)
    return NORMAL_MAD * float(np.median(np.abs(bend - np.median(bend)))) / np.sqrt(6.0)
