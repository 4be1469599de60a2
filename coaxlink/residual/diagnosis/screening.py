"""What each of many explanations would add beside a hypothesis, all of them at once."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from coaxlink.evidence.likelihood import JITTER
from coaxlink.frames import Array
from coaxlink.residual.diagnosis.hypotheses import Hypothesis


class Stack:
    """Pieces of (whitened columns (rows, C, K), prior deviations (K,)), side by side by channel."""

    def __init__(self, pieces: Iterable[tuple[Array, Array]]) -> None:
        deviations = list[Array]()
        used: list[list[np.ndarray]] = []
        columns: list[list[Array]] = []
        self.own: list[list[Array | None]] = []
        start = 0
        for x, deviation in pieces:  # each by itself: all of them, in all channels, are large
            while len(used) < x.shape[1]:
                used.append([])
                columns.append([])
                self.own.append([])
            for c, of in enumerate(np.asarray(x.any(axis=0))):
                touched = np.flatnonzero(of)
                used[c].append(start + touched)
                columns[c].append(x[:, c, touched])
                self.own[c].append(x[:, c].T @ x[:, c] if len(touched) else None)
            deviations.append(deviation)
            start += len(deviation)
        self.count = len(used)
        self.widths = np.array([len(d) for d in deviations], int)
        self.first = np.concatenate([[0], np.cumsum(self.widths)])[:-1]
        self.deviation = np.concatenate([np.zeros(0), *deviations])
        self.used = [np.concatenate(of).astype(np.intp) for of in used]
        self.columns = [np.concatenate(of, axis=1) for of in columns]

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
