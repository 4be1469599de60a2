"""Is the table still on board? Read only; by value, bit for bit, and by the board's own hash."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coaxlink.errors import CheckFailed, InputError
from coaxlink.mavlink.confirm import confirm
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import FLOAT, Parameters, Value
from coaxlink.mavlink.session import Session
from coaxlink.uploading.ardupilot_scripts import SCRIPT_S, ScriptFolder, await_loader, present_folder
from coaxlink.uploading.ardupilot_words import Words, foreign_matrix
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.outcome import is_file
from coaxlink.uploading.owned import Ownership, switches
from coaxlink.uploading.owners_numbers import for_board
from coaxlink.uploading.plan import Plan
from firmware_params import ardupilot
from firmware_params.ardupilot import scripts


@dataclass(frozen=True)
class Verification:
    """What was held against the board."""

    mismatches: tuple[dict[str, Any], ...]
    checked: int
    source: str  # files, or the time of the last verified upload
    hash: int
    hash_then: int  # at the last verified upload; 0 when unknown
    interrupted: str  # start of an upload that did not end, "" when none
    learned: tuple[dict[str, Any], ...] = ()  # rows as in `mismatches`: what the board learned since
    scripts: int = 0  # of those checked
    kept: tuple[str, ...] = ()  # what of the owner's own numbers is not held against the files, in words
    unflown: str = ""  # why the board does not fly what it holds, in its own words

    @property
    def holds(self) -> bool:
        """True when the table is whole, flown, and no upload is left open."""
        return not self.mismatches and not self.interrupted and not self.unflown

    def counts(self) -> str:
        """How many parameters and scripts differ, in words."""
        files = sum(is_file(row["name"]) for row in self.mismatches)
        values = len(self.mismatches) - files
        parts = []
        if values:
            parts.append(f"{values} of {self.checked - self.scripts} parameters")
        if files:
            parts.append(f"{files} of {self.scripts} script{'s' if self.scripts > 1 else ''}")
        return " and ".join(parts)

    def to_json(self) -> dict[str, Any]:
        """The JSON of `verify`."""
        return {
            "result": "verified" if self.holds else "failed",
            "checked": self.checked,
            "against": self.source,
            "mismatches": list(self.mismatches),
            "learned": list(self.learned),
            "hash": self.hash,
            "hash_at_upload": self.hash_then,
            "other_parameters_changed": bool(self.hash_then) and self.hash != self.hash_then,
            "interrupted": self.interrupted,
            "kept": list(self.kept),
            "unflown": self.unflown,
        }


def verify(
    session: Session, plan: Plan | None, journal: Journal | None = None, *, script_s: float = SCRIPT_S
) -> Verification:
    """Hold the board against a plan, or against what was verified last on this board.

    Raises InputError when there is neither, CheckFailed for a plan of another firmware, LinkError on silence,
    SafetyRefusal when another vehicle answers under the same ids.
    """
    session.ask_version(tries=40)
    if plan is not None and not plan.is_for(session.identity):
        raise CheckFailed(f"{plan.files[0]} is not for {session.identity.name}")
    journal = journal or Journal(session.identity, address=session.address)
    parameters = Parameters(session)
    last = journal.last()
    crcs: Mapping[str, int | None] = {}
    kept: tuple[str, ...] = ()
    if plan is not None:
        outputs = () if session.identity.is_px4 else [f"SERVO{n}_FUNCTION" for n in range(1, 33)]
        found = parameters.read_many([*dict.fromkeys([*plan.params, *outputs])], missing_ok=True)
        wanted, kept = _wanted(plan, parameters, found)
        source = ", ".join(map(str, plan.files))
        crcs = {name: scripts.file_crc(data) for name, data in plan.scripts.items()}
    elif last is not None:
        wanted, source, crcs = dict(last.values), f"upload of {last.time}", last.scripts
        found = parameters.read_many(wanted, missing_ok=True)
    else:
        raise InputError(
            journal.board, "", "nothing was uploaded to this board from here; name the table's DIR"
        )
    board = Files(session)
    late = [n for n in wanted if n not in found and n.startswith(scripts.PREFIX)]
    if late and session.identity.is_ardupilot and await_loader(board, parameters, late, script_s):
        found = parameters.read_many(wanted, missing_ok=True)
    differ = [n for n, v in wanted.items() if n not in found or not v.same(found[n])]
    # what an upload or a restore from here wrote, nobody learned
    written = [
        n for n in differ if last and n in last.values and n in found and last.values[n].same(found[n])
    ]
    learnable = _learned(session, parameters, [n for n in differ if n in found and n not in written])
    if set(learnable) != set(
        differ
    ):  # another table is there: only what was written for this one was learned on
        learnable = [n for n in learnable if last and n in last.values and last.values[n].same(wanted[n])]
    wrong = [_mismatch(wanted[n], found.get(n)) for n in differ if n not in learnable]
    for row in wrong:
        if last and row["name"] in written:
            row["written"] = last.time
    learned = [_mismatch(wanted[n], found[n]) for n in learnable]
    if crcs:
        wrong += _wrong_scripts(board, crcs)
    unflown = ""
    if session.identity.is_ardupilot and any(crc is not None for crc in crcs.values()) and not wrong:
        unflown = _unflown(session, board)
    if session.identity.uid:
        confirm(session)
    entry = journal.open_entry()
    return Verification(
        tuple(wrong),
        len(wanted) + len(crcs),
        source,
        parameters.read_hash(),
        last.hash if last else 0,
        entry.started if entry else "",
        tuple(learned),
        len(crcs),
        kept,
        unflown,
    )


def _unflown(session: Session, board: Files) -> str:
    """Why an ArduPilot board does not fly the table that it holds; "" where nothing speaks against it."""
    others = ScriptFolder(board).others({}, modules=True)
    if found := foreign_matrix(others):
        return found
    return Words(session).table_complaint(None, 0.0)


def _learned(session: Session, parameters: Parameters, names: list[str]) -> list[str]:
    """Those of `names` that the board learns by itself, as it is set up now."""
    held = parameters.read_many(switches(session.identity, names), missing_ok=True)
    owner = Ownership(session.identity, held)
    return [name for name in names if owner.learned(name)]


def _wanted(
    plan: Plan, parameters: Parameters, found: Mapping[str, Value]
) -> tuple[dict[str, Value], tuple[str, ...]]:
    """The plan's values as this board would store them, and what of its owner's stays."""
    if plan.firmware == "px4":
        return {n: parameters.encode(n, v, plan.types[n]) for n, v in plan.params.items()}, ()
    wanted = {}
    made = for_board(plan.params, {n: v.value for n, v in found.items()})
    for name, value in made.params.items():
        if name == "SCR_LD_CHECKSUM":
            continue  # it counts every script on board; each of ours is checked by itself
        kind = found[name].type if name in found else FLOAT
        wanted[name] = parameters.encode(name, ardupilot.as_stored(name, float(value), kind), kind)
    return wanted, made.kept


def _wrong_scripts(board: Files, crcs: Mapping[str, int | None]) -> list[dict[str, Any]]:
    """Scripts (by path, or by name in the script folder) whose CRC on board is another."""
    folder = present_folder(board) or scripts.SCRIPT_FOLDERS[0]
    wrong = []
    for path, wanted in crcs.items():
        found = board.crc(path if "/" in path else f"{folder}/{path}")
        if found != wanted:
            wrong.append({"name": path, "wanted": wanted, "found": found})
    return wrong


def _mismatch(wanted: Value, found: Value | None) -> dict[str, Any]:
    held = found.value if found and found.value == found.value else None
    return {"name": wanted.name, "wanted": wanted.value, "found": held}
