"""Measured data against a model: find the residual, trace it to effects, report before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.data.samples import Samples
from coaxlink.residual.blocks import bootstrap, error_interval, held_out, solve
from coaxlink.residual.dependence import dependences
from coaxlink.residual.effects import FLIGHT_EFFECTS, STAND_EFFECTS
from coaxlink.residual.experiment import Rival, stand_experiment
from coaxlink.residual.flight import flight_frame, reduce_columns
from coaxlink.residual.flight_base import flight_corrections
from coaxlink.residual.frames import (
    FLIGHT_CHANNELS,
    FLIGHT_UNITS,
    STAND_CHANNELS,
    STAND_UNITS,
    Array,
    FlightFrame,
    StandFrame,
)
from coaxlink.residual.problem import Option, Problem, build, contiguous_blocks
from coaxlink.residual.rebase import rebased_flight
from coaxlink.residual.result import (
    Ambiguous,
    ChannelError,
    FoundEffect,
    ParameterValue,
    Refinement,
    Rejected,
    Series,
    Suspect,
    Unexplained,
)
from coaxlink.residual.select import Selection, columns_of, select
from coaxlink.residual.signals import difference_gain, noise_floor
from coaxlink.residual.stand import base_corrections, joined, stand_frame
from coaxlink.residual.suspects import find_suspects
from coaxlink.rotor import Effect as ModelEffect
from coaxlink.rotor import RotorModel

Progress = Callable[[str], None]
DRAWS = 200
PLAINER = 0.005  # a plain base that errs by no more than this share above a rich one is kept
SERIES_ROWS = 4000


def refine_stand(
    logs: Samples | Sequence[Samples],
    model: RotorModel | None = None,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold stand logs against a rotor model, or without one against the coaxial model fitted to themselves.

    Raises InputError when speeds or loads are missing.
    """
    several = [logs] if isinstance(logs, Samples) else list(logs)
    progress("reading the stand")
    samples = joined(several)
    frame = stand_frame(samples, model)
    suspects, bad, mislabelled = find_suspects(frame)
    trusted = np.flatnonzero(np.logical_not(bad))
    tried: list[tuple[Problem, Selection, float]] = []
    # a base of high order may swallow an effect that a plain one leaves to be named
    for order in (None,) if model is not None else (None, 2):
        progress("fitting candidates")
        frame = replace(stand_frame(samples, model, order), keep=trusted)
        if tried and frame.model.terms() == tried[0][0].frame.model.terms():
            break
        problem = stand_problem(frame)
        progress("selecting")
        selection = Selection() if mislabelled else select(problem)
        tried.append((problem, selection, _log_error(problem, selection)))
    problem, selection, _ = tried[0] if len(tried) < 2 or tried[1][2] > tried[0][2] + PLAINER else tried[1]
    progress("judging")
    return _report(problem, selection, _stand_variables(frame), several, suspects, judged=not mislabelled)


def _log_error(p: Problem, selection: Selection) -> float:
    """Mean over channels of the logarithm of the held-out error, in the channels' units."""
    squares = held_out(p.blocks, columns_of(p, selection.members))[0].sum(axis=0)
    return float(np.mean(np.log(np.sqrt(squares / p.blocks.rows.sum()) * p.sigma)))


def stand_problem(frame: StandFrame) -> Problem:
    """The regression of a stand log: residual of the measured channels at trusted rows."""
    present, keep = list(frame.present), frame.keep

    def reduce(columns: Array) -> Array:
        return columns[keep][:, present]

    known = np.zeros_like(frame.predicted)
    by_name = {e.name: e for e in STAND_EFFECTS}
    for effect in frame.model.effects:
        mine = by_name.get(effect.name)
        if mine is not None and mine.missing(frame) is None:
            known += mine.contribution(frame, effect.parameters)
    residual = reduce(frame.measured - frame.predicted - known)
    _, block = np.unique(frame.block[keep], return_inverse=True)
    gain = np.full(len(present), 6.0)

    def floor_of(left: Array) -> Array:
        return noise_floor(left, block.astype(float), gain)

    base = [(name, bound, reduce(columns)) for name, bound, columns in base_corrections(frame)]
    reference = frame.reference[present]
    floor = floor_of(_without_base(residual, base))
    return build(
        frame=frame,
        channels=[STAND_CHANNELS[c] for c in present],
        units=[STAND_UNITS[c] for c in present],
        reference=reference,
        residual=residual,
        sigma=np.sqrt(floor**2 + (2e-4 * reference) ** 2),
        corrections=base,
        effects=STAND_EFFECTS,
        reduce=reduce,
        block=block.astype(np.intp),
        floor_of=floor_of,
    )


