"""Everything coaxlink raises on purpose, and the exit code each ends a verb with.

CoaxlinkError
├── CheckFailed        1  done, and the answer is no
├── InputError         2  unreadable input or wrong use: file, place, what was expected
├── LinkError          3  no link, or the link was lost
└── SafetyRefusal      4  refused for safety (armed, other vehicle, over a limit)
"""

from __future__ import annotations

from pathlib import Path

from firmware_params.plain import plain


class CoaxlinkError(Exception):
    """Base of all errors a user may see; its text is one plain line, whatever it quotes."""

    exit_code = 2

    def __init__(self, text: str) -> None:
        super().__init__(plain(text))


class CheckFailed(CoaxlinkError):
    """The work was done and the answer is no."""

    exit_code = 1


class InputError(CoaxlinkError):
    """A file, key or option that cannot be used.

    `source` is the file (or option), `where` the line, column or key, `problem` what was found and
    what was expected instead.
    """

    exit_code = 2

    def __init__(self, source: str | Path, where: str, problem: str) -> None:
        self.source, self.where, self.problem = str(source), where, problem
        prefix = f"{self.source}: {where}" if where else self.source
        super().__init__(f"{prefix}: {problem}")
        self.map = ""

    def with_map(self, text: str) -> InputError:
        """The same error with a map of the columns, which a verb prints for copying."""
        self.map = self.map or text
        return self


class LinkError(CoaxlinkError):
    """Nobody answers at `address`, or the link went away."""

    exit_code = 3

    def __init__(self, address: str, problem: str) -> None:
        self.address, self.problem = address, problem
        super().__init__(f"{address}: {problem}")


class SafetyRefusal(CoaxlinkError):
    """coaxlink will not do this to an aircraft; `reason` says what must change first."""

    exit_code = 4

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"refused: {reason}")
