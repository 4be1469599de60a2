"""Posterior checks of a flight's effects: intervals with zero, onsets that a smooth trend explains as well.

A member is chosen by how much it explains, in a shape from a grid. Fitted freely beside the others it may
turn out to be nothing (its main number's interval includes none), with a second number grown absurd that
follows some misfit. And a beginning in mid-flight takes up any slow force, for a step explains half a ramp.
A step is believed if a smooth trend of the same effect over the flight, straight between knots, does clearly
worse. Mass, centre of mass and a failing rotor are constant but for their beginning: what leaves its own
channel far above the noise, or running a trend of its own over the flight, took up a part of something slow.
And what lowers one channel's large residual a little while others, near their noise, rise is no gain.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coaxlink.effects.onset import COMES
from coaxlink.effects.tracing import Array
from coaxlink.residual.regression.blocks import Blocks, accumulate, bootstrap, held_out
from coaxlink.residual.regression.dependence import hats
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Joint, Member, columns_of
from coaxlink.residual.regression.problem import Index, Option, Problem
from coaxlink.residual.result import Step
from coaxlink.residual.search.select import LITTLE, Selection

DRAWS = 200
KNOTS = (2, 3, 5, 8, 12)  # of smooth trends over the flight
KNOT_BLOCKS = 2.5  # from knot to knot, at least: held-out blocks lie between them
MUCH_LEFT = 2.5  # of the floor, in the channel that the member explains best
MOST_OF_IT = 0.95  # of that channel's squared error: what takes this much may leave more
SPOILT = 0.05  # of the logarithm of errors, channels together
NEEDED = 0.01  # of some channel's error
BENDS, LEFT = 0.5, 2.0  # share that a smooth trend takes of what was left; times the floor


@dataclass(frozen=True)
class Doubt:
    """An effect that fails a posterior check, or whose onset does."""

    name: str
    onset: bool
    why: str


def disbelieved(
    p: Problem, joint: Joint, floor: Array, had: Collection[str] = (), *, derived: Collection[str] = ()
) -> list[Doubt]:
    """Effects of a flight's joint fit that fail a posterior check; `p` is the problem they were chosen in.

    `had` are names that the model carries already: those are not struck out. `derived` ones have another
    reason than a smaller error.
    """
    q = joint.problem
    draws = bootstrap(q.blocks, columns_of(q), DRAWS)
    out = []
    for k, m in enumerate(joint.members):
        if m.name in had:
            continue
        onset = "onset_s" in m.shape
        why = nil(joint, k, draws) or spoils(joint, k)
        if why is None and m.name not in derived:
            why = needless(joint, k)
        if why is None and m.effect.sudden:
            why = _no_cause(p, joint, k, floor)
        if why is not None:
            out.append(Doubt(m.name, onset, why))
    return out


def without(p: Problem, doubts: Sequence[Doubt]) -> Problem:
    """The problem with what is doubted no longer offered: the effect, or its beginnings in mid-flight."""
    gone = {(d.name, d.onset) for d in doubts}

    def stays(o: Option) -> bool:
        return (o.name, False) not in gone and ((o.name, True) not in gone or "onset_s" not in o.shape)

    return replace(p, options=tuple(o for o in p.options if stays(o)))


def undone(selection: Selection, names: Collection[str], why: str = "") -> Selection:
    """The selection with these not chosen; the one given stays as it is. With a reason its trace says so."""
    kept, doubtful = (
        [o for o in part if o.name not in names] for part in (selection.members, selection.doubtful)
    )
    doubts = [a for a in selection.ambiguous if not {*a.names} & {*names}]
    trace = [*selection.trace]
    trace += [Step(9, "drop", name, 0.0, 1.0, 0.0, True, why) for name in sorted(names) if why]
    return replace(selection, members=kept, doubtful=doubtful, ambiguous=doubts, trace=trace)


def nil(joint: Joint, k: int, draws: Array) -> str | None:
    """Why effect k may be zero; `draws` (n, P) are coefficients of the block bootstrap."""
    m, q = joint.members[k], joint.problem
    sampled = [joint.named(k, d) for d in draws]
    none = {n: v for n, v in m.effect.nil(q.frame).items() if n in m.parameters(q.frame)}
    said = []
    for name, value in none.items():
        low, high = np.quantile([s[name] for s in sampled], [0.025, 0.975])
        if not low <= value <= high:
            return None
        said.append(f"{name} {low:.2g} .. {high:.2g}")
    return f"nothing by its own numbers: {', '.join(said)}" if said else None


def spoils(joint: Joint, k: int) -> str | None:
    """Why effect k is worth nothing: the channels, in units of their residuals, keep a larger error."""
    q = joint.problem
    rest = [o for i, o in enumerate(q.options) if i != k]
    after, before = (float(np.sum(np.log(channel_errors(q, options)))) for options in (q.options, rest))
    return "what it takes from one channel it adds to others" if after > before + SPOILT else None


def needless(joint: Joint, k: int) -> str | None:
    """Why effect k is not asked for: what it acts on errs no more without it, base and others fitted anew.

    What it takes elsewhere is then the nuisance's: a mass that is none lets thrust levels stray to mend
    torques.
    """
    q = joint.problem
    mine = np.array([name in joint.members[k].effect.channels for name in q.channels])
    rest = [o for i, o in enumerate(q.options) if i != k]
    after, before = channel_errors(q, q.options)[mine], channel_errors(q, rest)[mine]
    return "what it acts on errs no more without it" if np.all(after > (1.0 - NEEDED) * before) else None


def _seconds(p: Problem) -> float:
    """Length of a block."""
    time = p.frame.time_s[p.frame.keep]
    return float(np.median([np.ptp(time[p.block == b]) for b in range(p.blocks.count)]))


class _TimeProfiles:
    """Held-out errors with a smooth trend of a member's columns beside or instead of its step."""

    def __init__(self, p: Problem, joint: Joint, k: int, plain: Option) -> None:
        q, m = joint.problem, joint.members[k]
        own = q.options[k].columns
        steady = p.design[:, :, plain.columns] * (p.sigma / q.sigma)[:, None]
        time = q.frame.time_s[q.frame.keep]
        pieces: list[Array] = [q.design]
        at = q.design.shape[-1]
        self.trends: list[Index] = []
        most = np.ptp(time) / max(KNOT_BLOCKS * _seconds(q), 1e-9)
        for count in [n for n in KNOTS if n == 2 or n - 1 <= most]:
            bumps = hats(time, np.linspace(time[0], time[-1], count))
            trend = (steady[..., None] * bumps[:, None, None, :]).reshape(*steady.shape[:2], -1)
            pieces.append(trend.astype(q.design.dtype))
            self.trends.append(np.arange(at, at + trend.shape[-1]))
            at += trend.shape[-1]
        design = np.concatenate(pieces, axis=-1)
        bounds = np.concatenate([q.blocks.bounds, np.full(at - q.design.shape[-1], np.inf)])
        self.blocks: Blocks = accumulate(design, q.residual, q.block, q.blocks.fold, bounds)
        others = [o.columns for i, o in enumerate(q.options) if i != k]
        self.rest = np.concatenate([q.nuisance, *others]).astype(np.intp)
        self.step = own[: len(m.coefficients)]

    def squares(self, *columns: Index) -> Array:
        """(C,) held-out square sums of the nuisance model, the other members and these columns."""
        return held_out(self.blocks, np.concatenate([self.rest, *columns]).astype(np.intp))[0].sum(axis=0)


