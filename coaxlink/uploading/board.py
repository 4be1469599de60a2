"""A vehicle's parameters and files as an upload needs them: read, written, read back.

What each firmware does in its own way is in `board_px4` and `board_ardupilot`; the order of an upload is in
`upload`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from coaxlink.errors import SafetyRefusal
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Parameters, Snapshot, Value
from coaxlink.mavlink.reboot import reboot
from coaxlink.mavlink.session import Session
from coaxlink.uploading.backup import Backup, Note
from coaxlink.uploading.content import BoardFiles, Content
from coaxlink.uploading.limits import Limits
from coaxlink.uploading.outcome import Mismatch, Talk, mismatch
from coaxlink.uploading.plan import Plan
from coaxlink.uploading.restore_choice import Choice
from firmware_params.ardupilot.scripts import file_crc

LOSSY = 0.005  # of the messages: a line that loses more is given longer
WRITES = 3  # write, read back, and mend what another writer or a late packet changed
Guard = Callable[[], None]  # raises when the write must stop


class Board(ABC):
    """One vehicle during an upload."""

    reboots: frozenset[str] = frozenset()  # parameters that act only after a restart
    acts = "a table acts at once"
    stands = "it flies what stands there"  # reported when arming ended a write
    holds: frozenset[str] = frozenset()  # names that a mixer table may write on this firmware

    def __init__(
        self, session: Session, *, talk: Talk, parameters: Parameters | None = None, reboot_s: float = 5.0
    ) -> None:
        self.session, self._talk = session, talk
        self.parameters = parameters or Parameters(session)
        self.files = Files(session)
        self.optional: frozenset[str] = (
            frozenset()
        )  # names that the board may refuse without undoing the rest
        self.passed_over: dict[str, str] = {}  # of these, how it refused
        self._reboot_s = reboot_s

    # -- what is there, what is to be ----------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """Every parameter."""
        return self.parameters.read_all(progress=self._talk.progress)

    def with_hidden(self, snapshot: Snapshot, names: Iterable[str]) -> Snapshot:
        """Some parameters are left out of the list and yet answer to their name (ArduPilot's SCR_* while
        scripting is off, PX4's unused ones)."""
        missing = [name for name in names if name not in snapshot.values]
        if not missing:
            return snapshot
        found = self.parameters.read_many(missing, missing_ok=True)
        return Snapshot({**snapshot.values, **found}, snapshot.hash)

    @abstractmethod
    def planned(
        self,
        plan: Plan,
        snapshot: Snapshot,
        *,
        new_geometry: bool,
        spin_from_table: bool = False,
        take_over: bool = False,
    ) -> Content:
        """What a plan wants, as this board stores it. Raises SafetyRefusal when it is for another."""

    @abstractmethod
    def saved(self, backup: Backup, snapshot: Snapshot, choice: Choice) -> Content:
        """What the chosen part of a backup of this board wants."""

    def metadata(self) -> Mapping[str, Limits] | None:
        """What the board itself says of its parameters, None when it serves nothing."""
        return None

    def loads(self, name: str) -> bool:
        """Whether a parameter comes and goes with a table's file."""
        return False

    def present(self, content: Content, snapshot: Snapshot) -> Content:
        """What the board has now under the names of `content`."""
        values = {n: snapshot.values[n] for n in content.values if n in snapshot.values}
        return Content(values, {path: self._read_file(path, data) for path, data in content.files.items()})

    def completed(self, content: Content, snapshot: Snapshot) -> Content:
        """`content` with what follows from the whole of it."""
        return content

    def keepable(self, content: Content, snapshot: Snapshot) -> Content:
        """The part of an interrupted upload's content that this board can take."""
        return Content({n: v for n, v in content.values.items() if n in snapshot.values}, content.files)

    def restarts(self, content: Content) -> bool:
        """Whether this board only flies `content` after a restart."""
        return bool(content.files) or bool(self.reboots & set(content.values))

    def others(self, snapshot: Snapshot, known: BoardFiles) -> BoardFiles:
        """Files that belong into a backup besides those that are known."""
        return {}

    @abstractmethod
    def write_backup(self, folder: Path, snapshot: Snapshot, files: BoardFiles, note: Note) -> Path:
        """Write a complete backup; its path. Raises InputError."""

    # -- writing -------------------------------------------------------------------------------------------

    def put(
        self, content: Content, known: Content, guard: Guard, *, settle_s: float, restart: bool = False
    ) -> None:
        """Write files, then parameters; restart if needed (or `restart`); read back.

        `known` is what the board is sure to hold. Raises Mismatch on another value, CheckFailed, LinkError,
        and what `guard` raises: from then on nothing more is written.
        """
        with self.files.guarded(guard):
            self._put(content, known, guard, settle_s, restart)

    def _put(self, content: Content, known: Content, guard: Guard, settle_s: float, restart: bool) -> None:
        rewritten = False
        for path, data in content.files.items():
            guard()
            rewritten |= self._put_file(path, data)
        now, later = self._in_order(content)
        written = self._put_values(now, known.values, guard, settle_s)
        restart |= rewritten or bool(self.reboots & written)
        if restart:
            guard()
            self._talk.say("rebooting")
            self.restarting()
            reboot(self.session, self._reboot_s)
            self.parameters.forget_list()
        if later:
            self._put_later(later, guard, settle_s)
        if restart or later:
            wrong = self.wrong(content)
            if wrong:
                raise Mismatch(wrong)
        guard()

    def restarting(self) -> None:
        """Called just before the board is restarted."""
        return

    def refuse_unflown(self, plan: Plan) -> None:
        """Where a board says so itself: whether it flies what it holds. Raises CheckFailed, LinkError."""
        return

    def wrong(self, content: Content) -> list[dict[str, Any]]:
        """What the board has otherwise, read anew."""
        now, later = self._in_order(content)
        values = {**now, **later}
        found = self.parameters.read_many(values, missing_ok=True)
        self._pass_over_missed(self._missed(values, found), found)
        rows = [mismatch(v, found.get(v.name)) for v in self._missed(values, found)]
        for path, data in content.files.items():
            crc, wanted = self.files.crc(path), None if data is None else file_crc(data)
            if crc != wanted:
                rows.append({"name": path, "wanted": wanted, "found": crc})
        return rows

    def _in_order(self, content: Content) -> tuple[Mapping[str, Value], Mapping[str, Value]]:
        """(parameters to write first, those that can only be written after a restart)."""
        return content.values, {}

    @abstractmethod
    def _make_last(self) -> None:
        """See that what was written survives a power cut. Raises LinkError."""

    def _put_later(self, values: Mapping[str, Value], guard: Guard, settle_s: float) -> None:
        raise NotImplementedError

    def _put_values(
        self, values: Mapping[str, Value], known: Mapping[str, Value], guard: Guard, settle_s: float
    ) -> set[str]:
        """Write, read back, mend; the names written. Raises Mismatch."""
        if not values:
            return set()
        written: set[str] = set()
        found = dict(known)
        if not found:  # nothing is sure: see first what there is to do
            found = self.parameters.read_many(values, missing_ok=True)
        for round_ in range(WRITES):
            todo = self._missed(values, found)
            if round_ and todo:
                self.parameters.again += len(todo)
                self._talk.say(f"{todo[0].name} changed under way; writing it again")
            guard()
            with self.session.listen(("PARAM_VALUE",), lambda m: m.param_id in values) as echoes:
                self.parameters.write_many(todo, before_each=guard, refused=self._pass_over)
                written |= {v.name for v in todo}
                guard()
                self._make_last()  # before reading: a board that lost its power in between says the old
                self.session.clock.sleep(settle_s)
                found = self.parameters.read_many(values, missing_ok=True)
                while (echo := self.session.take(echoes, 0.0)) is not None:
                    found[echo.param_id] = self.parameters.decode(echo)  # the last word, whoever set it
            guard()
            missed = self._missed(values, found)
            if not missed:
                return written
        self._pass_over_missed(missed, found)
        if missed := self._missed(values, found):
            raise Mismatch([mismatch(v, found.get(v.name)) for v in missed])
        return written

    def _missed(self, values: Mapping[str, Value], found: Mapping[str, Value]) -> list[Value]:
        """Those that `found` lacks or has otherwise, but for what the board may refuse and did."""
        return [
            v
            for n, v in values.items()
            if n not in self.passed_over and (n not in found or not v.same(found[n]))
        ]

    def _pass_over_missed(self, missed: list[Value], found: Mapping[str, Value]) -> None:
        for value in missed:  # the board has its own word on it
            held = found.get(value.name)
            self._pass_over(value.name, f"keeps {held.value:.7g}" if held else "not there")

    def _pass_over(self, name: str, how: str) -> bool:
        """Whether the board may refuse this one; noted then."""
        if name not in self.optional:
            return False
        self._talk.say(f"{name}: the board refused it ({how}); passed over")
        self.passed_over[name] = how
        return True

    def _read_file(self, path: str, wanted: bytes | None) -> bytes | None:
        """A file; one that is as wanted already is not read, its checksum tells."""
        if wanted is not None and self.files.crc(path) == file_crc(wanted):
            return wanted
        return self.files.read(path)

    def _put_file(self, path: str, data: bytes | None) -> bool:
        """Write or remove a file; True when that changed the board."""
        if data is None:
            return self.files.remove(path)
        if self.files.crc(path) == file_crc(data):
            return False
        self.files.write(path, data)
        return True

    # -- parts ---------------------------------------------------------------------------------------------

    def _stored(
        self, params: Mapping[str, float], types: Mapping[str, int], snapshot: Snapshot, *, known_only: bool
    ) -> dict[str, Value]:
        """Values as they are to be written; with `known_only`, what is not on board stays out."""
        values = {}
        for name, value in params.items():
            there = snapshot.values.get(name)
            if there is None and known_only:
                self._talk.say(f"{name} is not on this board and stays out")
                continue
            if known_only and not math.isfinite(value):
                continue  # a NaN in a backup is how that board has it; none is ever sent
            kind = types.get(name, there.type if there else None)
            if there is None or there.type != kind:
                found = f"type {there.type}" if there else "nothing"
                raise SafetyRefusal(f"{name}: type {kind} is to be written, the board has {found}")
            values[name] = self.parameters.encode(name, value, kind)
        return values
