"""Faults of instruments as explanations of the same rows, weighed against the best set of effects.

A cell that can read no further shows its limit, whatever the load, as an effect that grows with it might:
a model of the readings in some of the rows. Where it beats everything physics offers, those rows are flagged
and left out. What no effect could be is found before (`instruments`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.stand import COLUMN_OF
from coaxlink.evidence.blocks import Block
from coaxlink.evidence.noise import white
from coaxlink.frames import STAND_CHANNELS, Array, StandFrame
from coaxlink.instruments.findings import Suspect, rows_text
from coaxlink.instruments.stand.reference import TOLERANCE
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import ODDS, Hypothesis, Scorer
from coaxlink.residual.diagnosis.posterior import CLAIMED

Mask = NDArray[np.bool_]
LIMITS = (0.98, 0.95, 0.9, 0.8, 0.7, 0.6, 0.5)  # quantiles of the readings: where a limit may lie
FAULT_ROUNDS = 4
# of the rows, judgement: less is an outlier, more is what the log is like
LEAST_SHARE, MOST_SHARE = 0.01, 0.5
LEAST_ROWS = 8  # judgement: a limit and its spread want several readings
EXCESS = 0.03  # of the reference load, what is cut off on the average: TOLERANCE, less is its own error
WITHIN = 3.0  # standard deviations of the readings at a limit


@dataclass(frozen=True)
class Fault:
    """An instrument that is wrong in some rows of a log, and the channels as it would have them."""

    column: str
    why: str
    rows: Mask  # (frame rows,)
    mended: Callable[[], Channels]
    log_prior: float  # of its numbers, and of the change of variables


@dataclass(frozen=True)
class Weighed:
    """The most probable fault of a log: its words, its rows, and the nats by which it beats the effects."""

    suspect: Suspect
    rows: Mask
    log_evidence: float


def weighed_faults(ch: Channels, best: Hypothesis) -> Weighed | None:
    """The fault that is more probable than the best set of effects and free forms; None where none is."""
    plain = Scorer(ch, white(ch.count))
    rival = max(plain.score(best.members, best.forms, best.fit.noise).score, plain.empty.score)
    found: Weighed | None = None
    for fault in _saturated(ch):
        other = fault.mended()
        scorer = Scorer(other, white(other.count))
        score = scorer.empty.score
        if best.members or best.forms:
            forms = tuple(f for f in best.forms if f in other.forms)
            score = max(score, scorer.score(best.members, forms, best.fit.noise).score)
        log_evidence = score + fault.log_prior + float(ODDS) - rival
        if log_evidence > np.log(CLAIMED / (1.0 - CLAIMED)) and (
            found is None or log_evidence > found.log_evidence
        ):
            why = f"{fault.why} (log evidence {log_evidence:.0f} above every effect's)"
            found = Weighed(
                Suspect(fault.column, rows_text(fault.rows), why), fault.rows, float(log_evidence)
            )
    return found


def _saturated(ch: Channels) -> Iterator[Fault]:
    """Cells that read no further than a limit."""
    frame: StandFrame = ch.frame
    for k, c in enumerate(frame.present):
        if c > 3:
            continue
        x, prior = _nuisance_of(ch, k)
        read = frame.measured[frame.keep, c]
        best: tuple[float, Mask, float] | None = None
        for start in np.quantile(read, LIMITS):
            cut = _cut_off(ch, k, x, prior, read, float(start))
            if cut is not None and (best is None or cut[0] < best[0]):
                best = cut
        if best is None:
            continue
        _, over, limit = best
        spread = float(np.std(read[over]))
        rows = (
            np.abs(frame.measured[:, c] - limit) < WITHIN * spread
        )  # of a long log not every row is weighed
        rows[frame.keep] = over
        exact = max(spread / np.sqrt(over.sum()), 1e-9 * ch.reference[k])
        prior_of_limit = np.log(exact / ch.reference[k])
        yield Fault(
            COLUMN_OF[STAND_CHANNELS[c]],
            f"the cell reads no further than {limit:.4g}, where speeds give more: it is saturated",
            rows,
            partial(_at_limit, ch, k, over, limit),
            float(min(prior_of_limit, 0.0)),
        )


def _nuisance_of(ch: Channels, k: int) -> tuple[Array, Array]:
    """(rows, P) columns of base and map in one channel, and their deviations."""
    blocks = [b for b in (*ch.nuisance, *ch.surface) if b.columns[:, k].any()]
    x = np.concatenate([b.columns[:, k] for b in blocks], axis=1)
    return x, np.concatenate([b.deviation for b in blocks])


def _cut_off(
    ch: Channels, k: int, x: Array, prior: Array, read: Array, limit: float
) -> tuple[float, Mask, float] | None:
    """Squares left, rows beyond the limit by what the others say, and the limit; begun at one."""
    size = float(ch.reference[k])
    over = read > limit - 0.5 * TOLERANCE * size
    known = read - ch.target[:, k]  # the load as it is predicted
    for _ in range(FAULT_ROUNDS):
        if not _fair(over):
            return None
        rest = ~over
        a = x[rest] * prior / (0.01 * size)
        fit = prior * np.linalg.solve(
            a.T @ a + np.eye(len(prior)), a.T @ (ch.target[rest, k] / (0.01 * size))
        )
        due = known + x @ fit
        limit = float(np.median(read[over]))
        now = due > limit
        if np.array_equal(now, over):
            break
        over = now
    if not _fair(over) or float(np.mean(due[over] - limit)) < EXCESS * size:
        return None
    # at a limit the reading stays where the load goes up and down, further than a nuisance model may err
    if np.std(due[over]) < np.hypot(np.std(read[over]), TOLERANCE * size):
        return None
    left = np.where(over, read - limit, read - due)
    return float(np.sum(left**2)), over, limit


def _fair(rows: Mask) -> bool:
    share = float(np.mean(rows))
    return LEAST_SHARE < share < MOST_SHARE and int(rows.sum()) >= LEAST_ROWS


def _at_limit(ch: Channels, k: int, over: Mask, limit: float) -> Channels:
    """The channels with a constant for one channel's model in some rows."""

    def without(columns: Array) -> Array:
        out = columns.copy()
        out[over, k] = 0.0
        return out

    def cut(block: Block) -> Block:
        return replace(block, columns=without(block.columns))

    def form(name: str) -> Block:
        return cut(ch.forms[name]())

    target = ch.target.copy()
    read = ch.frame.measured[ch.frame.keep, ch.frame.present[k]]
    target[over, k] = read[over] - limit
    return replace(
        ch,
        target=target,
        nuisance=tuple(map(cut, ch.nuisance)),
        surface=tuple(map(cut, ch.surface)),
        forms={name: partial(form, name) for name in ch.forms},
        reduce=lambda columns: without(ch.reduce(columns)),
        grid=[],
    )
