"""An identification as one self-contained HTML page: the answer, pictures, tables, remarks."""

from __future__ import annotations

from collections.abc import Iterator

from coaxlink.report.html import PagePicture, PageTable, render
from coaxlink.report.identify import NAMES, remarks, sentence, unit_of
from coaxlink.report.made import Made
from coaxlink.report.pictures.figures import drawn
from coaxlink.report.pictures.identify_plots import figures
from coaxlink.report.pictures.label import channel_words
from coaxlink.rotor.identification import Identification

CAPTIONS = {
    "surfaces": "Each load over a rotor's speed, for some speeds of the other: data (points), model (lines)",
    "residuals": "What the model misses on rows that the fit did not use",
}
FEW = 6  # remarks that stand open


def identify_page(result: Identification, made: Made | None = None) -> str:
    """The page. Raises what drawing raises."""
    made = made or Made()
    shown = {
        name: PagePicture(drawn(figure), CAPTIONS[name])
        for name, figure in figures(result, made.line()).items()
    }
    sentences = list(remarks(result))
    terms = PageTable(("load", "term", "value", "95 % interval"), list(_terms(result)))
    return render(
        "identify.html",
        title=f"{NAMES[result.form]} of {result.data.samples.source}",
        lead=sentence(result),
        made=made,
        rows=result.data.samples.rows,
        pictures=list(shown.values()),
        errors=PageTable(("channel", "form", "RMSE", "of the range", "R", "rows"), list(_errors(result))),
        terms=terms,
        remarks=sentences[:FEW],
        more=sentences[FEW:],
    )


def _errors(result: Identification) -> Iterator[tuple[str, ...]]:
    for channel in result.channels:
        unit, words = unit_of(channel), channel_words(channel)
        for form, channels in result.comparison.items():
            e = channels[channel]
            share = f"{100 * e.nrmse:.2f} %"
            yield words, NAMES[form], f"{e.rmse:.3g} {unit}", share, f"{e.r:.5f}", str(e.held_out_rows)
        if channel in result.noise_floor:
            yield words, "noise floor", f"{result.noise_floor[channel]:.3g} {unit}", "", "", ""


def _terms(result: Identification) -> Iterator[tuple[str, ...]]:
    for load, terms in result.model.terms().items():
        bounds = result.intervals[load].bounds if load in result.intervals else {}
        for term, value in terms.items():
            interval = f"{bounds[term][0]:.4g} .. {bounds[term][1]:.4g}" if term in bounds else "open"
            yield load, term, f"{value:.5g}", interval
