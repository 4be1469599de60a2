"""What shares a session's line below its messages: the bytes that came, and the numbers of those that go."""

from __future__ import annotations

from typing import Any, Protocol

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.transport import Transport


class Tap(Protocol):
    """Sees the line's bytes first, on the receiver thread; must not raise."""

    @property
    def tick_s(self) -> float:
        """It is called at least so often, with no bytes if none came."""

    def take(self, data: bytes) -> None:
        """Bytes as they came."""

    def serve(self, line: Transport, peer: Any) -> list[tuple[bytes, Any]] | None:
        """Read the line itself for a while; what came and is not dealt with. None: not now, read for it."""


class Outgoing(mavlink.MAVLink):
    """pymavlink's encoder with its sequence number where the compiled function counts it on too."""

    def __init__(self, system: int, component: int) -> None:
        self.counter = bytearray(1)
        super().__init__(None, system, component)

    @property
    def seq(self) -> int:
        """Of the next frame."""
        return self.counter[0]

    @seq.setter
    def seq(self, value: int) -> None:
        self.counter[0] = value & 0xFF
