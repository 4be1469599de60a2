"""Is the table still on board? Read only; by value, bit for bit, and by the board's own hash."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from coaxlink.errors import InputError
from coaxlink.link.journal import Journal
from coaxlink.link.parameters import Parameters, Value
from coaxlink.link.plan import Plan
from coaxlink.link.session import Session


@dataclass(frozen=True)
class Verification:
    """What was held against the board."""

    mismatches: tuple[dict[str, Any], ...]
    checked: int
    source: str  # files, or the time of the last verified upload
    hash: int
    hash_then: int  # at the last verified upload; 0 when unknown
    interrupted: str  # start of an upload that did not end, "" when none

    @property
    def holds(self) -> bool:
        """True when the table is whole and no upload is left open."""
        return not self.mismatches and not self.interrupted

    def to_json(self) -> dict[str, Any]:
        """The JSON of `verify`."""
        return {
            "result": "verified" if self.holds else "failed",
            "checked": self.checked,
            "against": self.source,
            "mismatches": list(self.mismatches),
            "hash": self.hash,
            "hash_at_upload": self.hash_then,
            "other_parameters_changed": bool(self.hash_then) and self.hash != self.hash_then,
            "interrupted": self.interrupted,
        }


def verify(session: Session, plan: Plan | None, journal: Journal | None = None) -> Verification:
    """Hold the board against a plan, or against what was verified last on this board.

    Raises InputError when there is neither, LinkError on silence.
    """
    journal = journal or Journal(session.identity)
    parameters = Parameters(session)
    last = journal.last()
    if plan is not None:
        wanted = {n: parameters.encode(n, v, plan.types[n]) for n, v in plan.params.items()}
        source = ", ".join(map(str, plan.files))
    elif last is not None:
        wanted, source = dict(last.values), f"upload of {last.time}"
    else:
        raise InputError(
            journal.board, "", "nothing was uploaded to this board from here; name the table's DIR"
        )
    found = parameters.read_many(wanted, missing_ok=True)
    entry = journal.open_entry()
    return Verification(
        tuple(
            _mismatch(v, found.get(n)) for n, v in wanted.items() if n not in found or not v.same(found[n])
        ),
        len(wanted),
        source,
        parameters.read_hash(),
        last.hash if last else 0,
        entry.started if entry else "",
    )


def _mismatch(wanted: Value, found: Value | None) -> dict[str, Any]:
    held = found.value if found and found.value == found.value else None
    return {"name": wanted.name, "wanted": wanted.value, "found": held}
