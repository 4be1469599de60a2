"""How an upload ends, and what it tells and asks on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from coaxlink.errors import CheckFailed, CoaxlinkError, SafetyRefusal
from coaxlink.mavlink.parameters import Number, Value

VERIFIED, REFUSED, ROLLED_BACK, FAILED = "verified", "refused", "rolled_back", "failed"
DRY_RUN = "dry_run"
INCOMPLETE = "incomplete"  # restore --all: whole but for parameters of the rest that the board refused


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
    learned: tuple[Change, ...] = ()  # values that the board learned since; left as they are
    left_out: Mapping[str, str] = field(default_factory=dict)  # the board's own by name, and their kind
    passed_over: Mapping[str, str] = field(default_factory=dict)  # refused by name, and how
    standing: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # after arming: what holds which

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
            "learned": [
                {"name": c.name, "found": finite(c.old.value), "wanted": finite(c.new.value)}
                for c in self.learned
            ],
            "left_out": [{"name": name, "why": why} for name, why in self.left_out.items()],
            "passed_over": [{"name": name, "why": why} for name, why in self.passed_over.items()],
            "standing": {held: list(names) for held, names in self.standing.items()},
        }


@dataclass
class Talk:
    """What an upload tells and asks its user."""

    say: Callable[[str], None] = lambda text: None
    # the board's parameters and the files that would be touched, before the difference
    present: Callable[[Mapping[str, Number], Mapping[str, bytes | None]], None] = lambda params, files: None
    difference: Callable[[tuple[Change, ...]], None] = lambda changes: None
    confirm: Callable[[], bool] = lambda: True
    progress: Callable[[int, int], None] | None = None


class Armed(SafetyRefusal):
    """The vehicle is armed: nothing is written, nor written on."""


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
        wanted, found = (value_text(first["name"], first[key]) for key in ("wanted", "found"))
        super().__init__(f"{first['name']}: {wanted} was written, the board holds {found}")


def is_file(name: str) -> bool:
    """Whether a row of `mismatches` is of a file: its values are checksums then."""
    return "/" in name or name.endswith(".lua")


def value_text(name: str, value: Number | None) -> str:
    """A value as it is reported: checksums in hexadecimal, as the boards say them."""
    if value is None:
        return "nothing"
    if is_file(name) or (name.endswith("_CHECKSUM") and value >= 0):
        return f"0x{int(value):x}"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


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
