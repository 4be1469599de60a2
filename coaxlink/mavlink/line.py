"""What shares a session's line below its messages: live mixing sees the bytes first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from coaxlink.errors import LinkError
from coaxlink.mavlink.transport import Transport

MOST_WAITING = 512  # chunks read before they are dealt with; the kernel's buffer holds a few hundred


class Tap(Protocol):
    """Sees the line's bytes first, on the receiver thread; must not raise."""

    @property
    def tick_s(self) -> float:
        """It is called at least so often, with no bytes if none came."""

    def take(self, chunks: Sequence[bytes]) -> None:
        """Everything that waited on the line, in order."""


def read_waiting(line: Transport, timeout_s: float) -> list[tuple[bytes, Any]]:
    """Wait for the first chunk, then read without waiting until the line is empty: (bytes, from where).

    Raises LinkError when the line broke before anything came.
    """
    chunks: list[tuple[bytes, Any]] = []
    while len(chunks) < MOST_WAITING:
        try:
            data, peer = line.read(0.0 if chunks else timeout_s)
        except LinkError:
            if not chunks:
                raise
            break  # the next read raises it again
        if not data:
            break
        chunks.append((data, peer))
    return chunks