def _without_base(residual: Array, base: Sequence[tuple[str, float, Array]]) -> Array:
    """What least squares on the base columns leaves, channel by channel."""
    out = residual.copy()
    for c in range(residual.shape[1]):
        columns = [values[:, c] for _, _, values in base if np.any(values[:, c])]
        if columns:
            x = np.stack(columns, axis=1)
            out[:, c] -= x @ np.linalg.lstsq(x, residual[:, c], rcond=1e-10)[0]
    return out


def _stand_variables(frame: StandFrame) -> dict[str, Array]:
    """(kept,) recorded variables that a residual may still depend on."""
    out = {"time_s": frame.time_s, "upper_speed": frame.speeds[:, 0], "lower_speed": frame.speeds[:, 1]}
    out |= {
        name: values
        for name, values in frame.columns.items()
        if not name.endswith(("_rpm", "_throttle", "_thrust_N", "_torque_Nm")) and name != "time_s"
    }
    return {name: values[frame.keep] for name, values in out.items() if np.all(np.isfinite(values))}


def refine(
    logs: Samples | Sequence[Samples],
    airframe: Airframe,
    model: RotorModel,
    *,
    progress: Progress = lambda _: None,
) -> Refinement:
    """Hold flight logs against a rotor model on its airframe.

    `model` may carry effects already: they are part of the prediction. `progress` is told each stage.
    Raises InputError when a log lacks what every flight needs.
    """
    several = [logs] if isinstance(logs, Samples) else list(logs)
    progress("aligning")
    frame = flight_frame(several, airframe, model)
    progress("fitting candidates")
    problem = flight_problem(frame)
    progress("selecting")
    selection = select(problem)
    progress("judging")
    return _report(problem, selection, _flight_variables(frame), several)


def known_effects(frame: FlightFrame) -> Array:
    """(rows, 6) what the effects already in the model add."""
    total = np.zeros((len(frame.time_s), 6))
    by_name = {e.name: e for e in FLIGHT_EFFECTS}
    for known in frame.model.effects:
        effect = by_name.get(known.name)
        if effect is not None and effect.missing(frame) is None:
            total += effect.contribution(frame, known.parameters)
    return total


def flight_problem(frame: FlightFrame) -> Problem:
    """The regression of a flight: 4 Hz low-passed residual at the judged rows, whitened by its noise."""

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    residual = reduce(frame.measured - frame.predicted - known_effects(frame))
    every = max(1, round(frame.rate_hz / 10.0))
    rates = (frame.rate_hz, frame.cutoff_hz, every)
    gain = np.array([difference_gain(*rates)] * 3 + [difference_gain(*rates, differentiated=True)] * 3)
    broken = np.concatenate([[0], np.cumsum(np.diff(frame.keep) != every)])

    def floor_of(left: Array) -> Array:
        return noise_floor(left, broken, gain)

    time = frame.time_s[frame.keep]
    block = contiguous_blocks(time, broken, least_s=2.0, count=40)
    floor = floor_of(residual)
    reference = frame.reference
    return build(
        frame=frame,
        channels=FLIGHT_CHANNELS,
        units=FLIGHT_UNITS,
        reference=reference,
        residual=residual,
        sigma=np.sqrt(floor**2 + (1e-3 * reference) ** 2),
        corrections=[(c.name, c.bound, reduce(c.columns)) for c in flight_corrections(frame)],
        effects=FLIGHT_EFFECTS,
        reduce=reduce,
        block=block,
        floor_of=floor_of,
    )


