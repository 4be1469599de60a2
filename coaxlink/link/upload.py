"""Put a table on board, all or nothing: difference, backup, write, read back, compare; back again on failure.

The order never changes. From the first write on, a journal on disk knows the old values and the new ones; it
goes away when the board was read back and holds one of the two whole.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from coaxlink.errors import CheckFailed, CoaxlinkError, LinkError, SafetyRefusal
from coaxlink.link.backup import Backup, backup_path, write_backup
from coaxlink.link.journal import Entry, Journal
from coaxlink.link.parameters import Number, Parameters, Snapshot, Value
from coaxlink.link.plan import Plan, refuse_table, refuse_values, refuse_vehicle
from coaxlink.link.reboot import reboot
from coaxlink.link.session import Session

VERIFIED, REFUSED, ROLLED_BACK, FAILED = "verified", "refused", "rolled_back", "failed"
_ROUNDS = 3  # write, read back, and mend what another writer or a late packet changed


@dataclass(frozen=True)
class Change:
    """One parameter that is to change."""

    name: str
    old: Value
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
    scripts: tuple[str, ...] = ()  # paths of scripts that changed

    def to_json(self) -> dict[str, Any]:
        """The JSON of `upload`."""
        return {
            "result": self.result,
            "changed": [
                {"name": c.name, "old": _finite(c.old.value), "new": _finite(c.new.value)}
                for c in self.changed
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


class Uploader:
    """One upload or restore over a session. Every public call ends in an Outcome, also when it fails."""

    def __init__(
        self,
        session: Session,
        *,
        backup_folder: Path,
        talk: Talk | None = None,
        journal: Journal | None = None,
        patience_s: float = 30.0,
        parameters: Parameters | None = None,
        reboot_s: float = 5.0,
    ) -> None:
        self._session = session
        self._parameters = parameters or Parameters(session)
        self._talk = talk or Talk()
        self._backup_folder = backup_folder
        self._journal = journal or Journal(session.identity)
        self._patience_s = patience_s
        self._files: tuple[str, ...] = ()
        self._changes: tuple[Change, ...] = ()
        self._backup = ""
        self._reboot, self._reboot_s = False, reboot_s

    def upload(
        self, plan: Plan, *, dry_run: bool = False, new_geometry: bool = False, reboot: bool = False
    ) -> Outcome:
        """Put a plan on board; with `reboot`, restart the autopilot and read the table once more."""
        self._reboot = reboot
        self._files = tuple(str(path) for path in plan.files)

        def check(board: Mapping[str, Value]) -> None:
            refuse_table(plan, self._session.identity, board, new_geometry=new_geometry)

        def first() -> None:
            refuse_values(plan)
            refuse_vehicle(plan, self._session.identity)

        return self._alone(lambda: self._guarded(plan.params, plan.types, first, check, dry_run))

    def restore(self, backup: Backup, *, dry_run: bool = False) -> Outcome:
        """Put a backup back; only on the board it was taken from."""
        self._files = (str(backup.path),)

        def first() -> None:
            here = self._session.identity.uid or "unknown"
            if backup.board != here:
                raise SafetyRefusal(f"{backup.path.name} is of board {backup.board}, this is {here}")

        return self._alone(
            lambda: self._guarded(backup.params, backup.types, first, lambda board: None, dry_run, True)
        )

    # -- the order of things -------------------------------------------------------------------------------

    def _alone(self, work: Callable[[], Outcome]) -> Outcome:
        try:
            with self._journal.alone():
                return work()
        except CoaxlinkError as error:
            return self._outcome(REFUSED if isinstance(error, SafetyRefusal) else FAILED, error=error)

    def _guarded(
        self,
        params: Mapping[str, Number],
        types: Mapping[str, int],
        first: Callable[[], None],
        check: Callable[[Mapping[str, Value]], None],
        dry_run: bool,
        known_only: bool = False,
    ) -> Outcome:
        try:
            self._refuse_armed()
            first()
            board = self._parameters.read_all(progress=self._talk.progress)
            check(board.values)
            interrupted = self._interrupted()
            target = self._target(params, types, board, interrupted, known_only)
            self._changes = tuple(
                Change(name, board.values[name], value)
                for name, value in target.items()
                if not value.same(board.values[name])
            )
            self._talk.difference(self._changes)
            if dry_run:
                return self._outcome("dry_run")
            if not self._changes:
                self._keep(target)
                return self._outcome(VERIFIED, reason="the board holds it already")
            self._save(board)
            if not self._talk.confirm():
                raise SafetyRefusal("not confirmed; nothing was changed")
            self._refuse_armed()
        except CoaxlinkError as error:
            result = REFUSED if isinstance(error, SafetyRefusal) else FAILED
            return self._outcome(result, error=error)
        return self._write(target, interrupted)

    def _interrupted(self) -> Entry | None:
        entry = self._journal.open_entry()
        if entry:
            self._talk.say(
                f"the upload of {entry.started} to this board did not end; its old table is the way back"
            )
        return entry

    def _target(
        self,
        params: Mapping[str, Number],
        types: Mapping[str, int],
        board: Snapshot,
        interrupted: Entry | None,
        known_only: bool,
    ) -> dict[str, Value]:
        """What the board is to hold: the plan, and the old values of an upload that was interrupted."""
        target = {}
        for name, value in params.items():
            old = board.values.get(name)
            if old is None and known_only:
                self._talk.say(f"{name} is not on this board and stays out")
                continue
            if known_only and not math.isfinite(value):
                continue  # a NaN in a backup is how that board has it; none is ever sent
            if old is None or old.type != types[name]:
                found = f"type {old.type}" if old else "nothing"
                raise SafetyRefusal(f"{name}: type {types[name]} is to be written, the board has {found}")
            target[name] = self._parameters.encode(name, value, types[name])
        if interrupted:
            target = {n: v for n, v in interrupted.old.items() if n in board.values} | target
        return target

    def _save(self, board: Snapshot) -> None:
        path = backup_path(self._backup_folder, self._session.identity)
        write_backup(path, self._session.identity, board)
        self._backup = str(path)
        self._talk.say(f"backup of {len(board.values)} parameters: {path}")

    def _write(self, target: Mapping[str, Value], interrupted: Entry | None) -> Outcome:
        old = {change.name: change.old for change in self._changes}
        new = {change.name: change.new for change in self._changes}
        if interrupted:  # the way back leads to the last whole table, not to what the interruption left
            old |= interrupted.old
            new |= {name: target[name] for name in interrupted.old if name in target}
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        try:
            self._journal.begin(Entry(self._journal.board, old, new, self._backup, self._files, started))
        except CoaxlinkError as error:  # nothing was written yet
            return self._outcome(FAILED, error=error)
        try:
            self._put(new, watch_arming=True)
            if self._reboot:
                self._prove(new)
        except CoaxlinkError as error:
            return self._roll_back(old, error)
        except BaseException:
            self._roll_back(old, CheckFailed("interrupted"))
            raise
        self._keep(target)
        return self._outcome(VERIFIED)

    def _keep(self, target: Mapping[str, Value]) -> None:
        """The board holds the new table whole: end the journal, remember the table for `verify`."""
        self._journal.end()
        try:
            self._journal.record(self._files, target, self._parameters.read_hash())
        except CoaxlinkError as error:
            self._talk.say(f"the table is on board and verified, but cannot be remembered: {error}")

    # -- writing and its undoing ---------------------------------------------------------------------------

    def _put(self, values: Mapping[str, Value], *, watch_arming: bool) -> None:
        """Write, read back, mend. Raises CheckFailed on another value, LinkError, SafetyRefusal."""
        guard = self._refuse_armed if watch_arming else lambda: None
        todo = list(values.values())
        for _ in range(_ROUNDS):
            guard()
            with self._session.listen(("PARAM_VALUE",), lambda m: m.param_id in values) as echoes:
                self._parameters.write_many(todo, before_each=guard)
                self._settle()
                found = self._parameters.read_many(values)
                while (echo := self._session.take(echoes, 0.0)) is not None:
                    found[echo.param_id] = self._parameters.decode(echo)  # the last word, whoever set it
            guard()
            todo = [value for name, value in values.items() if not found[name].same(value)]
            if not todo:
                return
            self._parameters.retries += len(todo)
            self._talk.say(f"{todo[0].name} changed under way; writing it again")
        wrong = [
            {"name": v.name, "wanted": _finite(v.value), "found": _finite(found[v.name].value)} for v in todo
        ]
        raise Mismatch(wrong)

    def _prove(self, values: Mapping[str, Value]) -> None:
        """Reboot, read again: what was written is kept. Raises CheckFailed, LinkError."""
        self._refuse_armed()
        self._talk.say("rebooting, to read the table once more")
        reboot(self._session, self._reboot_s)
        found = self._parameters.read_many(values)
        lost = [v for n, v in values.items() if not found[n].same(v)]
        if lost:
            kept = [
                {"name": v.name, "wanted": _finite(v.value), "found": _finite(found[v.name].value)}
                for v in lost
            ]
            raise Mismatch(kept)

    def _settle(self) -> None:
        # a repeated request may still be under way and act after the read-back
        time.sleep(1.0 if self._session.loss > 0.005 else 0.1)

    def _roll_back(self, old: Mapping[str, Value], error: CoaxlinkError) -> Outcome:
        mismatches = tuple(error.wrong) if isinstance(error, Mismatch) else ()
        self._talk.say(f"{error}; putting the old table back")
        end = time.monotonic() + self._patience_s
        last: CoaxlinkError = error
        while True:
            try:
                self._put(old, watch_arming=False)
            except LinkError as lost:
                last = lost
            except CoaxlinkError as refused:
                last = refused
                if time.monotonic() > end:
                    break
            else:
                self._journal.end()
                text = f"rolled back, the vehicle holds its old table: {error}"
                return self._outcome(
                    ROLLED_BACK, error=Unfinished(text, error.exit_code), mismatches=mismatches
                )
            if time.monotonic() > end:
                break
            self._await_link(end)
        text = (
            f"{error}; the old table could not be put back ({last}). Do not fly, the board may hold both. "
            f"When the link is back: coaxlink restore {self._backup} --connect {self._session.address}"
        )
        return self._outcome(FAILED, error=Unfinished(text, error.exit_code), mismatches=mismatches)

    def _await_link(self, end: float) -> None:
        while time.monotonic() < end:
            try:
                if self._session.wait("HEARTBEAT", 1.0) is not None:
                    return
            except LinkError:  # the line itself is down; the session opens it again
                time.sleep(0.5)

    # -- small ---------------------------------------------------------------------------------------------

    def _refuse_armed(self) -> None:
        if self._session.armed:
            raise SafetyRefusal("the vehicle is armed: disarm it first, a table acts at once")

    def _outcome(
        self,
        result: str,
        *,
        error: CoaxlinkError | None = None,
        mismatches: tuple[dict[str, Any], ...] = (),
        reason: str = "",
    ) -> Outcome:
        return Outcome(
            result,
            self._changes,
            self._files,
            self._backup,
            mismatches,
            self._parameters.retries,
            reason or (str(error) if error else ""),
            f"{self._session.identity.name}, board {self._session.identity.uid or 'unknown'}",
            error,
        )


def _finite(value: Number) -> Number | None:
    return value if math.isfinite(value) else None  # JSON has no NaN; PX4 has parameters that are


class Unfinished(CheckFailed):
    """An upload that did not end as it should; the exit code is that of its cause."""

    def __init__(self, text: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(text)


class Mismatch(CheckFailed):
    """The board holds other values than those written."""

    def __init__(self, wrong: list[dict[str, Any]]) -> None:
        self.wrong = wrong
        first = wrong[0]
        super().__init__(f"{first['name']}: {first['wanted']} was written, the board holds {first['found']}")
