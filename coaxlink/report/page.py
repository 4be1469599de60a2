"""A refinement as one self-contained HTML page: no other file, no network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from coaxlink.report.document import answer, document, folded, how_made, html_table, listed, picture
from coaxlink.report.html import escape
from coaxlink.report.made import Made
from coaxlink.report.pictures.label import channel_words
from coaxlink.report.refine import number, remarks, verdict
from coaxlink.residual.result import FoundEffect, ParameterValue, Refinement

FEW = 4  # remarks of one kind; more are one line and a fold
LEAST_P = 1e-6  # nobody needs to know how much less


def page(
    result: Refinement,
    title: str = "What the model lacks",
    opening: Sequence[tuple[str, str]] = (),
    *,
    lead: str = "",
    made: Made | None = None,
) -> str:
    """The whole report as HTML; `opening` (heading, HTML) stands before the pictures, `lead` before all."""
    made = made or Made()
    return document(
        title,
        [
            answer(lead or sentence(result)),
            provenance(result),
            *(f"<h2>{escape(heading)}</h2>{html}" for heading, html in opening),
            *pictures(result, made),
            *found(result),
            *tried(result),
            *how_made(made),
        ],
    )


def sentence(result: Refinement) -> str:
    """The answer in one sentence: what was found, where it shows most, and what is left of that."""
    said = verdict(result)
    if not result.effects:
        return f"{said[:1].upper()}{said[1:]}."
    named = "; ".join(_named(e) for e in result.effects)
    errors = {n: c for n, c in result.channels.items() if c.rmse_after > 0.0}
    if not errors:
        return f"Found: {named}."
    name = max(errors, key=lambda n: errors[n].rmse_before / errors[n].rmse_after)
    c = errors[name]
    return (
        f"Found: {named}; the error of the {channel_words(name)} falls from {number(c.rmse_before)} to "
        f"{number(c.rmse_after)} {c.unit} (noise alone: {number(c.noise_floor)})."
    )


def _named(effect: FoundEffect) -> str:
    """An effect in words with its rotor and its first numbers; a switch has no interval, and is no number."""
    determined = [p for p in effect.parameters if p.name == "rotor" or p.ci[0] < p.ci[1]]
    shown = ", ".join(
        f"{_words(p)} {number(p.value)}{'' if p.unit in ('', '1') else f' {p.unit}'}" for p in determined[:2]
    )
    return effect.name.replace("_", " ") + (f" ({shown})" if shown else "")


def _words(parameter: ParameterValue) -> str:
    """A parameter's name without its unit, which stands behind the number."""
    unit = parameter.unit.replace(" ", "_").replace("/", "_")
    return parameter.name.removesuffix(f"_{unit}").replace("_", " ")


def provenance(result: Refinement) -> str:
    """From which data the answer is."""
    return (
        f'<p class="dim">{escape(result.source)} &middot; {escape(result.kind)} data &middot; '
        "all errors on blocks the fit did not use</p>"
    )


def found(result: Refinement) -> list[str]:
    """The errors before and after, the effects and the remarks."""
    parts = ["<h2>Residual of the model before and after</h2>", _errors(result)]
    if result.effects:
        parts += ["<h2>Effects</h2>", _effects(result)]
    said = list(remarks(result))
    if said:
        parts += ["<h2>Remarks</h2>", *_remarks(said)]
    return parts


def tried(result: Refinement) -> list[str]:
    """Every step of the selection, and the small corrections of the base."""
    parts = [folded(f"What was tried, and why it lost ({len(result.trace)} steps)", _trace(result))]
    if result.corrections:
        said = '<p class="dim">Fitted with every candidate, inside bounds; none of them is an effect.</p>'
        rows = [(n, number(v)) for n, v in result.corrections.items()]
        parts.append(
            folded("Small corrections of the base", said + html_table(("correction", "value"), rows))
        )
    return parts


def count(value: float) -> str:
    """A number that a person reads at once: 8648779 is 8.6 million."""
    if abs(value) >= 1e6:
        return f"{value / 1e6:.3g} million"
    return f"{value:,.0f}" if abs(value) >= 1e4 else number(value)


def chance(p: float) -> str:
    """A probability as one reads it: never 0."""
    return "below 1 in a million" if p < LEAST_P else f"{p:.1g}"


def _remarks(said: Sequence[str]) -> Iterable[str]:
    """Remarks that say the same of several things are one line; long ones are folded away."""
    same: dict[str, list[str]] = {}
    for line in said:
        what, between, why = line.partition(": ")
        same.setdefault(why if between else line, []).append(what if between else "")
    merged = [
        f"{', '.join(dict.fromkeys(names))}: {why}" if any(names) else why for why, names in same.items()
    ]
    judged = [line for line in merged if "cannot be judged" not in line]
    left = [line for line in merged if line not in judged]
    yield listed(judged) if judged else ""
    if len(left) > FEW:
        yield folded(f"{len(left)} effects that these data cannot judge", listed(left))
    elif left:
        yield listed(left)


def pictures(result: Refinement, made: Made) -> Iterable[str]:
    """The residual over time and cause, and the error of every channel; nothing without a series."""
    if result.series is None:
        return
    from coaxlink.report.pictures.residual_plots import errors, overview

    yield picture(overview(result, made.line()), "Residual before and after, over time and over its cause")
    said = "Error of every channel before and after, in units of its noise floor"
    yield picture(errors(result, made.line()), said)


def _errors(result: Refinement) -> str:
    rows = [
        (
            channel_words(name),
            c.unit,
            number(c.rmse_as_given),
            number(c.rmse_before),
            " .. ".join(map(number, c.ci_before)),
            number(c.rmse_after),
            " .. ".join(map(number, c.ci_after)),
            number(c.noise_floor),
            str(c.held_out_rows),
        )
        for name, c in result.channels.items()
    ]
    heads = (
        "channel",
        "unit",
        "as given",
        "before",
        "before, 95 %",
        "after",
        "after, 95 %",
        "noise floor",
        "rows",
    )
    return html_table(heads, rows)


def _effects(result: Refinement) -> str:
    rows = []
    for e in result.effects:
        for i, p in enumerate(e.parameters):
            interval = " .. ".join(map(number, p.ci)) if p.ci[0] < p.ci[1] else ""
            unit = "" if p.unit == "1" else p.unit
            source = e.source if i == 0 else ""
            rows.append((e.name if i == 0 else "", p.name, number(p.value), interval, unit, source))
    return html_table(("effect", "parameter", "value", "95 %", "unit", "physics and source"), rows, wide=(5,))


def _trace(result: Refinement) -> str:
    rows = [
        (str(s.number), s.action, s.name, count(s.gain), chance(s.p_value), f"{100 * s.size:.2f} %",
         "yes" if s.kept else "no", s.why)
        for s in result.trace
    ]  # fmt: skip
    rows += [("", "", r.name, "", "", "", "no", r.why) for r in result.rejected if "cannot" in r.why]
    heads = ("step", "action", "effect", "gain, noise variances", "by chance", "size", "kept", "why")
    return html_table(heads, rows, wide=(7,))
