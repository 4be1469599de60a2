"""A refinement for the terminal: tables and one-line remarks. Numbers come from the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from coaxlink.report.pictures.label import channel_words
from coaxlink.report.terminal import table
from coaxlink.residual.result import HIDDEN, Ambiguous, ChannelError, FoundEffect, ParameterValue, Refinement

DIGITS = 3
SHORT_M = 0.3  # below it a ruler, and a reader, counts in millimetres
COLOURED = 1.5  # times the noise between neighbouring rows: no noise floor any more


def tables(result: Refinement) -> Iterator[Any]:
    """Rich tables: the errors before and after by channel, then every effect with its numbers."""
    if result.channels:
        yield _errors(result)
    if result.effects:
        yield _effects(result)


def verdict(result: Refinement) -> str:
    """The answer in one line."""
    if result.reasons:
        return result.reasons[0].line()
    if result.effects:
        return f"found: {' and '.join(map(named, result.effects))}{_most(result)}"
    if result.suspect_data:
        return "no effect can be claimed: the data contradict themselves"
    if result.ambiguous:
        return "something is there, but these data do not say which: " + "; ".join(
            " or ".join(a.names) for a in result.ambiguous
        )
    if result.unexplained:
        return f"no known effect explains the residual{_more(result)}"
    if result.surface:
        bent = f"the loads are no polynomials of the speeds: {surface(result)}"
        return f"no effect found, but {bent}{_more(result)}"
    if times_floor := above_floor(result):
        times = max(times_floor.values())
        return (
            f"no effect found: the residual of {', '.join(times_floor)}, up to {times:.1f} times the scatter "
            "of neighbouring rows, hangs together in time as gusts and ringing do, or is too small to matter"
            f"{_more(result)}"
        )
    return f"nothing to explain: the residual is at the noise floor{_more(result)}"


def _more(result: Refinement) -> str:
    """How probable it is that something is there which has no name."""
    return "" if result.more is None else f"; probability that something is there: {_chance(result.more)}"


def above_floor(result: Refinement) -> dict[str, float]:
    """Channels that are left with more than the scatter of neighbouring rows: how many times it.

    Where small corrections err more on rows that they did not see than the model as given, it counts.
    """
    times = {
        name: min(c.rmse_after, c.rmse_as_given) / c.noise_floor
        for name, c in result.channels.items()
        if c.noise_floor > 0.0
    }
    return {name: t for name, t in times.items() if t > COLOURED}


def _most(result: Refinement) -> str:
    """Where it mends most, from what to what, and how sure the names are."""
    drops = {
        name: c.rmse_after / c.rmse_before
        for name, c in result.channels.items()
        if c.rmse_before > 0.0 and any(name in e.channels for e in result.effects)
    }
    sure = [e.evidence["probability"] for e in result.effects if "probability" in e.evidence]
    sentences = f"; probability {_chance(min(sure))}" if sure else ""
    if not drops:
        return sentences
    name = min(drops, key=lambda n: drops[n])
    c = result.channels[name]
    return f"; the error of the {channel_words(name)} falls from {fall(c)}{sentences}"


def fall(c: ChannelError) -> str:
    """From what to what. Small corrections, as of a centre of mass, may take most of a fault: both stand."""
    start, aside = number(c.rmse_before), f"noise alone: {number(c.noise_floor)}"
    given, before, after = (e**2 for e in (c.rmse_as_given, c.rmse_before, c.rmse_after))
    if given - before > before - after:  # they take more than the effect adds
        start = number(c.rmse_as_given)
        aside += f"; {number(c.rmse_before)} with small corrections in place of the effect"
    return f"{start} to {number(c.rmse_after)} {c.unit} ({aside})"


def _chance(probability: float) -> str:
    return "above 0.99" if probability > 0.99 else f"{probability:.2f}"


def named(effect: FoundEffect) -> str:
    """An effect with its rotor and its first numbers; a switch has no interval, and is no number."""
    determined = [p for p in effect.parameters if p.name == "rotor" or p.ci[0] < p.ci[1]]
    shown = [
        f"{_words(p)} {number(p.value)}{'' if p.unit in ('', '1') else f' {p.unit}'}"
        for p in map(in_mm, determined[:2])
    ]
    return effect.name + (f" ({', '.join(shown)})" if shown else "")


def in_mm(p: ParameterValue) -> ParameterValue:
    """A short length in millimetres, as a ruler has it."""
    if p.unit != "m" or max(map(abs, (p.value, *p.ci))) >= SHORT_M:
        return p
    low, high = (1e3 * end for end in p.ci)
    return replace(p, name=f"{p.name.removesuffix('_m')}_mm", value=1e3 * p.value, ci=(low, high), unit="mm")


def _words(parameter: ParameterValue) -> str:
    """A parameter's name without its unit, which stands behind the number."""
    unit = parameter.unit.replace(" ", "_").replace("/", "_")
    return parameter.name.removesuffix(f"_{unit}").replace("_", " ")


