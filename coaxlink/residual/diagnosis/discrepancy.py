"""No form is exact: every effect carries a Gaussian process of a share of itself over its own variable.

How large a share is a number of the hypothesis: of a textbook's form next to nothing, of a rough one a fifth.
Held at a fifth for all, the process would explain what a wrong name leaves, and the right name would pay for
it.

Source: Kennedy and O'Hagan 2001, Bayesian calibration of computer models; Brynjarsdottir and O'Hagan 2014,
why a discrepancy needs an informative prior.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from coaxlink.effects.tracing import Array
from coaxlink.evidence.blocks import Block, products, waves
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.members import Member

SHARES = (0.2, 0.03)  # of the effect, one standard deviation; each as likely
OVER_CAUSE = 0.3  # correlation length, in ranges
STEADY = 0.5  # of the effect's root mean square: what of the discrepancy is there where the effect is nil
SEEN = 1e-4  # of the reference load: less of an effect has no discrepancy


def discrepancy(ch: Channels, m: Member, mine: Array, share: float) -> Block | None:
    """Columns of what a member's form may miss, a share of `mine` (rows, C), what it adds."""
    pieces, deviations = [], []
    for c, name in enumerate(ch.names):
        rms = float(np.sqrt(np.mean(mine[:, c] ** 2)))
        if rms < SEEN * ch.reference[c]:
            continue
        _, cause = m.effect.cause(ch.bare, m.shape, name)
        z = np.asarray(cause, float)[ch.frame.keep]
        process = ch.over_speeds[c]
        if np.ptp(z) > 0.0:
            low, high = np.quantile(z, [0.005, 0.995])
            if high > low:
                over = waves(np.clip(z, low, high), OVER_CAUSE)
                # a vehicle's loads depend on many speeds: their mean says nothing that the cause does not
                process = products(over, process)
        if (
            "lag_s" in m.shape
        ):  # of what is late, how late: what a second lag, or another form of it, would change
            columns, deviation = _later(mine, c, share)
            pieces.append(columns)
            deviations.append(deviation)
        weight = np.sqrt(mine[:, c] ** 2 + (STEADY * rms) ** 2)
        columns = np.zeros((len(z), ch.count, process[0].shape[1]))
        columns[:, c] = process[0] * weight[:, None]
        pieces.append(columns)
        deviations.append(process[1] * share)
    if not pieces:
        return None
    return Block(f"{m.name} discrepancy", np.concatenate(pieces, axis=-1), np.concatenate(deviations))


def _later(mine: Array, channel: int, share: float) -> tuple[Array, Array]:
    """(rows, C, K) changes of a channel's effect if it came one or two rows later, or smoothed by a lag."""
    own = mine[:, channel]
    once, twice = np.roll(own, 1), np.roll(own, 2)
    once[0] = twice[0] = twice[1] = own[0]
    smooth = lfilter([0.5], [1.0, -0.5], own)
    columns = np.zeros((*mine.shape, 3))
    columns[:, channel] = np.stack([once - own, twice - own, smooth - own], axis=1)
    return columns, np.full(3, share)
