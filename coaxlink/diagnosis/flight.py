"""The channels of a flight: body force and torque, low-passed, at the judged rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from coaxlink.diagnosis.channels import Channels, possible
from coaxlink.diagnosis.feedback import feedback
from coaxlink.diagnosis.parts import Block, in_channel, waves
from coaxlink.diagnosis.reducing import reducing
from coaxlink.diagnosis.unlogged import unlogged_supply
from coaxlink.effects import flight_effects
from coaxlink.effects.onset import GRADUAL, gradual
from coaxlink.effects.rotor_lag import late_speeds
from coaxlink.effects.tracing import Shape, Tracing
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.residual.base.flight_corrections import flight_corrections
from coaxlink.residual.channels.flight_problem import flight_variables, known_parts, runs_of
from coaxlink.residual.regression.joint_model import composed
from coaxlink.residual.regression.problem import contiguous_blocks

MANY_ROWS = 1500  # of a longer flight, one block in so many is searched
RESOLUTION = 2e-4  # of the reference load
LEAST_SIZE = 0.0025  # of the reference load: what a sound vehicle's model is off by
# of an accelerometer's zero over a flight: a board warms by 10 to 20 K, 0.2 mg a K (data sheets: 0.1 to 1)
ACCEL_WANDER_M_S2 = 0.03
UNLIKE = 0.005  # of its load, by which rotors of one kind differ
LAG_SHARE = 0.15  # of the declared lag: it goes with the supply, the speed, and whether it rises
LAG_FORM = 0.3  # of the way from one lag to two of half the length in a row
BLOCKS, LEAST_BLOCK_S = 40, 2.0
MANY_BEGINNINGS = 160  # of one effect in all its forms; the best is then found to a tenth of the grid
MIDDLE = (0.005, 0.995)
SHORT_TIME = 0.05  # of the flight: what comes and goes
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
    corrections = flight_corrections(frame)
    base = [Block(c.name, reduce(c.columns)[..., None], np.array([c.bound / 2.0])) for c in corrections]
    base += _late(frame, reduce) + _wandering(frame) + _unlike(frame, reduce)
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
        base=(*base, *feedback(frame, reduce)),
        surface=(),
        forms=_forms(names, variables, reference) | unlogged_supply(frame, reduce),
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


def _late(frame: FlightFrame, reduce: Callable[[Array], Array]) -> list[Block]:
    """What the declared lag may be off by: its length, and that a motor is more than one lag."""
    lag = frame.airframe.motor_lag_s
    if lag <= 0.0:
        return []
    longer = frame.turning_at(frame.filtered(frame.commands, (1.0 + LAG_SHARE) * lag)).predicted
    twice = frame.turning_at(late_speeds(frame, {"lag_s": lag, "second": 1.0})).predicted
    return [
        Block("motor_lag_share", reduce(longer - frame.predicted)[..., None], np.array([1.0])),
        Block("motor_lag_form", reduce(twice - frame.predicted)[..., None], np.array([LAG_FORM])),
    ]


def _wandering(frame: FlightFrame) -> list[Block]:
    """The accelerometer's zero over the flight."""
    time = frame.time_s[frame.keep]
    functions, deviation = waves(time, 0.5)
    size = np.full(len(time), ACCEL_WANDER_M_S2 * frame.airframe.mass_kg)
    return [
        in_channel(f"accel_{axis} wander", (functions, deviation), size, c, len(FLIGHT_CHANNELS))
        for c, axis in enumerate("xyz")
    ]


def _unlike(frame: FlightFrame, reduce: Callable[[Array], Array]) -> list[Block]:
    """Rotors of one kind are not quite alike, and no centre of mass is known to a millimetre."""
    none = np.zeros_like(frame.thrust)
    thrust, torque = [], []
    for k in range(frame.thrust.shape[1]):
        only = np.eye(frame.thrust.shape[1])[k]
        thrust.append(frame.airframe.body_loads(frame.thrust * only, none))
        torque.append(frame.airframe.body_loads(none, frame.torque * only))
    deviation = np.full(len(thrust), UNLIKE)
    return [
        Block("rotor thrusts", reduce(np.stack(thrust, axis=-1)), deviation),
        Block("rotor torques", reduce(np.stack(torque, axis=-1)), deviation),
    ]


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
    few = max(1, -(-len(out) * len(GRADUAL) // MANY_BEGINNINGS))
    return out + [s for sudden in out[::few] for s in gradual(frame, sudden)]


def _forms(
    names: tuple[str, ...], variables: dict[str, Array], reference: Array
) -> dict[str, Callable[[], Block]]:
    out: dict[str, Callable[[], Block]] = {}
    for k, name in enumerate(names):
        for variable, values in variables.items():
            lengths = (SHORT_TIME, *FORM_LENGTHS) if variable == "time_s" else FORM_LENGTHS
            for length in lengths:
                for size in FORM_SIZES:
                    key = f"{variable}|{name}|{length}|{size}"
                    out[key] = partial(_form, name, values, length, size, float(reference[k]), k, len(names))
    return out


def _form(
    name: str, values: Array, length: float, size: float, reference: float, channel: int, count: int
) -> Block:
    low, high = np.quantile(values, MIDDLE)  # a few rows far out are no dependence
    functions, deviation = waves(np.clip(values, low, high), length)
    return in_channel(name, (functions, deviation * size * reference), np.ones(len(values)), channel, count)
