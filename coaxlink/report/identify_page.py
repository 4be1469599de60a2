"""An identification as one self-contained HTML page: tables, remarks and pictures, no other file."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping

from coaxlink.report.html import escape
from coaxlink.report.identify import NAMES, remarks
from coaxlink.rotor.identification import Identification

_STYLE = """
:root{color-scheme:light dark}
body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.4rem}h2{font-size:1.05rem;margin:2rem 0 .5rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:.25rem .7rem;border-bottom:1px solid #8a8f9866;text-align:right;white-space:nowrap}
th:first-child,td:first-child,th:nth-child(2),td:nth-child(2){text-align:left}
img{max-width:100%;height:auto;background:#fff;border-radius:4px}
"""
CAPTIONS = {
    "surfaces.png": "Data and model",
    "residuals.png": "What the model misses on rows it has not seen",
    "tolerance.png": "What a wider tolerance leaves of the dictionary",
    "efficiency.png": "Efficiency over coaxial thrust",
}


def identify_page(result: Identification, pictures: Mapping[str, bytes]) -> str:
    """The page; `pictures` are PNG bytes by file name."""
    source = escape(result.bench.samples.source)
    parts = [
        f"<h1>{NAMES[result.form]} of {source}</h1>",
        f"<p>{result.bench.samples.rows} rows; all errors on blocks the fit has not seen.</p>",
        "<h2>Errors</h2>",
        _table(("channel", "form", "RMSE", "NRMSE", "R", "rows"), _errors(result)),
        "<h2>Terms</h2>",
        _table(("load", "term", "value", "95 % interval"), _terms(result)),
        "<h2>Remarks</h2><ul>",
        *(f"<li>{escape(remark)}</li>" for remark in remarks(result)),
        "</ul>",
    ]
    for name, png in pictures.items():
        caption = escape(CAPTIONS.get(name, name))
        data = base64.b64encode(png).decode()
        parts.append(f'<h2>{caption}</h2><img alt="{caption}" src="data:image/png;base64,{data}">')
    body = "\n".join(parts)
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>coaxlink identify: {source}</title><style>{_STYLE}</style>\n<body>{body}</body></html>\n"
    )


def _table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def _errors(result: Identification) -> Iterable[tuple[str, ...]]:
    for channel in result.channels:
        unit = "N" if channel.endswith("thrust") else "N m"
        for form, channels in result.comparison.items():
            e = channels[channel]
            yield (
                channel,
                NAMES[form],
                f"{e.rmse:.4g} {unit}",
                f"{e.nrmse:.4f}",
                f"{e.r:.5f}",
                str(e.held_out_rows),
            )
        if channel in result.noise_floor:
            yield channel, "noise floor", f"{result.noise_floor[channel]:.4g} {unit}", "", "", ""


def _terms(result: Identification) -> Iterable[tuple[str, ...]]:
    for load, terms in result.model.terms().items():
        bounds = result.intervals[load].bounds if load in result.intervals else {}
        for term, value in terms.items():
            interval = f"{bounds[term][0]:.4g} .. {bounds[term][1]:.4g}" if term in bounds else "open"
            yield load, term, f"{value:.5g}", interval
