"""How an upload ends, and what it tells and asks on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from coaxlink.errors import CheckFailed, CoaxlinkError
from coaxlink.link.parameters import Number, Value

VERIFIED, REFUSED, ROLLED_BACK, FAILED = "verified", "refused", "rolled_back", "failed"
DRY_RUN = "dry_run"


@dataclass(frozen=True)
class Change:
    """One parameter that is to change."""

    name: str
    old: Value  # without bits when the board has none of this name yet
    new: Value


@dataclass(frozen=True)
class Outcome:
    """How an upload ended; `to_json` is the contract's object."""

    result: str
    changed: tuple[Change, ...] = ()
    files: tuple[str, ...] = ()
    backup: str = ""
    mismatches: tuple[dict[str, Any], ...] = ()
    retries: int = 0
    reason: str = ""
    vehicle: str = ""
    error: CoaxlinkError | None = field(default=None, compare=False)
    scripts: tuple[str, ...] = ()  # paths of files on board that changed

    def to_json(self) -> dict[str, Any]:
        """The JSON of `upload`."""
        return {
            "result": self.result,
            "changed": [
                {"name": c.name, "old": finite(c.old.value), "new": finite(c.new.value)} for c in self.changed
            ],
            "files": list(self.files),
            "backup": self.backup,
            "mismatches": list(self.mismatches),
            "retries": self.retries,
            "scripts": list(self.scripts),
            "reason": self.reason,
            "vehicle": self.vehicle,
        }


@dataclass
class Talk:
    """What an upload tells and asks its user."""

    say: Callable[[str], None] = lambda text: None
    difference: Callable[[tuple[Change, ...]], None] = lambda changes: None
    confirm: Callable[[], bool] = lambda: True
    progress: Callable[[int, int], None] | None = None


class Unfinished(CheckFailed):
    """An upload that did not end as it should; the exit code is that of its cause."""

    def __init__(self, text: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(text)


class Mismatch(CheckFailed):
    """The board holds something else than what was written."""

    def __init__(self, wrong: Sequence[dict[str, Any]]) -> None:
        self.wrong = tuple(wrong)
        first = wrong[0]
        super().__init__(f"{first['name']}: {first['wanted']} was written, the board holds {first['found']}")


def mismatch(wanted: Value, found: Value | None) -> dict[str, Any]:
    """A row of `mismatches`."""
    return {
        "name": wanted.name,
        "wanted": finite(wanted.value),
        "found": finite(found.value) if found else None,
    }


def finite(value: Number) -> Number | None:
    """JSON has no NaN; boards have parameters that are."""
    return value if math.isfinite(value) else None
