"""Parameters that an autopilot writes by itself: what a backup of a board holds and no restore should write.

Each row names where in the autopilot's own source that is done.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

LEARNED = "learned"  # a value that the firmware improves in flight or at every start
COUNTER = "counter"
MEASURED = "measured"
READ_ONLY = "read-only"


@dataclass(frozen=True)
class Owned:
    """Parameters of one kind; `names` is a regular expression of whole names."""

    names: str
    kind: str
    source: str
    switch: str = ""  # the firmware only learns while this parameter is not 0

    def owns(self, name: str, params: Mapping[str, float]) -> bool:
        """Whether `name` belongs to the board that has these `params`."""
        if not re.fullmatch(self.names, name):
            return False
        return not self.switch or params.get(self.switch, 1) != 0


def kind_of(rows: Iterable[Owned], name: str, params: Mapping[str, float]) -> str:
    """Kind of the first row that owns `name`, "" for a parameter of the user's."""
    return next((row.kind for row in rows if row.owns(name, params)), "")