def least_shown(result: Refinement) -> str:
    """What of each effect would not have been named, had it been there."""
    parts, hidden = [], [w.name for w in result.would_show if w.share >= HIDDEN]
    for w in result.would_show:
        alike = f" (or taken it for {w.not_told_from[0]})" if w.not_told_from else ""
        if w.share < HIDDEN:
            parts.append(f"{w.name} below {100 * w.share:.2g} % of {w.channel}{alike}")
    parts += [f"nothing of {', '.join(hidden)}"] if hidden else []
    return f"this log would not have shown: {'; '.join(parts)}" if parts else ""


def surface(result: Refinement) -> str:
    """What a smooth surface over both speeds holds beyond polynomials, channel by channel."""
    sizes = [f"{number(s.rms)} {s.unit} ({s.share:.1%}) of {s.channel}" for s in result.surface]
    return f"a smooth surface over them holds {', '.join(sizes)}"


def _probable(evidence: Mapping[str, Any]) -> str:
    """How probable a claim is, and by how much no other name is."""
    sentences = f"probability {_chance(evidence['probability'])}"
    return (
        f"{sentences}, log evidence {evidence['nats']:.0f} above any other name's"
        if "nats" in evidence
        else sentences
    )


def either(a: Ambiguous) -> str:
    """The names of a doubt, with how probable each is."""
    if not a.probability:
        return " or ".join(a.names)
    return " or ".join(f"{n} (probability {p:.2f})" for n, p in zip(a.names, a.probability, strict=True))


def remarks(result: Refinement) -> Iterator[str]:
    """What a reader must know besides the tables."""
    for reason in result.reasons[1:]:
        yield reason.line()
    for e in result.effects:
        if "probability" in e.evidence:
            yield f"{e.name}: {_probable(e.evidence)}"
    for a in result.ambiguous:
        yield f"ambiguous: {either(a)}" + (f"; to separate: {a.separate_by}" if a.separate_by else "")
    for u in result.unexplained:
        yield f"unexplained: {u.channel} still follows {', '.join(u.depends_on)} ({u.where})"
    if result.surface and not result.at_floor:
        yield f"beside that the loads are no polynomials of the speeds: {surface(result)}"
    for s in result.suspect_data:
        yield s.line()
    for r in result.rejected:
        if r.why.startswith("cannot be judged"):
            yield f"{r.name}: {r.why}"
    if result.would_show:
        yield least_shown(result)
    if result.next_run is not None:
        yield f"to tell {' from '.join(result.next_run.names)}: {result.next_run.text}"
    yield from result.notes


def number(value: float) -> str:
    """A number with three significant digits."""
    return f"{value:.{DIGITS}g}" if abs(value) < 1e4 else f"{value:.0f}"


def _with_interval(value: float, interval: tuple[float, float]) -> str:
    """A rotor's number or a switch was chosen, not measured: it has no interval."""
    if interval[0] == interval[1]:
        return number(value)
    return f"{number(value)} ({number(interval[0])}–{number(interval[1])})"


def _errors(result: Refinement) -> Any:
    held_out = next((c.held_out_rows for c in result.channels.values()), 0)
    rows = [
        (
            name, c.unit, number(c.rmse_as_given), _with_interval(c.rmse_before, c.ci_before),
            _with_interval(c.rmse_after, c.ci_after), number(c.noise_floor),
        )
        for name, c in result.channels.items()
    ]  # fmt: skip
    title = f"residual: RMS and 95 % interval on {held_out} held-out rows"
    return table(title, ("channel", "unit", "as given", "corrected", "with effects", "floor"), rows, left=2)


def _effects(result: Refinement) -> Any:
    rows = [
        (
            e.name if i == 0 else "", p.name, _with_interval(p.value, p.ci),
            "" if p.unit == "1" else p.unit,
        )
        for e in result.effects
        for i, p in enumerate(map(in_mm, e.parameters))
    ]  # fmt: skip
    return table("effects added", ("effect", "parameter", "value (95 %)", "unit"), rows, left=2)
