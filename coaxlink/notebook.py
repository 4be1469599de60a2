"""What a notebook shows of a result: whatever renderer is registered makes it; else its printed form.

Results stand below the room that draws them, so they cannot name it: it is registered from above
(`coaxlink/__init__.py`).
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own takes longer to load than all of this
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def _printed(thing: Any) -> str:
    import html

    return f"<pre>{html.escape(str(thing))}</pre>"


_renderer: Callable[[Any], str] = _printed


def register(renderer: Callable[[Any], str]) -> None:
    """Let `renderer` make the HTML of every result from now on."""
    global _renderer
    _renderer = renderer


class Shown:
    """A result that a notebook shows with its picture."""

    def _repr_html_(self) -> str:
        return _renderer(self)
