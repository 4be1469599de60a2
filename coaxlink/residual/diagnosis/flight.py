"""The channels of a flight: body force and torque, and what a vehicle's premises leave open as priors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.channels.flight_problem import flight_variables
from coaxlink.residual.diagnosis.channels import Channels
from coaxlink.residual.diagnosis.decide import flown_nats
from coaxlink.residual.diagnosis.flight_search import FlightSearch, Flown
from coaxlink.residual.diagnosis.hypotheses import Hypothesis
from coaxlink.residual.diagnosis.parts import Block
from coaxlink.residual.diagnosis.shown import would_show as smallest
from coaxlink.residual.regression.joint_model import Part
from coaxlink.residual.regression.problem import Problem
from coaxlink.residual.result import HIDDEN, WouldShow

RESOLUTION = 2e-4  # of the reference load: 0.002 m/s^2 of an accelerometer, below any of these in the air
# of a rotor's load, judgement: what propellers of one mould, and their motors, differ by
THRUST_SCATTER, TORQUE_SCATTER = 0.0015, 0.008
LONG_ROWS = 60_000  # of a frame: beyond, fewer sets are fitted anew (seconds)
MANY_ROWS = 5_000  # judged rows: of longer flights some of the blocks are weighed (seconds)


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
        nuisance=(
            *(Block(n, columns(np.array([i])), np.array([0.5 * b])) for n, i, b in nuisance),
            *_scatter(frame, reduce),
        ),
        surface=(),
        forms={},
        effects=(),
        reduce=reduce,
        grid=[(o.effect, o.shape, columns(o.columns)) for o in p.options if "onset_s" not in o.shape],
    )


def _scatter(frame: FlightFrame, reduce: Callable[[Array], Array]) -> Iterator[Block]:
    """What each rotor's thrust and torque differ by from those of its kind."""
    none = np.zeros_like(frame.thrust)
    for k, rotor in enumerate(frame.airframe.rotors):
        one = np.eye(frame.thrust.shape[1])[k]
        pull = frame.airframe.body_loads(frame.thrust * one, none)
        drag = frame.airframe.body_loads(none, frame.torque * one)
        for load, columns, size in (("thrust", pull, THRUST_SCATTER), ("torque", drag, TORQUE_SCATTER)):
            yield Block(f"rotor{rotor.number}_{load}_share", reduce(columns)[..., None], np.array([size]))


def would_show(found: Flown, lead: Hypothesis) -> list[WouldShow]:
    """The smallest size of every effect of the grid that would have been named beside a set."""
    search = FlightSearch(found.search.scorer)
    search.visited.add(lead)
    sizes = smallest(search, flown_nats(), limited=True)
    shown = [WouldShow(n, s.share, s.channel) for n, s in sizes.items()]
    return sorted((w for w in shown if w.share < HIDDEN), key=lambda w: w.share)
