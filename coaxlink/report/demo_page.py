"""The demo as one page: what it is worth first, then the mixers, then what was hidden, then the words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from coaxlink import files
from coaxlink.report.demo import FLIGHT_HEADINGS, flight_rows, split_headings, split_rows
from coaxlink.report.demo_words import TERMS, flown, story
from coaxlink.report.document import answer, document, how_made, html_table
from coaxlink.report.html import escape
from coaxlink.report.identify import error_rows
from coaxlink.report.made import Made
from coaxlink.report.page import found, pictures, provenance, sentence, tried
from coaxlink.report.pictures.figures import write_figures
from coaxlink.report.pictures.residual_plots import overview_figure
from coaxlink.rotor.identification import COAXIAL
from coaxlink.studies.demo import DemoResult

HOW = (
    "One flight each: the same vehicle, path, full battery and noise, the autopilot's gains as they come. "
    'Thrust, N: the allocation error, mean |meant - delivered|. From "after gain" on: what is left of it '
    "when the best constant gain of each axis is taken off."
)


def write_report(out: Path, result: DemoResult, made: Made | None = None) -> Path:
    """Write OUT/report.html (self-contained) and OUT/residual (.png, .svg, .pdf); returns the page's path."""
    made = made or Made()
    write_figures(out, {"residual": overview_figure(result.refinement, made.line())})
    path = out / "report.html"
    files.write_atomic(path, document(f"coaxlink demo, seed {result.seed}", _parts(result, made)))
    return path


def _parts(result: DemoResult, made: Made) -> Iterator[str]:
    first, *more = flown(result.flights)
    yield answer(f"{first} Where one thing was hidden: {_small(sentence(result.refinement))}")
    yield from pictures(result.refinement, made)
    yield from _paragraphs(more)
    yield "<h2>The mixers, where nothing is hidden</h2>"
    yield html_table(FLIGHT_HEADINGS, flight_rows(result.flights))
    yield f'<p class="dim">{escape(HOW)} <a href="#words">The words explained</a></p>'
    yield "<h3>Who carries the weight: upper + lower rotor of each pair, and the lower one's share</h3>"
    yield html_table(split_headings(result.flights), split_rows(result.flights))
    yield from _worth(result)
    yield "<h2>Something is hidden: found from one flight</h2>"
    yield from _paragraphs(story(result))
    yield provenance(result.refinement)
    yield from found(result.refinement)
    yield from tried(result.refinement)
    yield from _rotor(result)
    yield '<h2 id="words">The words</h2>'
    yield f"<dl>{''.join(f'<dt>{escape(k)}</dt><dd>{escape(v)}</dd>' for k, v in TERMS.items())}</dl>"
    yield from how_made(made)


def _worth(result: DemoResult) -> Iterator[str]:
    from coaxlink.report.worth import rows, sentences, terms

    yield "<h2>What a table is worth beyond these flights</h2>"
    yield from _paragraphs(sentences(result.worths))
    yield html_table(("by the rotor model", *(t.name for t in result.worths.rows)), rows(result.worths.rows))
    yield f'<p class="dim">{escape(terms())}</p>'


def _rotor(result: DemoResult) -> Iterator[str]:
    """The model that was flown, and what the other forms would have missed."""
    identified = result.identification
    yield "<h2>The rotor model that was flown, from the stand</h2>"
    yield (
        f'<p class="dim">{identified.data.samples.rows} points of a thrust stand, errors held out. '
        "u_u and u_l are the upper and the lower rotor's speed over full speed.</p>"
    )
    errors = [row for row in error_rows(identified) if row[0] in COAXIAL]
    yield html_table(("channel", "form", "RMSE", "NRMSE", "R", "rows"), errors)
    terms = [
        (load, term, f"{value:.4g}")
        for load, terms in identified.model.terms().items()
        for term, value in terms.items()
    ]
    yield html_table(("load", "term", "value"), terms)


def _small(text: str) -> str:
    return text[:1].lower() + text[1:]


def _paragraphs(lines: Iterable[str]) -> Iterator[str]:
    for line in lines:
        yield f"<p>{escape(line.replace('`', ''))}</p>"
