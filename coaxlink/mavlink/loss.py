"""How much a line loses, from the sequence numbers of what arrives."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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

    def passed(self, sequences: NDArray[np.uint8]) -> None:
        """Messages with these numbers (n,) came one after the other."""
        self.heard(int(sequences[0]))
        steps = sequences[1:] - sequences[:-1]  # modulo 256
        forward = (steps > 0) & (steps < 128)
        self._sent += int(steps[forward].sum(dtype=int))
        self._received += int((steps != 0).sum())
        self._last = int(sequences[-1])

    @property
    def share(self) -> float:
        """Lost of all that were sent, 0..1."""
        return max(0.0, 1.0 - self._received / self._sent)
