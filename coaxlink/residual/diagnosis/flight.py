"""The channels of a flight: body force and torque, and what a vehicle's premises leave open as priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.channels.flight_problem import flight_variables
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis, Scorer, begun
from coaxlink.residual.diagnosis.judge import NAMED_NATS
from coaxlink.residual.diagnosis.noise import colour_of, white
from coaxlink.residual.diagnosis.parts import Block
from coaxlink.residual.diagnosis.posterior import posterior
from coaxlink.residual.diagnosis.search import Search
from coaxlink.residual.diagnosis.shown import would_show as smallest
from coaxlink.residual.regression.joint_model import Member, Part
from coaxlink.residual.regression.problem import Problem
from coaxlink.residual.result import HIDDEN, WouldShow
from coaxlink.residual.search.trial import GAIN, SIZE

RESOLUTION = 2e-4  # of the reference load: 0.002 m/s^2 of an accelerometer, below any of these in the air
LONG_ROWS = 60_000  # of a frame: beyond, fewer sets are fitted anew (seconds)
MANY_ROWS = 10_000  # judged rows: of longer flights some of the blocks are weighed (seconds)


def flight_channels(bare: FlightFrame, known: Sequence[Part], p: Problem) -> Channels:
    """Channels of aligned flights, `bare` without what the model knows of already, and their regression.

    A correction's prior deviation is half its bound: the bound is two of them.
    """
    some = p.block % (-(-len(p.residual) // MANY_ROWS)) == 0
    bare, frame = (replace(f, keep=f.keep[some]) for f in (bare, p.frame))

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    def columns(use: np.ndarray) -> Array:
        return np.asarray(p.design[:, :, use][some] * p.sigma[:, None], float)

    target = p.residual[some] * p.sigma
    bounds = np.abs(p.blocks.bounds[p.nuisance])
    nuisance = zip(p.nuisance_names, p.nuisance, bounds, strict=True)
    return Channels(
        frame=frame,
        bare=bare,
        known=tuple(known),
        names=p.channels,
        units=p.units,
        reference=p.reference,
        target=target,
        block=np.unique(p.block[some], return_inverse=True)[1],
        least_noise=np.maximum(RESOLUTION * p.reference, frame.rounding),
        variables={n: v for n, v in flight_variables(frame).items() if np.ptp(v) > 0.0},
        speeds={c: (frame.speeds[frame.keep].mean(axis=1),) for c in range(len(p.channels))},
        weights=np.broadcast_to(p.reference, target.shape),
        nuisance=tuple(Block(n, columns(np.array([i])), np.array([0.5 * b])) for n, i, b in nuisance),
        surface=(),
        forms={},
        effects=(),
        reduce=reduce,
        grid=[(o.effect, o.shape, columns(o.columns)) for o in p.options if "onset_s" not in o.shape],
    )


def borne_out(ch: Channels, members: Sequence[Member]) -> dict[str, float]:
    """Tempered nats (`posterior`) of every member over the others alone; of a long flight about where they
    stand.
    """
    scorer, held = _own_colour(ch, members)

    def fitted(some: Sequence[Member], noise: Array) -> Hypothesis:
        if len(ch.bare.time_s) > LONG_ROWS:
            return scorer.linearised(some, (), noise)[0]
        return scorer.score(some, (), noise)

    best = fitted(held.members, held.fit.noise)
    without = [fitted([m for m in best.members if m is not mine], best.fit.noise) for mine in best.members]
    found = posterior(ch, scorer.colour, [best, *without])
    behind = {id(h): float(b) for h, b in zip(found.sets, found.behind, strict=True)}
    pairs = zip(best.members, without, strict=True)
    return {m.name: behind[id(h)] - behind[id(best)] for m, h in pairs}


def _own_colour(ch: Channels, members: Sequence[Member]) -> tuple[Scorer, Hypothesis]:
    """The scorer under the colour of what these members leave, and them as they stand."""
    held = [begun(ch, m.effect, m.shape, m.coefficients) for m in members]
    scorer = Scorer(ch, colour_of(Scorer(ch, white(ch.count)).linearised(held, (), None)[0].left))
    return scorer, scorer.linearised(held, (), None)[0]


def would_show(ch: Channels, members: Sequence[Member], rows: int) -> list[WouldShow]:
    """The smallest size of every effect of the grid that would have been named beside these members.

    Of `rows` judged rows: it has the evidence of a stand's names, and lowers the squared error of a channel
    by the share that the selection asks for.
    """
    scorer, held = _own_colour(ch, members)
    search = Search(scorer)
    search.visited.add(held)
    nats = max(NAMED_NATS, -0.5 * rows * float(np.log(1.0 - GAIN))) * len(ch.target) / rows
    found = smallest(search, nats, limited=True)
    shown = [WouldShow(n, max(s.share, SIZE), s.channel) for n, s in found.items()]
    return sorted((w for w in shown if w.share < HIDDEN), key=lambda w: w.share)
