"""What the autopilot said in words (STATUSTEXT), with times; long texts come in pieces and are joined."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from firmware_params.plain import plain

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
MOST = 500  # texts that are kept
_LONG = 1000  # characters of one text: a sender may go on for ever


@dataclass(frozen=True)
class Said:
    """One text."""

    received_s: float  # as the readings' arrivals
    clock_s: float | None  # the vehicle's time since boot, of its newest stamped message before
    severity: int  # 0 (emergency) .. 7 (debug), MAV_SEVERITY
    text: str

    @property
    def word(self) -> str:
        """The severity in a word."""
        return SEVERITIES[self.severity] if 0 <= self.severity < len(SEVERITIES) else str(self.severity)


class Texts:
    """The last MOST texts, oldest first."""

    def __init__(self) -> None:
        self._said: deque[Said] = deque(maxlen=MOST)
        self._piece: tuple[int, int] = (0, 0)  # id and number of the last piece

    def take(self, message: Any, received_s: float, clock_s: float | None) -> None:
        """Add a STATUSTEXT."""
        raw = message.text
        words = raw.decode("utf-8", "replace") if isinstance(raw, bytes) else str(raw)
        words = plain(words.partition("\0")[0], _LONG)
        piece = int(getattr(message, "id", 0) or 0), int(getattr(message, "chunk_seq", 0) or 0)
        follows = piece[0] and piece == (self._piece[0], self._piece[1] + 1)
        self._piece = piece
        if follows and self._said:
            last = self._said.pop()
            self._said.append(replace(last, text=(last.text + words)[:_LONG]))
        elif words.strip():
            self._said.append(Said(received_s, clock_s, int(message.severity), words.strip()))

    def clear(self) -> None:
        """Forget all: another vehicle is watched."""
        self._said.clear()

    def all(self) -> tuple[Said, ...]:
        """Oldest first."""
        return tuple(self._said)
