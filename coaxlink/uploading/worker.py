"""Put a table on board, all or nothing: difference, backup, write, read back, compare; back again on failure.

The order never changes and is the same for every firmware; what is a firmware's own is in its `Board`.
From the first write on, a journal on disk knows the old content and the new; it goes away when the board was
read back and holds one of the two whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from coaxlink.errors import CheckFailed, CoaxlinkError, LinkError, SafetyRefusal
from coaxlink.mavlink.confirm import confirm
from coaxlink.mavlink.parameters import Parameters, Snapshot, Value
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.strangers import TWO_BEATS_S
from coaxlink.uploading.backup import Backup, Note
from coaxlink.uploading.board import LOSSY, Board
from coaxlink.uploading.board_ardupilot import ArduPilotBoard
from coaxlink.uploading.board_px4 import Px4Board
from coaxlink.uploading.content import Content
from coaxlink.uploading.interrupted import what_stands
from coaxlink.uploading.journal import Entry, Journal
from coaxlink.uploading.outcome import (
    DRY_RUN,
    FAILED,
    INCOMPLETE,
    REFUSED,
    ROLLED_BACK,
    VERIFIED,
    Armed,
    Change,
    Mismatch,
    Outcome,
    Talk,
    Unfinished,
)
from coaxlink.uploading.owned import Ownership, learned_since
from coaxlink.uploading.plan import Plan, refuse_values, refuse_vehicle
from coaxlink.uploading.restore_choice import Choice, choose, differing
from firmware_params.ardupilot.scripts import file_crc

_ABSENT = b""  # bits of a parameter that the board does not have yet
_CALM_S, _SETTLE_S = 0.05, 1.0  # before reading back; after a failure other words may still be under way


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
        self._journal = journal or Journal(session.identity, address=session.address)
        self._patience_s = patience_s
        self._files: tuple[str, ...] = ()
        self._changes: tuple[Change, ...] = ()
        self._changed_files: tuple[str, ...] = ()
        self._learned: tuple[Change, ...] = ()
        self._left_out: dict[str, str] = {}
        self._backup = ""

    def upload(
        self,
        plan: Plan,
        *,
        dry_run: bool = False,
        new_geometry: bool = False,
        reboot: bool = False,
        spin_from_table: bool = False,
        take_over: bool = False,
    ) -> Outcome:
        """Put a plan on board; with `reboot`, restart the autopilot in any case and read the table again.

        What the owner of the board tuned stays (`owners_numbers`); `spin_from_table` takes the plan's. With
        `take_over` an ArduPilot owner's own matrix script makes way; the backup puts it back.
        """
        self._files = tuple(str(path) for path in plan.files)

        def first() -> None:
            refuse_values(plan.firmware, plan.params, plan.files[0])
            refuse_vehicle(plan, self._session.identity)

        def wanted(board: Snapshot) -> Content:
            return self._board.planned(
                plan,
                board,
                new_geometry=new_geometry,
                spin_from_table=spin_from_table,
                take_over=take_over,
            )

        def proved() -> None:
            self._board.refuse_unflown(plan)

        return self._ended(lambda: self._carry_out(first, plan.params, wanted, dry_run, reboot, proved))

    def restore(self, backup: Backup, *, dry_run: bool = False, everything: bool = False) -> Outcome:
        """Put back what the upload after a backup wrote, only on the board it was taken from.

        With `everything` also all else that is not the board's own, passing over what it refuses of that.
        """
        self._files = (str(backup.path),)

        def first() -> None:
            here = self._session.identity.uid or "unknown"
            firmware = "px4" if self._session.identity.is_px4 else "ardupilot"
            if backup.board and backup.board != here:
                raise SafetyRefusal(f"{backup.path.name} is of board {backup.board}, this is {here}")
            if not backup.board and backup.firmware != firmware:
                name = self._session.identity.name
                raise SafetyRefusal(f"{backup.path.name} is of {backup.firmware}, the vehicle runs {name}")
            if not backup.board:
                name = backup.path.name
                self._talk.say(f"{name} does not say of which board it is: see that it is this one's")
            if not backup.proved:  # a board may hold what no table should; a hand must not add to it
                refuse_values(firmware, backup.params, backup.path)

        def wanted(board: Snapshot) -> Content:
            return self._board.saved(backup, board, self._chosen(backup, board, everything))

        named = backup.note.names if backup.note else ()
        return self._ended(lambda: self._carry_out(first, named, wanted, dry_run, False, None))

    def backup(self) -> Path:
        """Save every parameter and file of the board; where. Raises SafetyRefusal while armed, LinkError."""
        self._refuse_armed()
        board = self._board.snapshot()
        files = self._board.others(board, {})
        return self._board.write_backup(self._backup_folder, board, files, Note())

    def _chosen(self, backup: Backup, board: Snapshot, everything: bool) -> Choice:
        identity = self._session.identity
        owner = Ownership(identity, board.values, self._board.metadata() if everything else None)
        choice = choose(
            backup,
            touched=self._journal.touched(),
            holds=self._board.holds,
            loads=self._board.loads,
            kind=owner.kind if everything else None,
        )
        if not choice.noted:
            self._talk.say("this backup does not say what was uploaded after it: all that a table can hold")
        others = [n for n in differing(backup, board) if not choice.takes(n)]
        self._left_out = {n: choice.left_out[n] for n in others if n in choice.left_out}
        if self._left_out:
            names = ", ".join(f"{n} ({why})" for n, why in self._left_out.items())
            self._talk.say(f"left as they are, the board's own: {names}")
        elif others:
            self._talk.say(f"{len(others)} other parameters differ from the backup and stay (`everything`)")
        self._board.optional = choice.rest
        return choice

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
        proved: Callable[[], None] | None,
    ) -> Outcome:
        complete = proved is not None  # a whole table: it is proved value by value, and that it flies
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
            self._board.optional |= set(interrupted.optional)
        if complete:
            target = self._board.completed(target, board)
        requested = target
        present = self._board.present(target, board)
        changes = target.differs_from(present)
        if not interrupted and (learned := learned_since(changes, board, self._session.identity)):
            self._learned = _rows(changes, present)
            target, changes = target.without(learned), changes.without(learned)
        self._talk.present({n: v.value for n, v in board.values.items()}, present.files)
        self._show(changes, present, board)
        if dry_run:
            return self._outcome(DRY_RUN)
        if interrupted and self._board.restarts(interrupted.new):
            restart = True  # the files may be there and the restart that makes them fly not
        if not changes.values and not changes.files and not restart:
            confirm(self._session)
            if proved:
                proved()
            self._keep(requested)
            return self._outcome(VERIFIED, reason="the board holds it already")
        self._save(board, present, interrupted, requested)
        if not self._talk.confirm():
            raise SafetyRefusal("not confirmed; nothing was changed")
        confirm(self._session)
        self._session.refuse_several(TWO_BEATS_S)
        self._refuse_armed()
        # others may change what an upload leaves: its whole table is proved; a backup is too long for that
        new, old = (target, present) if complete else (changes, present.only(changes))
        if interrupted:  # the way back leads to the last whole table, not to what the interruption left
            old = interrupted.old.over(old)
            new = new.over(target.only(interrupted.old))
        return self._write(requested, new, old, present, restart, proved)

    def _interrupted(self) -> Entry | None:
        entry = self._journal.open_entry()
        if entry:
            self._talk.say(
                f"the upload of {entry.started} to this board did not end; its old table is the way back"
            )
        return entry

    def _show(self, changes: Content, present: Content, board: Snapshot) -> None:
        self._changes = _rows(changes, present)
        self._changed_files = tuple(changes.files)
        self._talk.difference(self._changes)
        for path, data in changes.files.items():
            self._talk.say(f"{path}: {_what(present.files.get(path))} on board, {_what(data)} new")
        for row in self._learned:
            self._talk.say(
                f"{row.name}: {row.old.value:.4g}, learned in flight from {row.new.value:.4g}; it stays"
            )
        wrote = self._journal.written()
        owner = Ownership(self._session.identity, board.values)
        for row in self._changes:
            was = wrote.get(row.name)
            if was and row.old.bits and not was.same(row.old) and owner.learned(row.name):
                self._talk.say(
                    f"{row.name}: the board learned {row.old.value:.4g} since {was.value:.4g} was written; "
                    f"{row.new.value:.4g} takes its place"
                )

    def _save(self, board: Snapshot, present: Content, interrupted: Entry | None, requested: Content) -> None:
        files = {**self._board.others(board, present.files), **present.files}
        if interrupted:  # a backup of half a table would be no way back
            lasting = self._board.keepable(interrupted.old, board)
            board = Snapshot({**board.values, **lasting.values}, board.hash)
            files |= lasting.files
        names = frozenset(n for n in requested.values if n not in self._board.optional)
        note = Note(names, frozenset(Path(p).name for p in requested.files))
        path = self._board.write_backup(self._backup_folder, board, files, note)
        self._backup = str(path)
        count = sum(data is not None for data in files.values())
        also = f" and {count} files" if count else ""
        self._talk.say(f"backup of {len(board.values)} parameters{also}: {path}")

    def _write(
        self,
        target: Content,
        new: Content,
        old: Content,
        present: Content,
        restart: bool,
        proved: Callable[[], None] | None,
    ) -> Outcome:
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        # a fault of the disk ends it here: nothing was written yet
        optional = tuple(sorted(self._board.optional & set(new.values)))
        self._journal.begin(
            Entry(self._journal.board, old, new, self._backup, self._files, started, optional)
        )
        try:
            self._board.put(new, present, self._refuse_unsafe, settle_s=_CALM_S, restart=restart)
            if proved:
                proved()
            confirm(self._session)
        except Armed:
            return self._stopped(old, new)
        except CoaxlinkError as error:
            return self._roll_back(old, new, error)
        except BaseException:
            self._roll_back(old, new, CheckFailed("interrupted"))
            raise
        self._keep(target)
        refused = self._board.passed_over
        if refused:
            names = ", ".join(f"{n} ({how})" for n, how in refused.items())
            text = f"put back, but for {len(refused)} that the board refused: {names}"
            return self._outcome(INCOMPLETE, error=CheckFailed(text))
        return self._outcome(VERIFIED)

    def _stopped(self, old: Content, new: Content) -> Outcome:
        """The vehicle is armed: nothing more is written, nor put back; the journal stays for later."""
        self._talk.say("the vehicle armed: nothing more is written; reading what stands")
        self._session.clock.sleep(_SETTLE_S)  # words that were under way
        stands = what_stands(self._board, old, new)
        if stands.untouched:
            self._journal.end()
            return self._outcome(REFUSED, error=Armed("the vehicle armed; the board holds its old table"))
        for line in stands.lines():
            self._talk.say(line)
        text = (
            f"the vehicle armed while it was written: nothing more was written, nothing put back. Of what "
            f"was to change the board holds {stands.counts()}; {self._board.stands}. Once disarmed, do the "
            f"same again, or `restore` {self._backup} over {self._session.address}"
        )
        return self._outcome(FAILED, error=Unfinished(text, Armed.exit_code), standing=stands.to_json())

    def _keep(self, target: Content) -> None:
        """The board holds the new table whole: end the journal, remember the table for `verify`."""
        self._journal.end()
        crcs = {path: None if data is None else file_crc(data) for path, data in target.files.items()}
        values = target.without(self._board.optional).values
        try:
            self._journal.record(self._files, values, self._board.parameters.read_hash(), crcs)
        except CoaxlinkError as error:
            self._talk.say(f"the table is on board and verified, but cannot be remembered: {error}")

    def _roll_back(self, old: Content, new: Content, error: CoaxlinkError) -> Outcome:
        mismatches = error.wrong if isinstance(error, Mismatch) else ()
        self._talk.say(f"{error}; putting the old table back")
        clock = self._session.clock
        end, last = clock.monotonic() + self._patience_s, error
        while True:
            try:
                confirm(self._session, alone=False)
                settle_s = _SETTLE_S if self._session.loss > LOSSY else 2 * _CALM_S
                self._board.put(old, Content(), self._refuse_armed, settle_s=settle_s)
                clock.sleep(TWO_BEATS_S)  # whoever wrote in between may go on with it
                if wrong := self._board.wrong(old):
                    raise Mismatch(wrong)
            except Armed:
                return self._stopped(old, new)
            except SafetyRefusal as again:  # another board is there now: it must not get the old table
                last = again
                break
            except CoaxlinkError as again:
                last = again
            else:
                self._journal.end()
                text = f"rolled back, the vehicle holds its old table: {error}{self._who_else(error)}"
                safe = isinstance(error, SafetyRefusal)  # a lost link was found again: the answer is no
                cause = Unfinished(text, error.exit_code if safe else CheckFailed.exit_code)
                return self._outcome(ROLLED_BACK, error=cause, mismatches=mismatches)
            if clock.monotonic() > end:
                break
            self._await_link(end)
        text = (
            f"{error}; the old table could not be put back ({last}{self._who_else(last)}). "
            "Do not fly, the board may hold both. "
            f"When the link is back: `restore` {self._backup} over {self._session.address}"
        )
        return self._outcome(FAILED, error=Unfinished(text, error.exit_code), mismatches=mismatches)

    def _who_else(self, error: CoaxlinkError) -> str:
        """Where a value is not what was written: who may have written it."""
        return f"; {self._session.autopilots.writers()}" if isinstance(error, Mismatch) else ""

    def _await_link(self, end: float) -> None:
        clock = self._session.clock
        while clock.monotonic() < end:
            try:
                if self._session.wait("HEARTBEAT", 1.0) is not None:
                    return
            except LinkError:  # the line itself is down; the session opens it again
                clock.sleep(0.5)

    # -- small ---------------------------------------------------------------------------------------------

    def _refuse_unsafe(self) -> None:
        self._refuse_armed()
        self._session.bound.refuse_others()

    def _refuse_armed(self) -> None:
        if self._session.armed:
            raise Armed(f"the vehicle is armed: disarm it first, {self._board.acts}")

    def _outcome(
        self,
        result: str,
        *,
        error: CoaxlinkError | None = None,
        mismatches: tuple[dict[str, object], ...] = (),
        reason: str = "",
        standing: Mapping[str, tuple[str, ...]] | None = None,
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
            f"{identity.name}, system {identity.system}, board {identity.uid or 'unknown'}",
            error,
            self._changed_files,
            self._learned,
            self._left_out,
            dict(self._board.passed_over),
            standing or {},
        )


def _rows(changes: Content, present: Content) -> tuple[Change, ...]:
    return tuple(
        Change(n, present.values.get(n, Value(n, float("nan"), v.type, _ABSENT)), v)
        for n, v in changes.values.items()
    )


def _what(data: bytes | None) -> str:
    return "nothing" if data is None else f"{len(data)} bytes, crc {file_crc(data):08x}"
