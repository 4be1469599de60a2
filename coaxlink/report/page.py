"""A refinement as one self-contained HTML page: no other file, no network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.made import Made
from coaxlink.report.pictures.label import channel_words
from coaxlink.report.refine import in_mm, number, remarks, verdict
from coaxlink.residual.result import Refinement

LEAST_P = 1e-6  # nobody needs to know how much less
ERROR_HEADS = (
    "channel", "unit", "as given", "corrected", "corrected, 95 %", "with effects", "with effects, 95 %",
    "noise floor", "rows",
)  # fmt: skip
EFFECT_HEADS = ("effect", "parameter", "value", "95 %", "unit", "physics and source")
TRACE_HEADS = ("step", "action", "effect", "gain, noise variances", "by chance", "size", "kept", "why")


def page(result: Refinement, made: Made | None = None) -> str:
    """The whole report as HTML."""
    made = made or Made()
    title, lead = "What the model lacks", sentence(result)
    return render("refine.html", title=title, lead=lead, made=made, r=refinement_parts(result, made))


def refinement_parts(result: Refinement, made: Made) -> dict[str, Any]:
    """What the templates show of a refinement, as `r`."""
    judged, unjudged = _merged(list(remarks(result)))
    return {
        "provenance": f"{result.source} · {result.kind} data · all errors on blocks the fit did not use",
        "pictures": list(_pictures(result, made)),
        "errors": _errors(result),
        "effects": _effects(result) if result.effects else None,
        "remarks": judged,
        "unjudged": unjudged,
        "steps": len(result.trace),
        "trace": _trace(result),
        "corrections": PageTable(
            ("correction", "value"), [(n, number(v)) for n, v in result.corrections.items()]
        ),
    }


def sentence(result: Refinement) -> str:
    """The answer in one sentence: what was found, where it shows most, and what is left of that."""
    sentences = verdict(result)
    if result.effects:
        sentences = sentences.replace("_", " ")
    return f"{sentences[:1].upper()}{sentences[1:]}."


def count(value: float) -> str:
    """A number that a person reads at once: 8648779 is 8.6 million."""
    if abs(value) >= 1e6:
        return f"{value / 1e6:.3g} million"
    return f"{value:,.0f}" if abs(value) >= 1e4 else number(value)


def chance(p: float) -> str:
    """A probability as one reads it: never 0."""
    return "below 1 in a million" if p < LEAST_P else f"{p:.1g}"


def _merged(sentences: Sequence[str]) -> tuple[list[str], list[str]]:
    """Remarks, those that say the same of several things as one line; and what cannot be judged."""
    same: dict[str, list[str]] = {}
    for line in sentences:
        what, between, why = line.partition(": ")
        same.setdefault(why if between else line, []).append(what if between else "")
    merged = [
        f"{', '.join(dict.fromkeys(names))}: {why}" if any(names) else why for why, names in same.items()
    ]
    judged = [line for line in merged if "cannot be judged" not in line]
    return judged, [line for line in merged if line not in judged]


def _pictures(result: Refinement, made: Made) -> Sequence[PagePicture]:
    """The residual over time and cause, and the error of every channel; nothing without a series."""
    if result.series is None:
        return ()
    from coaxlink.report.pictures.figures import drawn
    from coaxlink.report.pictures.residual_plots import errors_figure, overview_figure

    errors = "Error of every channel in units of its noise floor"
    return (
        PagePicture(
            drawn(overview_figure(result, made.line())),
            "Residual as given, with small corrections, and with what was found, over time and its cause",
        ),
        PagePicture(drawn(errors_figure(result, made.line())), errors),
    )


def _errors(result: Refinement) -> PageTable:
    rows = [
        (
            channel_words(name), c.unit, number(c.rmse_as_given),
            number(c.rmse_before), " .. ".join(map(number, c.ci_before)),
            number(c.rmse_after), " .. ".join(map(number, c.ci_after)),
            number(c.noise_floor), str(c.held_out_rows),
        )
        for name, c in result.channels.items()
    ]  # fmt: skip
    return PageTable(ERROR_HEADS, rows)


def _effects(result: Refinement) -> PageTable:
    rows = []
    for e in result.effects:
        for i, p in enumerate(map(in_mm, e.parameters)):
            interval = " .. ".join(map(number, p.ci)) if p.ci[0] < p.ci[1] else ""
            unit = "" if p.unit == "1" else p.unit
            source = e.source if i == 0 else ""
            rows.append((e.name if i == 0 else "", p.name, number(p.value), interval, unit, source))
    return PageTable(EFFECT_HEADS, rows, wide=(5,))


def _trace(result: Refinement) -> PageTable:
    rows = [
        (str(s.number), s.action, s.name, count(s.gain), chance(s.p_value), f"{100 * s.size:.2f} %",
         "yes" if s.kept else "no", s.why)
        for s in result.trace
    ]  # fmt: skip
    rows += [("", "", r.name, "", "", "", "no", r.why) for r in result.rejected if "cannot" in r.why]
    return PageTable(TRACE_HEADS, rows, wide=(7,))
