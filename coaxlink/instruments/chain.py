"""A hidden Markov chain over ways in which columns lie: which of them hold in which rows.

Each state says by how much log evidence it beats the sound one in every row; a run of it has its price.
Rabiner, Proc. IEEE 77 (1989), III.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.frames import Array
from coaxlink.instruments.findings import Mask

# priors: name = value  # unit, source
HEAVY = 4.0  # degrees of freedom of Student's t: outliers of a few sigma in a hundred rows, as loggers have
BEGINS = np.log(50.0)  # nats: what has failed fails anew once in fifty rows
SURE = 2.0 * np.log(1e4)  # nats: one log of 100 has a fault, 99 % sure; twice, as rows are not independent
WHOLE = 0.9  # of the rows: more than this is the whole log


def settled(won: Array, borne_out: Callable[[int, Mask], Any]) -> list[tuple[int, Mask, Any]]:
    """States that hold in some rows, these (rows,), and what is reported of it: those that are borne out.

    won (rows, K): log evidence by which each beats the sound one. Without one that is not, the path is
    another.
    """
    keep = list(range(won.shape[1]))
    while keep:
        path = viterbi(won[:, keep])
        held = [(k, path == i) for i, k in enumerate(keep) if np.any(path == i)]
        found = [(k, mine, borne_out(k, mine)) for k, mine in held]
        bad = {k for k, _, reported in found if reported is None}
        if not bad:
            return found
        keep = [k for k in keep if k not in bad]
    return []


def viterbi(won: Array) -> NDArray[np.intp]:
    """(rows,) the states of a chain, -1 sound, from nats (rows, K) by which each beats it; runs cost BEGINS.

    >>> viterbi(np.array([[-1.0], [9.0], [-1.0], [9.0], [-9.0]])).tolist()
    [-1, 0, 0, 0, -1]
    """
    rows, count = won.shape
    value = np.full(count, -np.inf)
    sound = 0.0
    stays, came = np.zeros((rows, count), bool), np.full(rows, -1, np.intp)
    for i in range(rows):
        enter = sound - BEGINS
        stays[i] = value >= enter
        leave = int(np.argmax(value))
        sound, came[i] = (value[leave], leave) if value[leave] > sound else (sound, -1)
        value = np.where(stays[i], value, enter) + won[i]
    out = np.full(rows, -1, np.intp)
    last = int(np.argmax(value))
    now = last if value[last] > sound else -1
    for i in range(rows - 1, -1, -1):
        out[i] = now
        if now < 0:
            now = int(came[i])
        elif not stays[i, now]:
            now = -1
    return out


def log_evidence_of(misses: Array) -> Array:
    """Against misses, in tolerances, by Student's t."""
    return np.asarray(0.5 * (HEAVY + 1.0) * np.log1p(misses**2 / HEAVY))
