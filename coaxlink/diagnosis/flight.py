"""The channels of a flight: body force and torque, low-passed, at the judged rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from coaxlink.diagnosis.channels import Channels, possible
from coaxlink.diagnosis.parts import Block, in_channel, waves
from coaxlink.diagnosis.reducing import reducing
from coaxlink.effects import flight_effects
from coaxlink.effects.tracing import Shape, Tracing
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.residual.base.flight_corrections import flight_corrections
from coaxlink.residual.channels.flight_problem import flight_variables, known_parts, runs_of
from coaxlink.residual.regression.joint_model import composed
from coaxlink.residual.regression.problem import contiguous_blocks

MANY_ROWS = 1500  # of a longer flight, one block in so many is searched
RESOLUTION = 2e-4  # of the reference load
LEAST_SIZE = 0.0025  # of the reference load: what a sound vehicle's model is off by
BLOCKS, LEAST_BLOCK_S = 40, 2.0
MANY_BEGINNINGS = 160  # of one effect in all its forms; the best is then found to a tenth of the grid
FORM_SIZES, FORM_LENGTHS = (0.02,), (0.1, 0.4)


def flight_channels(bare: FlightFrame, most: int = MANY_ROWS) -> Channels:
    """Channels of a flight whose suspect rows are left out already."""
    block = _blocks(bare)
    share = -(-len(bare.keep) // most)
    if share > 1:
        bare = replace(bare, keep=bare.keep[block % share == 0])
    known, notes = known_parts(bare)
    frame = composed(bare, known)
    reduce = reducing(frame)
    able, unable = possible(frame, flight_effects())
    names, reference = tuple(FLIGHT_CHANNELS), frame.reference
    target = reduce(frame.measured - frame.predicted)
    variables = flight_variables(frame)
    variables |= {f"motor{k + 1}": frame.speeds[frame.keep, k] for k in range(frame.speeds.shape[1])}
    variables = {n: v for n, v in variables.items() if np.ptp(v) > 0.0}
    usual = frame.speeds[frame.keep].mean(axis=1)
    return Channels(
        kind="flight",
        frame=frame,
        bare=bare,
        known=tuple(known),
        names=names,
        units=tuple(FLIGHT_UNITS),
        reference=reference,
        target=target,
        block=_blocks(bare),
        least_noise=RESOLUTION * reference,
        variables=variables,
        speeds=dict.fromkeys(range(len(names)), (usual,)),
        weights=np.abs(reduce(frame.predicted)),
        base=tuple(
            Block(c.name, reduce(c.columns)[..., None], np.array([c.bound / 2.0]))
            for c in flight_corrections(frame)
        ),
        surface=(),
        forms=_forms(names, variables, reference),
        effects=tuple(able),
        reduce=reduce,
        notes=(*frame.notes, *notes),
        impossible=tuple(unable),
        behind=_behind(frame),
        least_size=LEAST_SIZE,
        more_shapes=_begun_later,
    )


def _blocks(frame: FlightFrame) -> np.ndarray:
    return np.asarray(
        contiguous_blocks(frame.time_s[frame.keep], runs_of(frame), least_s=LEAST_BLOCK_S, count=BLOCKS)
    )


def _behind(frame: FlightFrame) -> np.ndarray:
    """(kept,) judged rows right before each."""
    runs = runs_of(frame)
    first = np.flatnonzero(np.diff(runs, prepend=-1))
    return np.asarray(np.arange(len(runs)) - first[np.cumsum(np.diff(runs, prepend=-1) != 0) - 1], np.intp)


def _begun_later(frame: FlightFrame, effect: Tracing[FlightFrame]) -> list[Shape]:
    """Shapes of an effect that begins at one of the blocks' edges, where it may."""
    if not effect.sudden:
        return []
    out: list[Shape] = []
    shapes, edges = effect.shapes(frame), np.flatnonzero(np.diff(_blocks(frame)))
    edges = edges[:: max(1, -(-len(shapes) * len(edges) // MANY_BEGINNINGS))]
    for shape in shapes:
        low, high = effect.free(frame, {**shape, "onset_s": 0.0}).get("onset_s", (1.0, 0.0))
        times = frame.time_s[frame.keep[edges]]
        out += [{**shape, "onset_s": float(t)} for t in times if low < t < high]
    return out


def _forms(
    names: tuple[str, ...], variables: dict[str, Array], reference: Array
) -> dict[str, Callable[[], Block]]:
    out: dict[str, Callable[[], Block]] = {}
    for k, name in enumerate(names):
        for variable, values in variables.items():
            for length in FORM_LENGTHS:
                for size in FORM_SIZES:
                    key = f"{variable}|{name}|{length}|{size}"
                    out[key] = partial(_form, name, values, length, size, float(reference[k]), k, len(names))
    return out


def _form(
    name: str, values: Array, length: float, size: float, reference: float, channel: int, count: int
) -> Block:
    functions, deviation = waves(values, length)
    return in_channel(name, (functions, deviation * size * reference), np.ones(len(values)), channel, count)
