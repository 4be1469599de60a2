"""Elements that follow a path and slip, or forget: what a memory that wears in is made of.

Prandtl's play operators in a row, each of which sticks until it has slipped its own way (Iwan 1966, J.
Applied Mechanics 33, 893), and a state that fades with the way gone since (Dahl 1968, Aerospace Corporation
TOR-0158).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from coaxlink.effects.tracing import Array


def slipping(path: Array, ways: Array) -> Array:
    """(rows, K) states -1..1 of elements that follow the path (rows,) and slip after the ways (K,).

    Read-only: a search asks for the same states again and again.
    """
    return _slipping(np.asarray(path, float).tobytes(), np.asarray(ways, float).tobytes())


@lru_cache(maxsize=64)
def _slipping(path_of: bytes, ways_of: bytes) -> Array:
    """Two levels: pieces of the path become one map each, side by side, then run from their starts."""
    path, ways = np.frombuffer(path_of), np.frombuffer(ways_of)
    move = np.diff(path, prepend=path[0])[:, None] * (2.0 / ways)
    rows = len(move)
    length = max(1, int(np.sqrt(rows)))
    pieces = -(-rows // length)
    padded = np.zeros((pieces * length, len(ways)))
    padded[:rows] = move
    by_step = padded.reshape(pieces, length, -1).transpose(1, 0, 2)  # (length, pieces, K)
    shift = by_step.sum(axis=0)
    low, high = np.full_like(shift, -np.inf), np.full_like(shift, np.inf)
    ends = np.stack([low, high])
    for step in by_step:
        _slip(ends, step, -1.0, 1.0, ends)
    low, high = ends
    start = np.zeros_like(shift)
    for k in range(1, pieces):
        _slip(start[k - 1], shift[k - 1], low[k - 1], high[k - 1], start[k])
    out = np.empty_like(by_step)
    state = start
    for k, step in enumerate(by_step):
        state = _slip(state, step, -1.0, 1.0, out[k])
    states = np.ascontiguousarray(out.transpose(1, 0, 2).reshape(pieces * length, -1)[:rows])
    states.setflags(write=False)
    return states


def _slip(state: Array, step: Array, low: Array | float, high: Array | float, out: Array) -> Array:
    """The state (..., K) moved by a step and kept inside, into `out`; np.clip costs three times that."""
    np.add(state, step, out=out)
    np.minimum(out, high, out=out)
    return np.maximum(out, low, out=out)


def fading(path: Array, reach: float) -> Array:
    """(rows,) state -1..1 that follows the path (rows,) and forgets by 1/e over the way `reach`.

    Two levels, as `slipping`: every step is one line, state to state, and so is a piece of them.
    """
    move = np.diff(path, prepend=path[0]) / reach
    rows = len(move)
    length = max(1, int(np.sqrt(rows)))
    pieces = -(-rows // length)
    padded = np.zeros(pieces * length)
    padded[:rows] = move
    steps = padded.reshape(pieces, length).T  # (length, pieces)
    keep, add = np.exp(-np.abs(steps)), -np.sign(steps) * np.expm1(-np.abs(steps))
    slope, shift = np.ones(pieces), np.zeros(pieces)
    for k in range(length):
        slope, shift = slope * keep[k], shift * keep[k] + add[k]
    state = np.zeros(pieces)
    for k in range(1, pieces):
        state[k] = state[k - 1] * slope[k - 1] + shift[k - 1]
    out = np.empty_like(steps)
    for k in range(length):
        state = state * keep[k] + add[k]
        out[k] = state
    return np.asarray(out.T.ravel()[:rows])
