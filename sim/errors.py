"""What the world raises on purpose. It knows nothing of the guest's exceptions; the verb translates them.

SimError
├── WorldError   a file or option the world cannot use
└── PortError    an address it cannot open
"""

from __future__ import annotations

from pathlib import Path

from firmware_params.plain import plain


class SimError(Exception):
    """Base of all errors the world raises; its text is one plain line, whatever a file put into it."""

    def __init__(self, text: str) -> None:
        super().__init__(plain(text))


class SimulationError(SimError):
    """A file or option that cannot be used: `source`, `where` in it, `problem`."""

    def __init__(self, source: str | Path, where: str, problem: str) -> None:
        self.source, self.where, self.problem = str(source), where, problem
        prefix = f"{self.source}: {where}" if where else self.source
        super().__init__(f"{prefix}: {problem}")


class PortError(SimError):
    """`address` cannot be opened."""

    def __init__(self, address: str, problem: str) -> None:
        self.address, self.problem = address, problem
        super().__init__(f"{address}: {problem}")
