"""How much a line loses, from the sequence numbers of what arrives."""

from __future__ import annotations


class Loss:
    """One sender's messages: how many it sent, how many came."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._sent = self._received = 1

    def heard(self, sequence: int) -> None:
        """A message with this number (0..255) came."""
        step = 1 if self._last is None else (sequence - self._last) % 256
        if 0 < step < 128:  # a step back is a late or doubled message
            self._sent += step
            self._last = sequence
        if step:
            self._received += 1

    @property
    def share(self) -> float:
        """Lost of all that were sent, 0..1."""
        return max(0.0, 1.0 - self._received / self._sent)
