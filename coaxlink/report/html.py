"""Text as HTML that is text to every browser."""

from __future__ import annotations

import html

from firmware_params.plain import plain_lines


def escape(text: str) -> str:
    """Text for an element or a quoted attribute: no markup, no controls, no turned direction of writing."""
    return html.escape(plain_lines(text))
