"""Rich consoles to which text is text: no markup, no emoji codes, no control characters of a file's or a
vehicle's. What is meant to be bold is a `rich.text.Text`."""

from __future__ import annotations

from typing import Any

from rich.console import Console, RenderableType
from rich.status import Status
from rich.text import Text

from coaxlink.cli._options import by_option
from firmware_params.plain import plain_lines


class PlainConsole(Console):
    """A console that interprets nothing in a string but the parameters that the library names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, highlight=False, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """A string as it stands; also those of tables, their headings and titles."""
        return super().render_str(
            plain_lines(by_option(text)), **{**options, "markup": False, "emoji": False}
        )

    def status(self, status: RenderableType, **options: Any) -> Status:
        """A status line whose texts are plain as well."""
        return _PlainStatus(_text(status), console=self, **options)


class _PlainStatus(Status):
    def update(self, status: RenderableType | None = None, **options: Any) -> None:
        super().update(None if status is None else _text(status), **options)


def _text(status: RenderableType) -> RenderableType:
    return Text(plain_lines(by_option(status))) if isinstance(status, str) else status
