"""A refinement as one self-contained HTML page: no other file, no network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence

from coaxlink.report.html import escape
from coaxlink.report.refine import number, remarks, verdict
from coaxlink.residual.result import Refinement

_STYLE = """
:root{color-scheme:light dark;--ink:#1c2430;--dim:#5c6675;--line:#d8dde5;--paper:#fff;--mark:#1f5f8b}
@media(prefers-color-scheme:dark){:root{
--ink:#e6eaf0;--dim:#9aa5b5;--line:#39424f;--paper:#161b22;
--mark:#79b8e8}}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);
max-width:62rem;margin:2rem auto;
padding:0 1rem}
h1{font-size:1.4rem;margin:0 0 .2rem}h2{font-size:1.15rem;margin:2.2rem 0 .5rem}
h3{font-size:1rem;margin:1.4rem 0 .4rem}
a{color:var(--mark)}
.lead{font-size:1.15rem}dt{font-weight:600}dd{margin:0 0 .5rem 1.2rem;color:var(--dim)}
p.dim,td.dim{color:var(--dim)}.verdict{font-size:1.15rem;color:var(--mark);margin:.3rem 0 1rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:.25rem .7rem;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th:first-child,td:first-child,td.text{text-align:left}td.why{text-align:left;white-space:normal}
th{color:var(--dim);font-weight:600}img{max-width:100%;height:auto;background:#fff;border-radius:4px}
li{margin:.2rem 0}p,li,dd{overflow-wrap:anywhere}
@media(max-width:40rem){th:first-child,td:first-child{white-space:normal;min-width:6rem}
th,td{padding:.25rem .4rem}}
"""


def page(
    result: Refinement, title: str = "What the model lacks", opening: Sequence[tuple[str, str]] = ()
) -> str:
    """The whole report as HTML; `opening` (heading, HTML) stands before the pictures."""
    return document(
        title,
        [
            f'<p class="verdict">{escape(verdict(result))}</p>',
            provenance(result),
            *(f"<h2>{escape(heading)}</h2>{html}" for heading, html in opening),
            *found(result),
            *tried(result),
        ],
    )


def document(title: str, parts: Iterable[str]) -> str:
    """A page of these HTML parts under its title."""
    body = "\n".join((f"<h1>{escape(title)}</h1>", *parts))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def provenance(result: Refinement) -> str:
    """From which data the answer is."""
    return (
        f'<p class="dim">{escape(result.source)} &middot; {escape(result.kind)} data &middot; '
        "all errors on blocks the fit has not seen</p>"
    )


def found(result: Refinement) -> list[str]:
    """The pictures, the errors before and after, the effects and the remarks."""
    parts = [*_pictures(result), "<h2>Residual of the model before and after</h2>", _errors(result)]
    if result.effects:
        parts += ["<h2>Effects</h2>", _effects(result)]
    listed = list(remarks(result))
    if listed:
        parts += ["<h2>Remarks</h2><ul>", *(f"<li>{escape(r)}</li>" for r in listed), "</ul>"]
    return parts


def tried(result: Refinement) -> list[str]:
    """Every step of the selection, and the small corrections of the base."""
    parts = ["<h2>What was tried, and why it lost</h2>", _trace(result)]
    if result.corrections:
        parts += [
            "<h2>Small corrections of the base</h2>",
            '<p class="dim">Fitted with every candidate, inside bounds; none of them is an effect.</p>',
            html_table(("correction", "value"), [(n, number(v)) for n, v in result.corrections.items()]),
        ]
    return parts


def _pictures(result: Refinement) -> Iterable[str]:
    if result.series is None:
        return
    from coaxlink.report.residual_plots import errors, overview

    for data, text in (
        (overview(result), "residual before and after, over time and over its cause"),
        (errors(result), "error of every channel before and after, in units of its noise floor"),
    ):
        image = base64.b64encode(data).decode()
        yield f'<p><img alt="{escape(text)}" src="data:image/png;base64,{image}"></p>'


def _errors(result: Refinement) -> str:
    rows = [
        (
            name,
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
    heads = ("channel", "unit", "as given", "before", "95 %", "after", "95 %", "noise floor", "rows")
    return html_table(heads, rows)


def _effects(result: Refinement) -> str:
    rows = []
    for e in result.effects:
        for i, p in enumerate(e.parameters):
            interval = " .. ".join(map(number, p.ci))
            source = e.source if i == 0 else ""
            rows.append((e.name if i == 0 else "", p.name, number(p.value), interval, p.unit, source))
    return html_table(("effect", "parameter", "value", "95 %", "unit", "physics and source"), rows, wide=(5,))


def _trace(result: Refinement) -> str:
    rows = [
        (str(s.number), s.action, s.name, number(s.gain), f"{s.p_value:.1g}", f"{100 * s.size:.2f} %",
         "yes" if s.kept else "no", s.why)
        for s in result.trace
    ]  # fmt: skip
    rows += [("", "", r.name, "", "", "", "no", r.why) for r in result.rejected if "cannot" in r.why]
    heads = ("step", "action", "effect", "gain", "p", "size", "kept", "why")
    return html_table(heads, rows, wide=(7,))


def html_table(heads: Sequence[str], rows: Sequence[Sequence[str]], wide: Sequence[int] = ()) -> str:
    """An HTML table; the columns in `wide` may wrap."""
    head = "".join(f"<th>{escape(h)}</th>" for h in heads)
    body = "\n".join(
        "<tr>"
        + "".join(
            f'<td class="why">{escape(cell)}</td>' if i in wide else f"<td>{escape(cell)}</td>"
            for i, cell in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>\n{body}</table></div>'
