"""Put an ArduPilot table on board: scripts and parameters, all or nothing, in the order of `upload`.

Scripts go first, then parameters, then a reboot where one is needed (a new script, another frame class), then
the loader's own parameters, which exist only once its script runs. Until the loader's checksum parameter
agrees, the old table flies; a script that does not fit its checksum keeps the vehicle from arming.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from coaxlink.errors import CheckFailed, CoaxlinkError, InputError, SafetyRefusal
from coaxlink.files import write_atomic
from coaxlink.link.ap_scripts import Scripts, plan_scripts, script_folder
from coaxlink.link.backup import ApBackup, backup_path
from coaxlink.link.ftp import Files
from coaxlink.link.journal import Entry, Journal
from coaxlink.link.parameters import FLOAT, Parameters, Snapshot, Value
from coaxlink.link.plan import Plan, motor_outputs, refuse_values, refuse_vehicle
from coaxlink.link.reboot import reboot
from coaxlink.link.session import Session
from coaxlink.link.upload import (
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
from firmware_params import ardupilot
from firmware_params.ardupilot import packed, scripts
from firmware_params.errors import TableError

_LIVE = scripts.PREFIX  # names that begin so are the loader's own
_SUM = f"{scripts.PREFIX}SUM"
_REBOOT = ("FRAME_CLASS", "SCR_ENABLE")
_ROUNDS = 3


class ApUploader:
    """One upload or restore of an ArduPilot table. Every public call ends in an Outcome."""

    def __init__(
        self,
        session: Session,
        *,
        backup_folder: Path,
        talk: Talk | None = None,
        journal: Journal | None = None,
        patience_s: float = 60.0,
        reboot_s: float = 5.0,
        script_s: float = 15.0,
    ) -> None:
        self._session = session
        self._parameters, self._board_files = Parameters(session), Files(session)
        self._talk = talk or Talk()
        self._backup_folder = backup_folder
        self._journal = journal or Journal(session.identity)
        self._patience_s = patience_s
        self._reboot_s, self._script_s = (
            reboot_s,
            script_s,
        )  # until it goes, until a script's parameters appear
        self._files: tuple[str, ...] = ()
        self._changes: tuple[Change, ...] = ()
        self._script_changes: tuple[str, ...] = ()
        self._backup = ""

    def upload(self, plan: Plan, *, dry_run: bool = False) -> Outcome:
        """Put a plan on board."""
        self._files = tuple(map(str, plan.files))
        return self._alone(lambda: self._upload(plan, dry_run))

    def restore(self, backup: ApBackup, *, dry_run: bool = False) -> Outcome:
        """Put a backup back; only on the board it was taken from."""
        self._files = (str(backup.path),)
        return self._alone(lambda: self._restore(backup, dry_run))

    def _alone(self, work: Callable[[], Outcome]) -> Outcome:
        try:
            with self._journal.alone():
                return work()
        except CoaxlinkError as error:
            return self._outcome(REFUSED if isinstance(error, SafetyRefusal) else FAILED, error=error)

    def _upload(self, plan: Plan, dry_run: bool) -> Outcome:
        try:
            self._refuse_armed()
            refuse_values(plan)
            refuse_vehicle(plan, self._session.identity)
            board = self._snapshot()
            _refuse_table(plan, board)
            folder = script_folder(self._board_files)
            old_scripts, new_scripts, checksum = plan_scripts(self._board_files, folder, dict(plan.scripts))
            params = dict(plan.params)
            if "SCR_LD_CHECKSUM" in params:  # other scripts in the folder count as well
                params["SCR_LD_CHECKSUM"] = float(checksum)
            interrupted = self._journal.open_entry()
            if interrupted:
                self._talk.say(
                    f"an upload of {interrupted.started} did not end: its old table is the way back"
                )
            old, new = self._values(params, board)
            return self._carry_out(old, new, old_scripts, new_scripts, board, interrupted, dry_run)
        except CoaxlinkError as error:
            return self._outcome(REFUSED if isinstance(error, SafetyRefusal) else FAILED, error=error)

    def _restore(self, backup: ApBackup, dry_run: bool) -> Outcome:
        try:
            self._refuse_armed()
            here = self._session.identity.uid or "unknown"
            if backup.board != here:
                raise SafetyRefusal(f"{backup.path.name} is of board {backup.board}, this is {here}")
            board = self._snapshot()
            folder = script_folder(self._board_files)
            old_scripts, new_scripts, _ = plan_scripts(self._board_files, folder, dict(backup.scripts))
            known = {n: v for n, v in backup.params.items() if n in board.values or n.startswith(_LIVE)}
            known = {n: v for n, v in known.items() if math.isfinite(v)}
            if not backup.scripts:  # the loader's parameters live and die with its script
                known = {n: v for n, v in known.items() if not n.startswith(_LIVE)}
            old, new = self._values(known, board)
            interrupted = self._journal.open_entry()
            return self._carry_out(old, new, old_scripts, new_scripts, board, interrupted, dry_run)
        except CoaxlinkError as error:
            return self._outcome(REFUSED if isinstance(error, SafetyRefusal) else FAILED, error=error)

    # -- the order of things -------------------------------------------------------------------------------

    def _carry_out(
        self,
        old: Mapping[str, Value],
        new: Mapping[str, Value],
        old_scripts: Scripts,
        new_scripts: Scripts,
        board: Snapshot,
        interrupted: Entry | None,
        dry_run: bool,
    ) -> Outcome:
        changed = [n for n, v in new.items() if n not in old or not v.same(old[n])]
        self._changes = tuple(
            Change(n, old.get(n, Value(n, float("nan"), FLOAT, b"")), new[n]) for n in changed
        )
        self._script_changes = tuple(p for p in new_scripts if new_scripts[p] != old_scripts.get(p))
        self._talk.difference(self._changes)
        for path in self._script_changes:
            self._talk.say(f"{path}: {_what(old_scripts.get(path))} on board, {_what(new_scripts[path])} new")
        if dry_run:
            return self._outcome("dry_run")
        if not self._changes and not self._script_changes:
            self._keep(new, new_scripts)
            return self._outcome(VERIFIED, reason="the board holds it already")
        self._save(board, old_scripts)
        if not self._talk.confirm():
            raise SafetyRefusal("not confirmed; nothing was changed")
        self._refuse_armed()
        if interrupted:
            old = {**old, **interrupted.old}
            old_scripts = {**old_scripts, **interrupted.old_scripts}
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        entry = Entry(
            self._journal.board, old, new, self._backup, self._files, started, old_scripts, new_scripts
        )
        try:
            self._journal.begin(entry)
        except CoaxlinkError as error:  # nothing was written yet
            return self._outcome(FAILED, error=error)
        try:
            self._put(new, new_scripts, watch_arming=True)
        except CoaxlinkError as error:
            return self._roll_back(old, old_scripts, error)
        except BaseException:
            self._roll_back(old, old_scripts, CheckFailed("interrupted"))
            raise
        self._keep(new, new_scripts)
        return self._outcome(VERIFIED)

    def _put(self, values: Mapping[str, Value], texts: Scripts, *, watch_arming: bool) -> None:
        """Scripts, parameters, reboot, the loader's parameters; then read everything back."""
        guard = self._refuse_armed if watch_arming else _nothing
        reboot = False
        for path, data in texts.items():
            guard()
            reboot |= self._put_script(path, data)
        fixed = {n: v for n, v in values.items() if not n.startswith(_LIVE)}
        live = {n: v for n, v in values.items() if n.startswith(_LIVE)}
        for _ in range(_ROUNDS):
            found = self._parameters.read_many(fixed, missing_ok=True)
            todo = [v for n, v in fixed.items() if n not in found or not v.same(found[n])]
            if not todo:
                break
            reboot |= any(v.name in _REBOOT for v in todo)
            self._parameters.write_many(todo, before_each=guard)
            self._settle()
        guard()
        if reboot:
            self._reboot()
        if live:
            self._put_live(live, guard)
        wrong = self._wrong(values, texts)
        if wrong:
            raise Mismatch(wrong)
        guard()

    def _put_live(self, live: Mapping[str, Value], guard: Any) -> None:
        """The loader's parameters, its checksum last: it takes the table when that agrees."""
        end = time.monotonic() + self._script_s
        while not self._parameters.read_many([_SUM], missing_ok=True):
            if time.monotonic() > end:
                raise CheckFailed(
                    f"{_SUM} does not appear: the loader script does not run (see the vehicle's messages)"
                )
            time.sleep(0.5)
        guard()
        if self._put_packed(live):
            return
        numbers = [v for n, v in live.items() if n != _SUM]
        for group in (numbers, [v for n, v in live.items() if n == _SUM]):
            if group:
                self._parameters.write_many(group, before_each=guard)
                self._settle()

    def _put_packed(self, live: Mapping[str, Value]) -> bool:
        """The whole table in one small file; False where the board does not take such a file."""
        try:
            data = packed.pack({n: (float(v.value), v.type) for n, v in live.items()})
            self._board_files.write_plain(packed.PATH, data)
        except CheckFailed as error:
            self._talk.say(f"packed parameters are not taken ({error}); writing them one by one")
            return False
        self._settle()
        found = self._parameters.read_many(live)
        return all(found[n].same(v) for n, v in live.items())

    def _put_script(self, path: str, data: bytes | None) -> bool:
        """Write or remove a script; True when that changed the board."""
        if data is None:
            return self._board_files.remove(path)
        if self._board_files.crc(path) == scripts.file_crc(data):
            return False
        self._board_files.write(path, data)
        return True

    def _wrong(self, values: Mapping[str, Value], texts: Scripts) -> list[dict[str, Any]]:
        found = self._parameters.read_many(values, missing_ok=True)
        wrong: list[dict[str, Any]] = [
            {"name": n, "wanted": v.value, "found": found[n].value if n in found else None}
            for n, v in values.items()
            if n not in found or not v.same(found[n])
        ]
        for path, data in texts.items():
            crc = self._board_files.crc(path)
            wanted = None if data is None else scripts.file_crc(data)
            if crc != wanted:
                wrong.append({"name": path, "wanted": wanted, "found": crc})
        return wrong

    def _roll_back(self, old: Mapping[str, Value], texts: Scripts, error: CoaxlinkError) -> Outcome:
        mismatches = tuple(error.wrong) if isinstance(error, Mismatch) else ()
        self._talk.say(f"{error}; putting the old table back")
        end, last = time.monotonic() + self._patience_s, error
        while True:
            try:
                self._put(old, texts, watch_arming=False)
            except CoaxlinkError as again:
                last = again
            else:
                self._journal.end()
                text = f"rolled back, the vehicle holds its old table: {error}"
                cause = Unfinished(text, error.exit_code)
                return self._outcome(ROLLED_BACK, error=cause, mismatches=mismatches)
            if time.monotonic() > end:
                break
            time.sleep(0.5)
        text = (
            f"{error}; the old table could not be put back ({last}). Do not fly, the board may hold both. "
            f"When the link is back: coaxlink restore {self._backup} --connect {self._session.address}"
        )
        return self._outcome(FAILED, error=Unfinished(text, error.exit_code), mismatches=mismatches)

    def _snapshot(self) -> Snapshot:
        """Every parameter: the packed file where the board has it, else the list."""
        try:
            data = self._board_files.read(packed.PATH)
            if data:
                found = packed.unpack(data)
                return Snapshot({n: self._parameters.encode(n, v, kind) for n, (v, kind) in found.items()})
        except (TableError, CheckFailed, InputError) as error:
            self._talk.say(f"no packed parameters ({error}); reading them one by one")
        return self._parameters.read_all(progress=self._talk.progress)

    # -- parts ---------------------------------------------------------------------------------------------

    def _values(
        self, params: Mapping[str, float | int], board: Snapshot
    ) -> tuple[dict[str, Value], dict[str, Value]]:
        """(on board now, to be) as the board stores them. Raises SafetyRefusal for an unknown name."""
        old, new = {}, {}
        for name, value in params.items():
            there = board.values.get(name)
            if there is None and not name.startswith(_LIVE):
                raise SafetyRefusal(f"{self._session.identity.name} has no parameter {name}")
            kind = there.type if there else FLOAT
            kept = ardupilot.as_stored(name, float(value), kind)
            new[name] = self._parameters.encode(name, kept, kind)
            if there:
                old[name] = there
        return old, new

    def _save(self, board: Snapshot, old_scripts: Scripts) -> None:
        identity = self._session.identity
        path = backup_path(self._backup_folder, identity).with_suffix(".param")
        header = [
            "coaxlink backup",
            f"Board: {identity.uid or 'unknown'}",
            f"Firmware: {identity.name}",
            f"Git: {identity.git_hash or 'unknown'}",
            f"Time: {time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}",
            f"Count: {len(board.values)}",
        ]
        for place, data in old_scripts.items():
            if data is not None:
                write_atomic(path.with_suffix(".scripts") / Path(place).name, data)
        try:
            ardupilot.write_param_file(path, {n: float(v.value) for n, v in board.values.items()}, header)
        except OSError as error:
            raise InputError(path, "", f"the backup cannot be written ({error.strerror})") from error
        self._backup = str(path)
        self._talk.say(f"backup of {len(board.values)} parameters and the scripts: {path}")

    def _reboot(self) -> None:
        self._talk.say("rebooting")
        reboot(self._session, self._reboot_s)

    def _keep(self, new: Mapping[str, Value], texts: Scripts) -> None:
        self._journal.end()
        crcs = {path: None if data is None else scripts.file_crc(data) for path, data in texts.items()}
        try:
            self._journal.record(self._files, new, 0, crcs)
        except CoaxlinkError as error:
            self._talk.say(f"the table is on board and verified, but cannot be remembered: {error}")

    def _settle(self) -> None:
        time.sleep(1.0 if self._session.loss > 0.005 else 0.1)

    def _refuse_armed(self) -> None:
        if self._session.armed:
            raise SafetyRefusal("the vehicle is armed: disarm it first")

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
            self._parameters.retries + self._board_files.retries,
            reason or (str(error) if error else ""),
            f"{self._session.identity.name}, board {self._session.identity.uid or 'unknown'}",
            error,
            self._script_changes,
        )


def _refuse_table(plan: Plan, board: Snapshot) -> None:
    now = motor_outputs({n: v.value for n, v in board.values.items()})
    wanted = plan.rotor_count
    if wanted and now not in (0, wanted):
        raise SafetyRefusal(f"another vehicle: the table is for {wanted} motors, the board drives {now}")


def _what(data: bytes | None) -> str:
    return "nothing" if data is None else f"{len(data)} bytes, crc {scripts.file_crc(data):08x}"


def _nothing() -> None:
    return None