def _flight_variables(frame: FlightFrame) -> dict[str, Array]:
    """(kept,) recorded and derived variables that a residual may still depend on."""
    upper = [i for i, r in enumerate(frame.airframe.rotors) if r.level != "lower"]
    lower = [i for i, r in enumerate(frame.airframe.rotors) if r.level == "lower"]
    out = {
        "time_s": frame.time_s,
        "upper_speeds": frame.speeds[:, upper].mean(axis=1),
        "vel_x_body_m_s": frame.velocity[:, 0],
        "vel_y_body_m_s": frame.velocity[:, 1],
        "vel_z_body_m_s": frame.velocity[:, 2],
        "airspeed_m_s": np.linalg.norm(frame.velocity, axis=1),
        "roll_rad": frame.attitude[:, 0],
        "pitch_rad": frame.attitude[:, 1],
        "yaw_rad": frame.attitude[:, 2],
        "yaw_rate_rad_s": frame.rates[:, 2],
    }
    if lower:
        out["lower_speeds"] = frame.speeds[:, lower].mean(axis=1)
    if frame.height is not None:
        out["height_m"] = frame.height
    if frame.voltage is not None:
        out["voltage_V"] = frame.voltage
    return {name: values[frame.keep] for name, values in out.items()}


def _report(
    problem: Problem,
    selection: Selection,
    variables: Mapping[str, Array],
    logs: Sequence[Samples],
    suspects: Sequence[Suspect] = (),
    *,
    judged: bool = True,
) -> Refinement:
    """Put numbers, intervals and doubts on a selection."""
    p, members = problem, selection.members
    none, use = columns_of(p, []), columns_of(p, members)
    squares_before, fits_before = held_out(p.blocks, none)
    squares_after, fits_after = held_out(p.blocks, use)
    before, after = (_held_out_residual(p, fits) for fits in (fits_before, fits_after))
    floor = p.floor_of(after)
    rows = p.blocks.rows
    channels = {}
    for c, name in enumerate(p.channels):
        scale = float(p.sigma[c])
        low_b, high_b = error_interval(squares_before[:, c], rows)
        low_a, high_a = error_interval(squares_after[:, c], rows)
        channels[name] = ChannelError(
            unit=p.units[c],
            noise_floor=float(floor[c]),
            rmse_before=scale * _rms(squares_before[:, c], rows),
            rmse_after=scale * _rms(squares_after[:, c], rows),
            ci_before=(scale * low_b, scale * high_b),
            ci_after=(scale * low_a, scale * high_a),
            held_out_rows=int(rows.sum()),
            rmse_as_given=float(scale * np.sqrt(np.mean(p.residual[:, c] ** 2))),
        )
    draws = bootstrap(p.blocks, use, DRAWS) if members else np.zeros((0, len(p.blocks.bounds)))
    final = solve(p.blocks, use, np.ones(p.blocks.count))
    named = [_found(p, selection, m, final, draws) for m in members]
    effects = tuple(e for e, m in zip(named, members, strict=True) if not m.effect.accused)
    accused = [_accuse(e, m) for e, m in zip(named, members, strict=True) if m.effect.accused]
    fold = p.blocks.fold[p.block]
    # what an ambiguous effect would explain is no open end: it is named, only its cause is in doubt
    doubted = _held_out_residual(p, held_out(p.blocks, columns_of(p, [*members, *selection.doubtful]))[1])
    open_ends = dependences(doubted, variables, p.block, fold, p.reference, floor) if judged else []
    return Refinement(
        kind="flight" if isinstance(p.frame, FlightFrame) else "stand",
        channels=channels,
        effects=effects,
        unexplained=tuple(_unexplained(p, open_ends)),
        ambiguous=tuple(_separable(p, selection, a, variables) for a in selection.ambiguous),
        suspect_data=(*suspects, *accused),
        rejected=_rejected(p, selection),
        model=_with_effects(_rebased(p, final, bool(effects)), effects),
        corrections={name: float(final[i]) for i, name in enumerate(p.base_names)},
        trace=tuple(selection.trace),
        notes=(*p.frame.notes, *(note for log in logs for note in log.notes)),
        series=_series(p, members, before, after, floor, variables),
        source="; ".join(log.source for log in logs),
    )


