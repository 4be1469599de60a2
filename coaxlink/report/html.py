"""Pages by Jinja2: one file each, nothing fetched from elsewhere, every text plain to a browser."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import markupsafe
from jinja2 import Environment, PackageLoader, StrictUndefined

from firmware_params.plain import plain_lines


class PagePicture(NamedTuple):
    """A figure inside the page, with what it shows below it (and for who cannot see it)."""

    png: bytes
    caption: str

    @property
    def source(self) -> markupsafe.Markup:
        """The picture as an address of its own: safe in a page, and longer than any text may be there."""
        return markupsafe.Markup(f"data:image/png;base64,{base64.b64encode(self.png).decode()}")


class PageTable(NamedTuple):
    """A table of a page; the columns in `wide` may wrap."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    wide: Sequence[int] = ()


@cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader("coaxlink.report"),
        autoescape=True,
        finalize=_plain,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["m"] = made.get_template("macros.html").module
    return made


def _plain(value: Any) -> Any:
    """Text without controls and turned directions of writing; what a macro made stays."""
    if value is None:
        return ""
    return value if isinstance(value, markupsafe.Markup) else plain_lines(str(value))


def render(template: str, **given: Any) -> str:
    """A page of `report/templates`; `title` and `made` are of every page."""
    return _environment().get_template(template).render(given) + "\n"


def escape(text: str) -> str:
    """Text for an element or a quoted attribute: no markup, no controls, no turned direction of writing."""
    return str(markupsafe.escape(plain_lines(text)))


def html_table(heads: Sequence[str], rows: Sequence[Sequence[str]], wide: Sequence[int] = ()) -> str:
    """A table as the pages have it: of many columns it is a card a row on a phone."""
    macros: Any = _environment().globals["m"]
    return str(macros.table(PageTable(heads, rows, wide)))