def _no_cause(p: Problem, joint: Joint, k: int, floor: Array) -> str | None:
    """Why member k, constant from its beginning on, does not explain what it takes up, or did not begin."""
    q, m = joint.problem, joint.members[k]
    plain = _steady_option(p, m)
    if plain is None:
        return None
    c = _TimeProfiles(p, joint, k, plain)
    mine = np.array([name in m.effect.channels for name in q.channels])
    before, after = c.squares(), c.squares(c.step)
    share = np.where(mine, 1.0 - after / np.maximum(before, 1e-12), -np.inf)
    best = int(np.argmax(share))
    over = float(channel_errors(q, q.options)[best] / floor[best])
    if over > MUCH_LEFT and share[best] < MOST_OF_IT:
        return f"leaves {q.channels[best]} at {over:.1f} times the noise: not its cause"
    rows, begins = float(q.blocks.rows.sum()), "onset_s" in m.shape
    # what comes gradually is a smooth trend itself, of two numbers: another must do clearly better, and where
    # this one takes most of it, how exactly it came is no doubt that it did
    least, as_good = (-LITTLE, "better than") if "over_s" in m.shape else (LITTLE, "as well as")
    least = -np.inf if "over_s" in m.shape and share[best] > MOST_OF_IT else least
    for trend in c.trends:
        lead = 0.5 * rows * float(np.sum(np.log(c.squares(trend) / after)[mine])) if begins else np.inf
        if lead < least:
            return f"a smooth trend over the flight does {as_good} its beginning"
        if (
            over > LEFT
            and share[best] < MOST_OF_IT
            and 1.0 - c.squares(c.step, trend)[best] / after[best] > BENDS
        ):
            return f"{q.channels[best]} still has a trend over the flight: no constant is its cause"
    return None


def _steady_option(p: Problem, m: Member) -> Option | None:
    """The effect in the member's shape, there from the start."""
    shape: dict[str, Any] = {key: v for key, v in m.shape.items() if key not in COMES}
    return next((o for o in p.options if o.name == m.name and dict(o.shape) == shape), None)


def settled(joint: Joint, floor: Array, *channels: str) -> bool:
    """Whether channels are explained well enough for their level, or their scale, to mean anything."""
    q = joint.problem
    use = [q.channels.index(name) for name in channels]
    return bool(np.all((channel_errors(q, q.options) < MUCH_LEFT * floor)[use]))
