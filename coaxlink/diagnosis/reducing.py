"""The low-pass of a flight as one sparse matrix: what it gives at judged rows, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix, vstack

from coaxlink.frames import Array, FlightFrame
from coaxlink.signals import low_pass

SMALL = 1e-7  # of the largest weight: less is left out


def reducing(frame: FlightFrame) -> Callable[[Array], Array]:
    """`residual.channels.flight.reduce_columns` of this frame: (rows, ...) in, (kept, ...) out.

    Ends of a stretch are mirrored through their last row, as the filter itself does.
    """
    pulse = np.zeros(2 * _reach(frame) + 1)
    pulse[len(pulse) // 2] = 1.0
    weights = low_pass(pulse[:, None], frame.rate_hz, frame.cutoff_hz)[:, 0]
    used = np.flatnonzero(np.abs(weights) > SMALL * np.max(np.abs(weights)))
    offsets, weights = used - len(pulse) // 2, weights[used]
    pieces = []
    for number in np.unique(frame.stretch):
        rows = np.flatnonzero(frame.stretch == number)
        first, last = int(rows[0]), int(rows[-1])
        kept = frame.keep[(frame.keep >= first) & (frame.keep <= last)]
        if len(kept):
            pieces.append(_taps(kept, offsets, weights, (first, last), len(frame.time_s)))
    matrix = vstack(pieces).tocsr()

    def reduce(columns: Array) -> Array:
        flat = np.ascontiguousarray(columns).reshape(len(columns), -1)
        out = np.zeros((matrix.shape[0], flat.shape[1]))
        moving = np.flatnonzero(flat.any(axis=0))
        out[:, moving] = matrix @ np.ascontiguousarray(flat[:, moving])
        return out.reshape(matrix.shape[0], *columns.shape[1:])

    return reduce


def _reach(frame: FlightFrame) -> int:
    """Rows after which the filter has forgotten: ten of its time constants."""
    return int(np.ceil(5.0 * frame.rate_hz / frame.cutoff_hz))


def _taps(
    kept: np.ndarray, offsets: np.ndarray, weights: Array, ends: tuple[int, int], rows: int
) -> csr_matrix:
    first, last = ends
    at = kept[:, None] + offsets
    value = np.broadcast_to(weights, at.shape)
    row = np.broadcast_to(np.arange(len(kept))[:, None], at.shape)
    low, high = at < first, at > last
    mirrored = np.where(low, 2 * first - at, np.where(high, 2 * last - at, at))
    mirrored = np.clip(mirrored, first, last)
    sign = np.where(low | high, -1.0, 1.0)
    entries = [(row.ravel(), mirrored.ravel(), (sign * value).ravel())]
    for outside, end in ((low, first), (high, last)):
        if outside.any():
            entries.append((row[outside], np.full(int(outside.sum()), end), 2.0 * value[outside]))
    r, c, v = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return csr_matrix((v, (r, c)), shape=(len(kept), rows))
