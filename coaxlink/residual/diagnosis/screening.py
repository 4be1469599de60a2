"""What each of many explanations would add beside a hypothesis, all of them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.evidence.likelihood import JITTER
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.hypotheses import Hypothesis


class Stack:
    """Pieces of (whitened columns (rows, C, K), prior deviations (K,)), side by side by channel."""

    def __init__(self, pieces: Sequence[tuple[Array, Array]]) -> None:
        self.widths = np.array([len(d) for _, d in pieces], int)
        self.first = np.concatenate([[0], np.cumsum(self.widths)])[:-1]
        self.deviation = np.concatenate([np.zeros(0), *(d for _, d in pieces)])
        self.count = pieces[0][0].shape[1] if pieces else 0
        self.used: list[np.ndarray] = []
        self.columns: list[Array] = []
        self.own: list[list[Array | None]] = []
        each = [np.asarray(x.any(axis=0)) for x, _ in pieces]  # (C, K)
        for c in range(self.count):
            touched = [np.flatnonzero(of[c]) for of in each]
            parts = [x[:, c, t] for (x, _), t in zip(pieces, touched, strict=True)]
            offsets = zip(touched, self.first, strict=True)
            self.used.append(np.concatenate([t + at for t, at in offsets]).astype(np.intp))
            self.columns.append(np.concatenate(parts, axis=1))
            self.own.append([_own(x[:, c], t) for (x, _), t in zip(pieces, touched, strict=True)])

    def gains(self, h: Hypothesis, left: Array) -> list[float]:
        """(pieces,) log evidence each would add; `left` (rows, C) is what the hypothesis leaves, whitened.

        At its noise levels: what it leaves, against what each piece leaves of that beside it.
        """
        fit = h.fit
        weight = 1.0 / fit.noise**2
        cross = np.zeros((len(fit.deviation), len(self.deviation)))
        moment = np.zeros(len(self.deviation))
        for c, (used, columns) in enumerate(zip(self.used, self.columns, strict=True)):
            if len(used):
                beside = h.whitened(c)
                touched = np.flatnonzero(beside.any(axis=0))
                nuisance = np.ascontiguousarray(beside[:, touched].T)
                cross[np.ix_(touched, used)] += weight[c] * (nuisance @ columns)
                moment[used] += weight[c] * (left[:, c] @ columns)
        half = fit.half(cross * self.deviation)
        out = np.zeros(len(self.widths))
        for width in np.unique(self.widths):
            mine = np.flatnonzero(self.widths == width)
            at = self.first[mine][:, None] + np.arange(width)  # (pieces, K)
            deviation, halves = self.deviation[at], half[:, at]
            own = np.zeros((len(mine), width, width))
            for c in range(self.count):
                for i, k in enumerate(mine):
                    product = self.own[c][k]
                    if product is not None:
                        own[i] += weight[c] * product
            own *= deviation[:, :, None] * deviation[:, None, :]
            trace = np.maximum(np.trace(own, axis1=1, axis2=2), 1.0)
            inner = own - np.einsum("pak,pal->akl", halves, halves, optimize=True)
            inner += np.eye(width) * (1.0 + JITTER * trace)[:, None, None]
            low = np.linalg.cholesky(inner)
            z = np.linalg.solve(low, (moment[at] * deviation)[..., None])[..., 0]
            each = np.arange(width)
            out[mine] = 0.5 * np.sum(z**2, axis=1) - np.sum(np.log(low[:, each, each]), axis=1)
        return [float(g) for g in out]


def _own(columns: Array, touched: np.ndarray) -> Array | None:
    """(K, K) products of a piece's columns in one channel; None where it has none."""
    if not len(touched):
        return None
    return np.asarray(columns.T @ columns)
