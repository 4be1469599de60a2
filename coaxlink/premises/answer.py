"""The two answers that are no verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

CANNOT_JUDGE, NOT_THIS_VEHICLE = "cannot judge", "not this vehicle"


@dataclass(frozen=True)
class NotJudged:
    """A premise that the answer hangs on."""

    premise: str  # a key of the airframe file, or what the log lacks
    measure: str  # what to measure, and how
    why: str  # what changes

    def as_json(self) -> dict[str, str]:
        """Plain words."""
        return {"premise": self.premise, "measure": self.measure, "why": self.why}

    def line(self) -> str:
        """In one line."""
        return f"{CANNOT_JUDGE}: measure {self.measure}: {self.why}"


@dataclass(frozen=True)
class OtherVehicle:
    """Something by which log and file are of two vehicles, or of one with its outputs exchanged."""

    check: str  # motors, lift, speeds, outputs, response
    found: float
    expected: tuple[float, float]
    why: str

    def as_json(self) -> dict[str, object]:
        """Plain numbers; no number where there is no ratio."""
        found = self.found if isfinite(self.found) else None
        return {"check": self.check, "found": found, "expected": list(self.expected), "why": self.why}

    def line(self) -> str:
        """In one line."""
        return f"{NOT_THIS_VEHICLE}: {self.why}"


Reason = NotJudged | OtherVehicle


def as_json(reasons: Sequence[Reason]) -> dict[str, object]:
    """The keys of every verb that judges: what it says in place of a verdict, if anything."""
    differs = [r.as_json() for r in reasons if isinstance(r, OtherVehicle)]
    lacks = [r.as_json() for r in reasons if isinstance(r, NotJudged)]
    verdict = {"verdict": NOT_THIS_VEHICLE if differs else CANNOT_JUDGE} if reasons else {}
    return {**verdict, "cannot_judge": lacks, "not_this_vehicle": differs}
