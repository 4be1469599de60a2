"""The channels of a flight: body force and torque, and what a vehicle's premises leave open as priors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from coaxlink.channels.flight import reduce_columns
from coaxlink.channels.flight_corrections import flight_corrections
from coaxlink.channels.flight_floor import flight_variables, runs_of
from coaxlink.effects import flight_effects
from coaxlink.effects.tracing import Tracing
from coaxlink.evidence.blocks import Block, products, waves
from coaxlink.evidence.held_out import contiguous_blocks
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.residual.diagnosis.channels import Channels, possible
from coaxlink.residual.diagnosis.decide import flown_evidence
from coaxlink.residual.diagnosis.flight_search import FlightSearch, Flown
from coaxlink.residual.diagnosis.hypotheses import Hypothesis
from coaxlink.residual.diagnosis.shown import would_show as smallest
from coaxlink.residual.members import composed, known_parts
from coaxlink.residual.result import HIDDEN, WouldShow

RESOLUTION = 2e-4  # of the reference load: 0.002 m/s^2 of an accelerometer, below any of these in the air
# of a rotor's load, judgement: what propellers of one mould, and their motors, differ by
THRUST_SCATTER, TORQUE_SCATTER = 0.0015, 0.008
MODEL_LENGTH = 0.05  # of full speed, judgement: half of what lies between levels, where a stand runs ten
UNFELT = 1e-3  # of the least noise's variance, over all rows: 5e-4 nats
MANY_ROWS = 5_000  # judged rows: of longer flights some of the blocks are weighed (seconds)


def flight_channels(bare: FlightFrame, most: int = MANY_ROWS) -> Channels:
    """Channels of aligned flights, `bare` without the effects that their model carries already.

    A correction's prior deviation is half its bound: the bound is two of them.
    """
    known, notes = known_parts(bare, flight_effects(), "flight", partial(_unlogged, bare))
    frame = composed(bare, known)
    block = contiguous_blocks(frame.time_s[frame.keep], runs_of(frame), least_s=2.0, count=40)
    some = block % (-(-len(block) // most)) == 0
    bare, frame = (replace(f, keep=f.keep[some]) for f in (bare, frame))

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    asked = [e for e in flight_effects() if e.name not in frame.ruled_out]
    able, unable = possible(frame, asked)
    target = reduce(frame.measured - frame.predicted)
    corrections = (
        Block(c.name, reduce(c.columns)[..., None], np.array([0.5 * c.bound]))
        for c in flight_corrections(frame)
    )
    return Channels(
        frame=frame,
        bare=bare,
        known=tuple(known),
        names=FLIGHT_CHANNELS,
        units=FLIGHT_UNITS,
        reference=frame.reference,
        target=target,
        block=np.unique(block[some], return_inverse=True)[1],
        least_noise=RESOLUTION * frame.reference,
        variables={n: v for n, v in flight_variables(frame).items() if np.ptp(v) > 0.0},
        speeds={c: (frame.speeds[frame.keep].mean(axis=1),) for c in range(len(FLIGHT_CHANNELS))},
        weights=np.broadcast_to(frame.reference, target.shape),
        nuisance=(*corrections, *_scatter(frame, reduce)),
        surface=tuple(_model_missed(frame, reduce)),
        forms={},
        effects=tuple(able),
        reduce=reduce,
        notes=tuple(notes),
        impossible=(*frame.ruled_out.items(), *unable),
    )


def _unlogged(frame: FlightFrame, effect: Tracing[Any]) -> str | None:
    """What an effect of the model needs and the log lacks; whether it varies enough does not matter here."""
    if effect.name in frame.ruled_out:
        return frame.ruled_out[effect.name]
    logged = {"voltage_V": frame.voltage, "height_m": frame.height}
    absent = [name for name, values in logged.items() if name in effect.needs and values is None]
    return f"it needs {absent[0]}, which the log lacks" if absent else None


def _scatter(frame: FlightFrame, reduce: Callable[[Array], Array]) -> Iterator[Block]:
    """What each rotor's thrust and torque differ by from those of its kind."""
    none = np.zeros_like(frame.thrust)
    for k, rotor in enumerate(frame.airframe.rotors):
        one = np.eye(frame.thrust.shape[1])[k]
        pull = frame.airframe.body_loads(frame.thrust * one, none)
        drag = frame.airframe.body_loads(none, frame.torque * one)
        for load, columns, size in (("thrust", pull, THRUST_SCATTER), ("torque", drag, TORQUE_SCATTER)):
            yield Block(f"rotor{rotor.number}_{load}_share", reduce(columns)[..., None], np.array([size]))


def _model_missed(frame: FlightFrame, reduce: Callable[[Array], Array]) -> Iterator[Block]:
    """What a rotor model left of its own stand log, over the speeds and alike in all pairs: a flight that
    shows it again shows nothing new."""
    rows, upper_of = len(frame.thrust), {lower: upper for upper, lower in frame.airframe.pairs}
    least = RESOLUTION * frame.reference
    for load, size in frame.model.missed.items():
        rotors = [k for k, r in enumerate(frame.airframe.rotors) if load.channel.startswith(r.level)]
        if not rotors:
            continue
        over = [rotors] if load.channel.startswith("upper") else [rotors, [upper_of[k] for k in rotors]]
        along = [_over(frame.speeds[:, each]) for each in over]

        def process(k: int, along: Sequence[tuple[Array, Array]] = along, size: float = size) -> Array:
            """Of one rotor, (rows, K), each function times its deviation."""
            of_one = [(f.reshape(rows, -1, f.shape[-1])[:, k], d) for f, d in along]
            functions, deviation = products(*of_one) if len(of_one) > 1 else of_one[0]
            return size * deviation * functions

        def body(one: Array, pulls: bool = load.unit == "N") -> Array:
            none = np.zeros_like(one)
            return frame.airframe.body_loads(one, none) if pulls else frame.airframe.body_loads(none, one)

        gram = 0.0
        for k, seen in enumerate(
            np.abs(body(np.eye(len(frame.airframe.rotors))[rotors]) / least).max(axis=1)
        ):
            felt = process(k)[frame.keep] * seen
            gram = gram + felt.T @ felt
        strength, ways = np.linalg.eigh(gram)
        ways = ways[:, strength > UNFELT]
        loads = np.zeros((ways.shape[1], rows, len(frame.airframe.rotors)))
        for k, rotor in enumerate(rotors):
            loads[..., rotor] = (process(k) @ ways).T
        columns = np.zeros((len(frame.keep), len(FLIGHT_CHANNELS), len(loads)))
        for m, one in enumerate(loads):
            columns[..., m] = reduce(body(one))
        yield Block(f"{load.channel} model", columns, np.ones(len(loads)))


def _over(speeds: Array) -> tuple[Array, Array]:
    """Functions (rows rotors, K) over the speeds of rotors (rows, rotors), and their deviations."""
    return waves(speeds.ravel(), MODEL_LENGTH / max(float(np.ptp(speeds)), MODEL_LENGTH))


def would_show(found: Flown, lead: Hypothesis) -> list[WouldShow]:
    """The smallest size of every effect of the grid that would have been named beside a set."""
    search = FlightSearch(found.search.scorer)
    search.visited.add(lead)
    sizes = smallest(search, flown_evidence(), limited=True)
    shown = [WouldShow(n, s.share, s.channel) for n, s in sizes.items()]
    return sorted((w for w in shown if w.share < HIDDEN), key=lambda w: w.share)