def _rms(squares: Array, rows: Array) -> float:
    return float(np.sqrt(squares.sum() / rows.sum()))


def _held_out_residual(p: Problem, fits: Array) -> Array:
    """(rows, C) residual of every row under the fit that did not see it, in the channels' units."""
    out = np.empty_like(p.residual)
    folds = np.unique(p.blocks.fold)
    for k, fold in enumerate(folds):
        rows = p.blocks.fold[p.block] == fold
        used = np.flatnonzero(fits[k])
        out[rows] = p.residual[rows] - p.design[rows][:, :, used] @ fits[k][used]
    return out * p.sigma


def _found(p: Problem, selection: Selection, member: Option, final: Array, draws: Array) -> FoundEffect:
    named = member.effect.parameters(p.frame, member.shape, final[member.columns])
    sampled = [member.effect.parameters(p.frame, member.shape, d[member.columns]) for d in draws]
    parameters = []
    for name, value in named.items():
        values = np.array([s[name] for s in sampled])
        low, high = np.quantile(values, [0.025, 0.975]) if len(values) else (value, value)
        parameters.append(
            ParameterValue(
                name,
                value,
                (min(float(low), value), max(float(high), value)),
                member.effect.units.get(name, "1"),
            )
        )
    rest = [m for m in selection.members if m is not member]
    without = held_out(p.blocks, columns_of(p, rest))[0].sum(axis=0)
    with_it = held_out(p.blocks, columns_of(p, selection.members))[0].sum(axis=0)
    rows = p.blocks.rows.sum()
    rmse = {
        name: (float(p.sigma[c] * np.sqrt(without[c] / rows)), float(p.sigma[c] * np.sqrt(with_it[c] / rows)))
        for c, name in enumerate(p.channels)
    }
    touched = tuple(
        name for name, (a, b) in rmse.items() if name in member.effect.channels and b < 0.98 * a
    ) or tuple(member.effect.channels)
    steps = [s for s in selection.trace if s.kept and s.name.endswith(member.name)]
    evidence = (
        {
            "p_value": steps[-1].p_value,
            "gain_in_noise_variances": steps[-1].gain,
            "size_of_reference": steps[-1].size,
        }
        if steps
        else {}
    )
    return FoundEffect(
        member.name,
        touched,
        tuple(parameters),
        {k: rmse[k] for k in touched},
        evidence,
        f"{member.effect.physics}; {member.effect.source}",
        member.effect.needs,
    )


def _accuse(found: FoundEffect, member: Option) -> Suspect:
    """An instrument that lies, in words."""
    numbers = ", ".join(f"{q.name} {q.value:.3g}" for q in found.parameters)
    return Suspect(member.effect.accused, "all", f"{member.effect.physics} ({numbers})")


def _rebased(p: Problem, final: Array, found: bool) -> RotorModel:
    """The model, with its polynomials as fitted beside the effects where the base was free."""
    model: RotorModel = p.frame.model
    if isinstance(p.frame, FlightFrame):
        fitted = {name: float(final[i]) for i, name in enumerate(p.base_names)}
        return rebased_flight(p.frame, fitted) if found else model
    if not (isinstance(p.frame, StandFrame) and p.frame.free_base):
        return model
    terms = {load: dict(named) for load, named in model.terms().items()}
    for i, name in enumerate(p.base_names):
        load, _, term = name.partition(" ")
        if term in terms.get(load, {}):
            terms[load][term] += float(final[i])
    return replace(
        RotorModel.from_terms(model.form, model.speed_max_rpm, terms),
        effects=model.effects,
        identified=model.identified,
    )


