"""Single readings of a load cell that neither the rows beside nor the rotor's other load show: spikes.

A wire that touches, or an amplifier that lost a bit. Left in, a hundred of them are what a whole log is
judged by: squares know no outliers.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import median_filter

from coaxlink.channels.stand import COLUMN_OF
from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.instruments.findings import Finding, Mask
from coaxlink.instruments.stand.reference import BEARS_LOAD, reference_of
from coaxlink.instruments.stand.states import readings_of

BESIDE = 5  # rows, of which a spike has two at the most
FAR = 8.0  # standard deviations of what rows differ by from those beside, judgement: no noise's tail
LARGE = 0.1  # of the reference load, judgement: a smaller one spoils no fit
ALIKE = 0.3  # of it: where the rotor's other load jumps by that too, the rotor did
STEADY = 0.02  # of full speed from row to row, judgement: where more changes, a load may jump
OFTEN, MOST_SPIKES = 8, 0.1  # rows, judgement: fewer are outliers; of the rows: more is how the column reads


def spikes(frame: StandFrame, usable: Mask) -> Iterator[Finding]:
    """Loads that jump away and back within two rows, again and again, while speeds and the rotor's other load
    do not.
    """
    present = [c for c in frame.present if c < 4]
    if usable.sum() < 8 * BESIDE or not present:
        return
    stick, log = reference_of(frame, usable), readings_of(frame)
    moved = np.abs(np.diff(log.speeds, axis=0, prepend=log.speeds[:1])).max(axis=1) > STEADY
    steady = usable & ~moved & ~np.append(moved[1:], False)
    jumps = {c: _jumps((log.loads - stick.due(log)[:, :4])[:, c] / stick.reference[c]) for c in present}
    for c, jump in jumps.items():
        noise = SIGMA_PER_MAD * float(np.median(np.abs(jump[usable])))
        far = np.abs(jump) > max(LARGE, FAR * noise)
        if c ^ 1 in jumps:
            far &= np.abs(jumps[c ^ 1]) < ALIKE * np.abs(jump)
        far &= steady & (log.speeds[:, c // 2] > BEARS_LOAD)
        if far.sum() >= OFTEN and np.mean(far) < MOST_SPIKES:
            why = "single readings that neither the rows beside nor the rotor's other load show: spikes"
            yield COLUMN_OF[STAND_CHANNELS[c]], far, why


def _jumps(off: Array) -> Array:
    """(rows,) how far each row is from the middle of those about it."""
    return np.asarray(off - median_filter(off, BESIDE, mode="nearest"))
