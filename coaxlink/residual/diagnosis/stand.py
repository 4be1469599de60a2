"""The channels of a stand log: loads of both rotors, and the speeds that throttles gave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from coaxlink.channels.stand import (
    ANY,
    Orders,
    base_corrections,
    reducing,
    stand_frame,
    stand_variables,
)
from coaxlink.data.samples import Samples
from coaxlink.effects import stand_effects
from coaxlink.effects.blade_speed_law import EFFECT as BLADE_SPEED_LAW
from coaxlink.effects.blade_speed_law import SLOWEST_POWER, growth
from coaxlink.effects.drive import remembered
from coaxlink.effects.tracing import Tracing
from coaxlink.evidence.blocks import FORM_LENGTHS, Block, in_channel, joined, products, waves
from coaxlink.frames import STAND_CHANNELS, STAND_UNITS, Array, StandFrame
from coaxlink.residual.diagnosis.channels import LOADS, Channels, possible
from coaxlink.residual.diagnosis.meters import calmed
from coaxlink.residual.members import composed, known_parts
from coaxlink.residual.result import POWER_OF
from coaxlink.rotor import RotorModel

# of a nuisance model fitted to the log itself: the coaxial rotor model's (Berra et al. 2024). What it misses
# is a Gaussian process, not terms of higher orders: those take a blade's law or a dead band, and hold
# nothing back
ORDERS: Orders = ((2,), (2,))
WIDE = 3.0  # of the reference load: prior of the terms of such a nuisance, so wide that it holds nothing back
# of a longer log, one stretch of rows in so many is searched (judgement: seconds of a search)
MANY_ROWS, STRETCH = 1500, 64
RESOLUTION = 2e-4  # of the reference load: 1 in 5000 divisions of a cell of class C (OIML R 60)
# the smooth part of a rotor map that no polynomial follows: size over the load, correlation length in ranges
# of the speed (momentum theory against polynomials of fourth order: 1 to 2 %, bending once or twice)
MAP_SIZE, MAP_LENGTH = 0.02, 0.35
GIVEN_MAP_SIZE = 0.01  # of a given model, beside its level and tilt
DRIVE_MAP_SIZE = 0.01
LAW_POINTS = 5  # of the integral over the prior of `speed_law` (Gauss and Hermite: exact to the ninth order)
# what the wake makes of a lower rotor, over the ratio of both speeds: correlation length; size over the load
# and how slowly it changes with both speeds at one ratio (Reynolds number), in ranges. Blade-element pairs of
# two makers against polynomials of fourth order: lower torque off by 1 to 11 % rms, bending within a tenth of
# the range where the lower rotor is slow. Which of these a log asks for is by its marginal likelihood
RATIO_LENGTHS = (0.03, 0.06, 0.1)
RATIO_SIZES = ((0.06, 1.0), (0.2, 0.4))
REST, REST_SIZE = 0.005, 0.1  # of normalised speed; of the load, judgement: at rest is not slow
FORM_SIZES = (0.01, 0.04)  # free forms, judgement: size over the reference load
BOTH_SPEEDS = "upper_speed & lower_speed"
# s, of what remembers the power of the rows before: a room's air set turning (10 to 60 s), windings (20 to
# 180 s), cases, packs and cells (minutes). Half a decade apart (judgement): a form bends by what lies between
MEMORIES_S = (15.0, 50.0, 150.0, 500.0)
SPANS = 3.0  # memories in a log, at the least (judgement): a longer one is a trend alone, as the weather's
NARROW_LENGTHS, NARROW_SIZE = (0.04, 0.08, 0.15), 0.03  # over the speeds: narrower than a rotor map bends
# of the reference load: the most that a sound cell's zero wanders (OIML R 60, class C3: 0.02 % and creep)
WITHIN_SPECIFICATION = 0.0007


def stand_channels(
    samples: Samples, model: RotorModel | None, trusted: np.ndarray | None = None, most: int = MANY_ROWS
) -> Channels:
    """Channels of a stand log. Raises InputError as `stand_frame` does."""
    bare = calmed(stand_frame(samples, model, ORDERS if model is None else ANY, trusted))
    known, notes = known_parts(bare, stand_effects(), "stand", partial(_unvaried, bare))
    if len(bare.keep) > most:  # stretches whole: noise has neighbours, and what lags sees every row
        share = -(-len(bare.keep) // most)
        bare = replace(bare, keep=bare.keep[(bare.keep // STRETCH) % share == 0])
    frame = composed(bare, known)
    reduce, present, keep = reducing(frame), list(frame.present), frame.keep
    reference = frame.reference[present]
    names = tuple(STAND_CHANNELS[c] for c in present)
    able, unable = possible(frame, stand_effects())
    weights = np.abs(reduce(frame.predicted))
    wake = np.abs(reduce(_wake(frame)))
    mapped = np.hypot(weights, wake)
    u = frame.speeds[keep]
    drive = u if frame.throttles is None else frame.throttles[keep]
    speeds = {
        k: (drive[:, c - 4], drive[:, 5 - c]) if c > 3 else (u[:, c // 2], u[:, 1 - c // 2])
        for k, c in enumerate(present)
    }
    # a current or a power follows the load that it turns: it is the cause of none
    logged = {n: v for n, v in stand_variables(frame).items() if not n.endswith(("_A", "_W"))}
    variables = {n: v for n, v in (logged | _memories(frame)).items() if np.ptp(v) > 0}
    target = reduce(frame.measured - frame.predicted)
    return Channels(
        frame=frame,
        bare=bare,
        known=tuple(known),
        names=names,
        units=tuple(STAND_UNITS[c] for c in present),
        reference=reference,
        target=target,
        block=_blocks(frame),
        least_noise=RESOLUTION * reference,
        variables=variables,
        speeds=speeds,
        weights=weights,
        nuisance=tuple(_nuisance(frame, reduce, reference)),
        surface=tuple(_surface(frame, present, mapped, wake, u, drive)),
        maps=_maps(frame, present, mapped, u),
        forms=_forms(names, variables, weights, reference, present, u, drive, frame.throttles is not None),
        effects=tuple(able),
        reduce=reduce,
        notes=(*frame.notes, *notes),
        impossible=tuple(unable),
    )


def _unvaried(frame: StandFrame, effect: Tracing[Any]) -> None:
    """Raises NotShown where a log has not what an effect of the model needs."""
    effect.starts(frame)


def _memories(frame: StandFrame) -> dict[str, Array]:
    """(kept,) by name, what is remembered of both rotors' power, u^3.

    Nobody recorded what it does, and much does: no effect has it for its cause, free forms have.
    """
    time = frame.time_s
    step, span = float(np.median(np.diff(time))), float(np.ptp(time))
    power = np.sum((frame.speeds if frame.throttles is None else frame.throttles) ** 3, axis=1)
    return {
        f"{POWER_OF}{memory:.0f}_s": remembered(power[:, None], time, memory)[frame.keep, 0]
        for memory in MEMORIES_S
        if 2.0 * step < memory < span / SPANS
    }


def _wake(frame: StandFrame) -> Array:
    """(rows, 6) what the upper wake takes from each load: a model errs by a share of that too, however small
    the load that is left."""
    out = np.zeros((len(frame.time_s), 6))
    alone = frame.loads_at(np.stack([np.zeros(len(out)), frame.speeds[:, 1]], axis=1))
    out[:, 2:4] = (frame.loads_at(frame.speeds) - alone)[:, 2:4]
    return out


def _blocks(frame: StandFrame) -> np.ndarray:
    rows = len(frame.keep)
    return np.asarray(np.arange(rows) * min(40, max(6, rows // 8)) // rows, np.intp)


def _nuisance(frame: StandFrame, reduce: Callable[[Array], Array], reference: Array) -> list[Block]:
    out = []
    for name, bound, columns in base_corrections(frame):
        x = reduce(columns)[..., None]
        if np.isfinite(bound):
            deviation = abs(bound) / 2.0
        else:
            size = np.sqrt(np.mean(x[..., 0] ** 2, axis=0)) / reference
            deviation = WIDE / max(float(size.max()), 1e-12)
        out.append(Block(name, x, np.array([deviation])))
    time = frame.time_s[frame.keep]
    if np.ptp(time) > 0:
        for k, c in enumerate(frame.present):
            if c < 4:
                f, d = waves(time, 0.5)
                out.append(
                    in_channel(
                        f"{STAND_CHANNELS[c]} creep",
                        (f, d * WITHIN_SPECIFICATION / 2.0 * reference[k]),
                        np.ones(len(time)),
                        k,
                        len(frame.present),
                    )
                )
    return out


def _surface(
    frame: StandFrame, present: Sequence[int], weights: Array, wake: Array, u: Array, drive: Array
) -> list[Block]:
    """The smooth part of the map: over a rotor's own speed, of the lower one over both."""
    out = []
    for k, c in enumerate(present):
        own, other = (drive[:, c - 4], drive[:, 5 - c]) if c > 3 else (u[:, c // 2], u[:, 1 - c // 2])
        size = DRIVE_MAP_SIZE if c > 3 else MAP_SIZE if frame.free_nuisance else GIVEN_MAP_SIZE
        if np.ptp(own) <= 0.0:
            continue
        process = waves(own, MAP_LENGTH)
        if c in (2, 3, 4, 5) and np.ptp(other) > 0.0:
            process = products(process, waves(other, MAP_LENGTH))
        if c > 3 and frame.model.drive is not None:  # as far as it missed its own stand's speeds
            size = max(size, (frame.model.drive.upper, frame.model.drive.lower)[c - 4].error)
        process = process[0], process[1] * size
        weight = weights[:, k]
        if frame.free_nuisance and c < 4:
            out.append(in_channel(f"{STAND_CHANNELS[c]} law", speed_law(own), weight, k, len(present)))
            if c > 1 and np.ptp(other) > 0.0:  # the wake is what the upper blades make of it
                name = f"{STAND_CHANNELS[c]} wake law"
                out.append(in_channel(name, speed_law(other), wake[:, k], k, len(present)))
        out.append(in_channel(f"{STAND_CHANNELS[c]} map", process, weight, k, len(present)))
    return out


def speed_law(own: Array) -> tuple[Array, Array]:
    """(rows, K) functions of a rotor's own speed and their deviations: how its blades' loads follow Reynolds
    number.

    Every pair has such a law, and where no model is given it is the map's: `blade_speed_law`'s own power of
    speed, under the priors of its two numbers, both integrated out.
    """
    priors = {p.name: p.prior for p in BLADE_SPEED_LAW.parameters if p.prior is not None}
    (power, spread), (_, size) = priors["power"], priors["exponent_change"]
    points, weights = np.polynomial.hermite_e.hermegauss(LAW_POINTS)
    powers = np.clip(power + spread * points, SLOWEST_POWER, None)
    functions = np.stack([growth({"power": float(p)}, own) for p in powers], axis=1)
    return functions, size * np.sqrt(weights / weights.sum())


def _maps(
    frame: StandFrame, present: Sequence[int], weights: Array, u: Array
) -> dict[str, Callable[[], tuple[Block, ...]]]:
    """Discrepancies of the map that a log may ask for beside the smooth one, by name.

    Of lower loads over the ratio: blades of one pair in one air see the same angles at the same ratio
    (similarity, Leishman 2006, ch. 2), so thrust and torque have it alike.
    """
    lower = [(k, c) for k, c in enumerate(present) if c in (2, 3)]
    if not lower or min(np.ptp(u, axis=0)) <= 0.0:
        return {}

    def blocks(length: float, size: float, slow: float) -> tuple[Block, ...]:
        over, count, name = _over_ratio(u, length, size, slow), len(present), "{} ratio map"
        return tuple(
            in_channel(name.format(STAND_CHANNELS[c]), over, weights[:, k], k, count) for k, c in lower
        )

    return {
        f"ratio|{length}|{size}|{slow}": partial(blocks, length, size, slow)
        for length in RATIO_LENGTHS
        for size, slow in RATIO_SIZES
    }


def _over_ratio(u: Array, length: float, size: float, slow: float) -> tuple[Array, Array]:
    """Functions (rows, K) of the ratio of speeds (rows, 2) and their deviations; of a rotor at rest one more.

    A slow rotor in a strong wake sees its angles change fastest: the process runs over the root of the angle.
    """
    upper, own = np.maximum(u[:, 0], 0.0), np.maximum(u[:, 1], 0.0)
    turning = own >= REST
    angle = np.arctan2(own, upper)
    low = float(np.min(angle[turning], initial=np.pi / 2.0))
    over = waves(np.sqrt(np.where(turning, angle, low)), length)
    functions, deviations = products(over, waves(np.hypot(upper, own), slow))
    functions, deviations = functions * turning[:, None], deviations * size
    if turning.all():
        return functions, deviations
    return np.column_stack([functions, ~turning]), np.append(deviations, REST_SIZE)


def _forms(
    names: Sequence[str],
    variables: dict[str, Array],
    weights: Array,
    reference: Array,
    present: Sequence[int],
    u: Array,
    drive: Array,
    both: bool,
) -> dict[str, Callable[[], Block]]:
    """Free forms of one channel, or of every load (`LOADS`), over one recorded variable, with a share of the
    load; over speeds, narrow.

    What moves every load with one variable is one explanation, not four.
    """
    count = len(names)
    out: dict[str, Callable[[], Block]] = {}
    loaded = [k for k, c in enumerate(present) if c < 4]
    for variable, values in variables.items():
        if variable in ("upper_speed", "lower_speed") or len(loaded) < 2:
            continue
        if variable.startswith(POWER_OF):
            length = max(FORM_LENGTHS)
            for size in FORM_SIZES:
                out[f"{variable}|{LOADS}|{length}|{size}"] = partial(
                    _alike, values, length, size, weights, loaded
                )
            continue
        for length in FORM_LENGTHS:
            for size in FORM_SIZES:
                parts = [
                    partial(_form, name=names[k], values=values, length=length, size=size,
                        weight=weights[:, k], reference=reference[k], channel=k, count=count)
                    for k in loaded
                ]  # fmt: skip
                out[f"{variable}|{LOADS}|{length}|{size}"] = partial(_together, parts)
    for k, name in enumerate(names):
        loads = present[k] < 4
        for variable, values in variables.items():
            # the map of upper loads knows nothing of the other rotor
            if variable == "upper_speed" or (variable == "lower_speed" and present[k] not in (0, 1)):
                continue
            if variable.startswith(POWER_OF):  # of all loads at once, or none
                continue
            for length in FORM_LENGTHS:
                for size in FORM_SIZES:
                    out[f"{variable}|{name}|{length}|{size}"] = partial(
                        _form, name, values, length, size, weights[:, k], reference[k], k, count
                    )
        own = u if loads else drive
        ways = {"upper_speed": own[:, 0], "lower_speed": own[:, 1]}
        if loads and min(np.ptp(u, axis=0)) > 0.0:  # where one stands still, that is the other's own speed
            ways["upper_speed + lower_speed"] = u.sum(axis=1)
            ways["upper_speed - lower_speed"] = u[:, 0] - u[:, 1]
        for variable, values in ways.items():
            if np.ptp(values) < 0.1 or len(np.unique(np.round(values, 3))) < 8:
                continue
            for length in NARROW_LENGTHS:
                out[f"{variable}|{name}|{length}|{NARROW_SIZE}"] = partial(
                    _form, name, values, length, NARROW_SIZE, weights[:, k], reference[k], k, count
                )
        if len(ways) > 2:
            length = max(NARROW_LENGTHS)
            out[f"{BOTH_SPEEDS}|{name}|{length}|{NARROW_SIZE}"] = partial(
                _over_both, name, u, length, NARROW_SIZE, weights[:, k], k, count
            )
    return out


def _over_both(
    name: str, u: Array, length: float, size: float, weight: Array, channel: int, count: int
) -> Block:
    """What sets in at some speeds of both rotors and is nowhere else."""
    f, d = products(waves(u[:, 0], length), waves(u[:, 1], length))
    return in_channel(name, (f, d * size), weight, channel, count)


def _together(parts: Sequence[Callable[[], Block]]) -> Block:
    columns, deviation = joined([part() for part in parts])
    return Block(LOADS, columns, deviation)


def _alike(values: Array, length: float, size: float, weights: Array, loaded: Sequence[int]) -> Block:
    """Every load by one share of itself: air that goes round meets all blades alike."""
    f, d = waves(values, length)
    columns = np.zeros((*weights.shape, len(d)))
    columns[:, loaded] = f[:, None] * weights[:, loaded, None]
    return Block(LOADS, columns, d * size)


def _form(
    name: str,
    values: Array,
    length: float,
    size: float,
    weight: Array,
    reference: float,
    channel: int,
    count: int,
) -> Block:
    f, d = waves(values, length)
    both = np.concatenate([f * weight[:, None], f * reference], axis=1), np.concatenate([d, 0.5 * d]) * size
    return in_channel(name, both, np.ones(len(weight)), channel, count)
