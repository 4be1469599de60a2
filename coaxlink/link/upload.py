"""Put a table on board, all or nothing: difference, backup, write, read back, compare; back again on failure.

The order never changes and is the same for every firmware; what is a firmware's own is in its `Board`.
From the first write on, a journal on disk knows the old content and the new; it goes away when the board was
read back and holds one of the two whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from coaxlink.errors import CheckFailed, CoaxlinkError, LinkError, SafetyRefusal
from coaxlink.link.backup import Backup
from coaxlink.link.board import Board
from coaxlink.link.board_ardupilot import ArduPilotBoard
from coaxlink.link.board_px4 import Px4Board
from coaxlink.link.content import Content
from coaxlink.link.journal import Entry, Journal
from coaxlink.link.outcome import (
    DRY_RUN,
    FAILED,
    REFUSED,
    ROLLED_BACK,
    VERIFIED,
    Change,
    Mismatch,
    Outcome,
    Talk,
    Unfinished,
)
from coaxlink.link.parameters import Parameters, Snapshot, Value
from coaxlink.link.plan import Plan, refuse_values, refuse_vehicle
from coaxlink.link.session import Session
from firmware_params.ardupilot.scripts import file_crc

_ABSENT = b""  # bits of a parameter that the board does not have yet
_CALM_S, _SETTLE_S = 0.05, 1.0  # before reading back; after a failure other words may still be under way
_LOSSY = 0.005


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
        script_s: float = 15.0,
    ) -> None:
        self._session = session
        session.ask_version(tries=40)  # the journal and the backup are a board's, not a line's
        self._talk = talk or Talk()
        self._board: Board
        if session.identity.is_ardupilot:
            self._board = ArduPilotBoard(
                session, talk=self._talk, parameters=parameters, reboot_s=reboot_s, script_s=script_s
            )
        else:
            self._board = Px4Board(session, talk=self._talk, parameters=parameters, reboot_s=reboot_s)
        self._backup_folder = backup_folder
        self._journal = journal or Journal(session.identity)
        self._patience_s = patience_s
        self._files: tuple[str, ...] = ()
        self._changes: tuple[Change, ...] = ()
        self._changed_files: tuple[str, ...] = ()
        self._backup = ""

    def upload(
        self, plan: Plan, *, dry_run: bool = False, new_geometry: bool = False, reboot: bool = False
    ) -> Outcome:
        """Put a plan on board; with `reboot`, restart the autopilot in any case and read the table again."""
        self._files = tuple(str(path) for path in plan.files)

        def first() -> None:
            refuse_values(plan.firmware, plan.params, plan.files[0])
            refuse_vehicle(plan, self._session.identity)

        def wanted(board: Snapshot) -> Content:
            return self._board.planned(plan, board, new_geometry=new_geometry)

        return self._ended(
            lambda: self._carry_out(first, plan.params, wanted, dry_run, reboot, complete=True)
        )

    def restore(self, backup: Backup, *, dry_run: bool = False) -> Outcome:
        """Put a backup back; only on the board it was taken from."""
        self._files = (str(backup.path),)

        def first() -> None:
            here = self._session.identity.uid or "unknown"
            if backup.board != here:
                raise SafetyRefusal(f"{backup.path.name} is of board {backup.board}, this is {here}")
            if not backup.proved:  # a board may hold what no table should; a hand must not add to it
                firmware = "px4" if self._session.identity.is_px4 else "ardupilot"
                refuse_values(firmware, backup.params, backup.path)

        def wanted(board: Snapshot) -> Content:
            return self._board.saved(backup, board)

        return self._ended(lambda: self._carry_out(first, (), wanted, dry_run, False, complete=False))

    # -- the order of things -------------------------------------------------------------------------------

    def _ended(self, work: Callable[[], Outcome]) -> Outcome:
        try:
            with self._journal.alone():
                return work()
        except CoaxlinkError as error:  # before the first write; later ones are dealt with there
            return self._outcome(REFUSED if isinstance(error, SafetyRefusal) else FAILED, error=error)

    def _carry_out(
        self,
        first: Callable[[], None],
        named: Iterable[str],
        wanted: Callable[[Snapshot], Content],
        dry_run: bool,
        restart: bool,
        *,
        complete: bool,
    ) -> Outcome:
        self._refuse_armed()
        if not self._session.identity.uid:
            raise SafetyRefusal(
                "the vehicle does not say which board it is: a journal could not be found again"
            )
        first()
        board = self._board.with_hidden(self._board.snapshot(), named)
        target = wanted(board)
        interrupted = self._interrupted()
        if interrupted:  # what it touched and this plan does not goes back to what it was
            target = target.over(self._board.keepable(interrupted.old, board))
        if complete:
            target = self._board.completed(target, board)
        present = self._board.present(target, board)
        changes = target.differs_from(present)
        self._show(changes, present)
        if dry_run:
            return self._outcome(DRY_RUN)
        if interrupted and self._board.restarts(interrupted.new):
            restart = True  # the files may be there and the restart that makes them fly not
        if not changes.values and not changes.files and not restart:
            self._keep(target)
            return self._outcome(VERIFIED, reason="the board holds it already")
        self._save(board, present, interrupted)
        if not self._talk.confirm():
            raise SafetyRefusal("not confirmed; nothing was changed")
        self._refuse_armed()
        # others may change what an upload leaves: its whole table is proved; a backup is too long for that
        new, old = (target, present) if complete else (changes, present.only(changes))
        if interrupted:  # the way back leads to the last whole table, not to what the interruption left
            old = interrupted.old.over(old)
            new = new.over(target.only(interrupted.old))
        return self._write(target, new, old, present, restart)

    def _interrupted(self) -> Entry | None:
        entry = self._journal.open_entry()
        if entry:
            self._talk.say(
                f"the upload of {entry.started} to this board did not end; its old table is the way back"
            )
        return entry

    def _show(self, changes: Content, present: Content) -> None:
        self._changes = tuple(
            Change(n, present.values.get(n, Value(n, float("nan"), v.type, _ABSENT)), v)
            for n, v in changes.values.items()
        )
        self._changed_files = tuple(changes.files)
        self._talk.difference(self._changes)
        for path, data in changes.files.items():
            self._talk.say(f"{path}: {_what(present.files.get(path))} on board, {_what(data)} new")

    def _save(self, board: Snapshot, present: Content, interrupted: Entry | None) -> None:
        files = {**self._board.others(board, present.files), **present.files}
        if interrupted:  # a backup of half a table would be no way back
            whole = self._board.keepable(interrupted.old, board)
            board = Snapshot({**board.values, **whole.values}, board.hash)
            files |= whole.files
        path = self._board.write_backup(self._backup_folder, board, files)
        self._backup = str(path)
        count = sum(data is not None for data in files.values())
        also = f" and {count} files" if count else ""
        self._talk.say(f"backup of {len(board.values)} parameters{also}: {path}")

    def _write(self, target: Content, new: Content, old: Content, present: Content, restart: bool) -> Outcome:
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        # a fault of the disk ends it here: nothing was written yet
        self._journal.begin(Entry(self._journal.board, old, new, self._backup, self._files, started))
        try:
            self._board.put(new, present, self._refuse_armed, settle_s=_CALM_S, restart=restart)
        except CoaxlinkError as error:
            return self._roll_back(old, error)
        except BaseException:
            self._roll_back(old, CheckFailed("interrupted"))
            raise
        self._keep(target)
        return self._outcome(VERIFIED)

    def _keep(self, target: Content) -> None:
        """The board holds the new table whole: end the journal, remember the table for `verify`."""
        self._journal.end()
        crcs = {path: None if data is None else file_crc(data) for path, data in target.files.items()}
        try:
            self._journal.record(self._files, target.values, self._board.parameters.read_hash(), crcs)
        except CoaxlinkError as error:
            self._talk.say(f"the table is on board and verified, but cannot be remembered: {error}")

    def _roll_back(self, old: Content, error: CoaxlinkError) -> Outcome:
        mismatches = error.wrong if isinstance(error, Mismatch) else ()
        self._talk.say(f"{error}; putting the old table back")
        end, last = time.monotonic() + self._patience_s, error
        while True:
            try:
                settle_s = _SETTLE_S if self._session.loss > _LOSSY else 2 * _CALM_S
                self._board.put(old, Content(), lambda: None, settle_s=settle_s)
            except CoaxlinkError as again:
                last = again
            else:
                self._journal.end()
                text = f"rolled back, the vehicle holds its old table: {error}"
                cause = Unfinished(text, error.exit_code)
                return self._outcome(ROLLED_BACK, error=cause, mismatches=mismatches)
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
            raise SafetyRefusal(f"the vehicle is armed: disarm it first, {self._board.acts}")

    def _outcome(
        self,
        result: str,
        *,
        error: CoaxlinkError | None = None,
        mismatches: tuple[dict[str, object], ...] = (),
        reason: str = "",
    ) -> Outcome:
        identity = self._session.identity
        return Outcome(
            result,
            self._changes,
            self._files,
            self._backup,
            mismatches,
            self._board.parameters.retries + self._board.files.retries,
            reason or (str(error) if error else ""),
            f"{identity.name}, board {identity.uid or 'unknown'}",
            error,
            self._changed_files,
        )


def _what(data: bytes | None) -> str:
    return "nothing" if data is None else f"{len(data)} bytes, crc {file_crc(data):08x}"