def _separable(
    p: Problem, selection: Selection, doubt: Ambiguous, variables: Mapping[str, Array]
) -> Ambiguous:
    """The doubt with the place where its explanations, each as fitted to these data, differ most."""
    ones = np.ones(p.blocks.count)
    guesses, rivals = [], []
    for name in doubt.names:
        trial = selection.last.get(name)
        option = next((m for m in selection.doubtful if m.name == name), trial.option if trial else None)
        if option is not None:
            fit = solve(p.blocks, columns_of(p, [*selection.members, option]), ones)
            guesses.append(p.design @ fit * p.sigma)
            named = option.effect.parameters(p.frame, option.shape, fit[option.columns])
            rivals.append(Rival(option.effect, named))
    if len(guesses) < 2:
        return doubt
    if isinstance(p.frame, StandFrame):
        plan = stand_experiment(p.frame, p.sigma, rivals)
        if plan is not None:
            return replace(doubt, separate_by=plan.text, experiment=plan)
    apart = np.abs(guesses[0] - guesses[1])  # (rows, C)
    c = int(np.argmax(np.quantile(apart, 0.98, axis=0) / (p.sigma + 1e-12)))
    rows = np.argsort(-apart[:, c])[: max(5, len(apart) // 50)]
    places = []
    for name, values in variables.items():
        spread = float(np.std(values))
        if spread > 0 and name != "time_s" and float(np.std(values[rows])) < 0.4 * spread:
            places.append((float(np.std(values[rows])) / spread, f"{name} {np.median(values[rows]):.3g}"))
    where = ", ".join(text for _, text in sorted(places)[:3]) or "no single place"
    size = float(np.median(apart[rows, c]))
    repeats = int(np.ceil((6.0 * float(p.sigma[c]) / max(size, 1e-12)) ** 2))
    text = (
        f"they differ most in {p.channels[c]}, by {size:.2g} {p.units[c]}, at {where}: "
        f"about {repeats} independent readings there and as many far from there would tell"
    )
    return replace(doubt, separate_by=text)


def _unexplained(p: Problem, found: Sequence[Any]) -> list[Unexplained]:
    out = []
    for c, name in enumerate(p.channels):
        mine = [d for d in found if d.channel == c]
        if mine:
            strongest = mine[0]
            related = tuple(dict.fromkeys(d.variable for d in mine if d.share > 0.5 * strongest.share))[:3]
            out.append(Unexplained(name, related, strongest.rms, f"{strongest.variable}: {strongest.where}"))
    return out


def _rejected(p: Problem, selection: Selection) -> tuple[Rejected, ...]:
    chosen = {m.name for m in selection.members}
    out = [Rejected(name, f"cannot be judged: {why}") for name, why in p.impossible]
    for name, trial in selection.last.items():
        if name not in chosen:
            out.append(Rejected(name, trial.why_not or "adds nothing to what was chosen"))
    return tuple(out)


def _with_effects(model: RotorModel, effects: Sequence[FoundEffect]) -> RotorModel:
    """The model with the effects added; one it had under the same name is replaced."""
    added = tuple(
        ModelEffect(e.name, {q.name: q.value for q in e.parameters}, tuple(e.needs)) for e in effects
    )
    names = {e.name for e in added}
    return replace(model, effects=(*(e for e in model.effects if e.name not in names), *added))


def _series(
    p: Problem,
    members: Sequence[Option],
    before: Array,
    after: Array,
    floor: Array,
    variables: Mapping[str, Array],
) -> Series:
    step = max(1, len(before) // SERIES_ROWS)
    causes = {}
    for m in members:
        for channel in m.effect.channels:
            label, values = m.effect.cause(p.frame, m.shape, channel)
            causes[m.name, channel] = label, values[p.frame.keep][::step]
    return Series(
        time_s=variables["time_s"][::step],
        channels=p.channels,
        before=before[::step],
        after=after[::step],
        causes=causes,
        noise={name: float(floor[c]) for c, name in enumerate(p.channels)},
    )


__all__ = ["Ambiguous", "Refinement", "refine", "refine_stand"]
