"""What every page shares: one file, the answer first, tables that fit a phone, how it was made."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Sequence

from coaxlink.report.html import escape
from coaxlink.report.made import Made

MANY = 4  # columns: a table of more is a card a row on a phone
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
th:first-child,td:first-child,td.text{text-align:left}td:first-child{white-space:pre}th.why,td.why{text-align:left;white-space:normal}
th{color:var(--dim);font-weight:600}img{max-width:100%;height:auto;background:#fff;border-radius:4px}
li{margin:.2rem 0}p,li,dd{overflow-wrap:anywhere}
@media(max-width:40rem){th:first-child,td:first-child{white-space:pre-wrap;min-width:6rem}
th,td{padding:.25rem .4rem}}
.lead{border-left:4px solid var(--mark);padding-left:.8rem;margin:.8rem 0 1.2rem}
figure{margin:1.2rem 0}figcaption{color:var(--dim);font-size:.85rem}
details{margin:1rem 0}summary{cursor:pointer;color:var(--mark)}
code{font-size:.85em;overflow-wrap:anywhere}
@media(max-width:40rem){table.cards tr:first-child{display:none}
table.cards,table.cards tbody{display:block}
table.cards tr{display:block;border-bottom:1px solid var(--line);padding:.4rem 0}
table.cards td{display:flex;justify-content:space-between;gap:1rem;border:0;padding:.1rem 0}
table.cards td{white-space:normal}table.cards td:first-child{white-space:pre-wrap}
table.cards td::before{content:attr(data-label);color:var(--dim)}table.cards td:empty{display:none}
table.cards td:first-child{font-weight:600;justify-content:flex-start}
table.cards td:first-child::before{display:none}
figure{overflow-x:auto}figure img{max-width:none;width:44rem}}
@media print{:root{--ink:#000;--dim:#444;--line:#999;--paper:#fff;--mark:#000}details>*{display:block}}
"""


def document(title: str, parts: Iterable[str]) -> str:
    """A page of these HTML parts under its title."""
    body = "\n".join((f"<h1>{escape(title)}</h1>", *parts))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def answer(sentence: str) -> str:
    """The first thing to read: one sentence that says it."""
    return f'<p class="lead">{escape(sentence)}</p>'


def picture(png: bytes, caption: str) -> str:
    """A figure inside the page, with what it shows below it (and for who cannot see it)."""
    image = base64.b64encode(png).decode()
    words = escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{image}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def folded(summary: str, html: str) -> str:
    """What most readers need not see, behind a line that says what it is."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>"


def listed(lines: Iterable[str]) -> str:
    """Plain lines as a list."""
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def html_table(heads: Sequence[str], rows: Sequence[Sequence[str]], wide: Sequence[int] = ()) -> str:
    """An HTML table; the columns in `wide` may wrap, one of many columns is a card a row on a phone."""
    left = ' class="why"'
    head = "".join(f"<th{left if i in wide else ''}>{escape(h)}</th>" for i, h in enumerate(heads))
    kind = ' class="cards"' if len(heads) > MANY else ""

    def cell(i: int, text: str) -> str:
        label = f' data-label="{escape(heads[i])}"' if kind and i < len(heads) else ""
        why = ' class="why"' if i in wide else ""
        return f"<td{why}{label}>{escape(text)}</td>"

    body = "\n".join(f"<tr>{''.join(cell(i, text) for i, text in enumerate(row))}</tr>" for row in rows)
    return f'<div class="wide"><table{kind}><tr>{head}</tr>\n{body}</table></div>'


def how_made(made: Made) -> Iterator[str]:
    """The last section: command, date, versions, commit, and the hash of every file that went in."""
    yield "<h2>How this page was made</h2>"
    yield f"<p><code>{escape(made.command)}</code></p>" if made.command else ""
    yield f'<p class="dim">{escape(made.versions())}</p>'
    if made.files:
        yield html_table(("file", "SHA-256"), [(name, digest) for name, digest in made.files], wide=(1,))
