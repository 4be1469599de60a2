"""ArduPilot during an upload: scripts first, then parameters, then those of the loader.

A restart comes where one is needed (a new script, another frame class). The loader's own parameters exist
only once its script runs; until its checksum parameter agrees, the old table flies. A script that does not
fit its checksum keeps the vehicle from arming.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from coaxlink.errors import CheckFailed, InputError, SafetyRefusal
from coaxlink.mavlink.parameters import FLOAT, Snapshot, Value
from coaxlink.uploading.ardupilot_scripts import (
    OURS,
    SCRIPT_S,
    ScriptFolder,
    await_loader,
    is_table,
    matrix_script,
)
from coaxlink.uploading.ardupilot_table import moved_rotors, planned_table, present_table
from coaxlink.uploading.ardupilot_words import Words, foreign_matrix, matrix_scripts
from coaxlink.uploading.backup import Backup, Note, write_backup
from coaxlink.uploading.board import Board, Guard
from coaxlink.uploading.content import BoardFiles, Content
from coaxlink.uploading.owners_numbers import for_board
from coaxlink.uploading.plan import Plan, motor_outputs
from coaxlink.uploading.restore_choice import Choice
from firmware_params import ardupilot
from firmware_params.ardupilot import packed, scripts
from firmware_params.errors import TableError

_LIVE = scripts.PREFIX  # names that begin so are the loader's own
_SUM = f"{scripts.PREFIX}SUM"
_CHECKSUM = "SCR_LD_CHECKSUM"
_UNCHECKED = -1  # of SCR_LD_CHECKSUM: any script may run


class ArduPilotBoard(Board):
    """See the module."""

    reboots = frozenset(("FRAME_CLASS", "SCR_ENABLE"))
    stands = (
        "ArduCopter flies on with the frame it started with, its motor curve (MOT_*) and a loader's whole "
        "table act at once: land and disarm before anything else"
    )
    holds = frozenset(ardupilot.PARAMETERS)

    def __init__(self, *args: Any, script_s: float = SCRIPT_S, **options: Any) -> None:
        super().__init__(*args, **options)
        self._folder = ScriptFolder(self.files)
        self._script_s = script_s  # until a script's parameters appear
        self._words = Words(self.session)

    def snapshot(self) -> Snapshot:
        """The packed file where the board has it, else the list; a loader that is starting is waited for, for
        its parameters are the table."""
        found = self._read_all()
        enabled = found.values.get("SCR_ENABLE")
        if enabled is None or enabled.value != 1 or scripts.LAST in found.values:
            return found
        if not await_loader(self.files, self.parameters, wait_s=self._script_s):
            return found
        self._talk.say("the board has just started its scripts: reading it again")
        return self._read_all()

    def _read_all(self) -> Snapshot:
        try:
            data = self.files.read(packed.PATH)
            if data:
                found = packed.unpack(data)
                return Snapshot({n: self.parameters.encode(n, v, kind) for n, (v, kind) in found.items()})
        except (TableError, CheckFailed, InputError) as error:
            self._talk.say(f"no packed parameters ({error}); reading them one by one")
        return super().snapshot()

    def with_hidden(self, snapshot: Snapshot, names: Iterable[str]) -> Snapshot:
        """The loader's parameters are not hidden: without its script they are not there."""
        return super().with_hidden(snapshot, [name for name in names if not name.startswith(_LIVE)])

    def planned(
        self,
        plan: Plan,
        snapshot: Snapshot,
        *,
        new_geometry: bool,
        spin_from_table: bool = False,
        take_over: bool = False,
    ) -> Content:
        """Raises SafetyRefusal."""
        numbers = {n: v.value for n, v in snapshot.values.items()}
        now = motor_outputs(numbers)
        wanted = plan.rotor_count
        if wanted and now not in (0, wanted):
            raise SafetyRefusal(f"another vehicle: the table is for {wanted} rotors, the board drives {now}")
        gone: dict[str, bytes | None] = {}
        if is_table(plan.scripts):
            gone = self._other_matrices(take_over)
            if not new_geometry:
                self._refuse_other_motors(plan, snapshot)
        made = for_board(plan.params, numbers, spin_from_table=spin_from_table)
        for line in made.kept:
            self._talk.say(line)
        values = self._as_stored(made.params, snapshot)
        return Content(values, {**self._folder.planned(plan.scripts, table=is_table(plan.scripts)), **gone})

    def loads(self, name: str) -> bool:
        """The loader's parameters live and die with its script."""
        return name.startswith(_LIVE)

    def saved(self, backup: Backup, snapshot: Snapshot, choice: Choice) -> Content:
        """The scripts of a table, and what the upload was to bring besides; others stay as they are."""
        loader = (
            scripts.LOADER_NAME in backup.files
        )  # without it its parameters are what an interruption left
        known = {
            n: v
            for n, v in backup.params.items()
            if choice.takes(n)
            and (loader if n.startswith(_LIVE) else n in snapshot.values)
            and v == v
            and abs(v) != float("inf")
        }
        there = {n: d for n, d in backup.files.items() if is_table([n]) or n in choice.files}
        content = Content(self._as_stored(known, snapshot), self._folder.planned(there))
        gone = {f"{self._folder.path}/{n}": None for n in choice.files if n not in backup.files}
        content = content.over(Content(files=gone))
        checked = content.values.get(_CHECKSUM)
        if checked is None or checked.value == _UNCHECKED:
            return content
        return self.completed(content, snapshot)  # of the scripts that will be there

    def completed(self, content: Content, snapshot: Snapshot) -> Content:
        """SCR_LD_CHECKSUM counts every script in the folder, also those that are not ours."""
        there = snapshot.values.get(_CHECKSUM)
        if there is None or (_CHECKSUM not in content.values and there.value == _UNCHECKED):
            return content
        number = self._folder.checksum(content.files)
        value = self.parameters.encode(_CHECKSUM, number, there.type)
        return Content({**content.values, _CHECKSUM: value}, content.files)

    def keepable(self, content: Content, snapshot: Snapshot) -> Content:
        """Also the loader's parameters, which may not be there yet."""
        values = {n: v for n, v in content.values.items() if n in snapshot.values or n.startswith(_LIVE)}
        return Content(values, content.files)

    def others(self, snapshot: Snapshot, known: BoardFiles) -> BoardFiles:
        """Every script in the folder."""
        return self._folder.others(known)

    def write_backup(self, folder: Path, snapshot: Snapshot, files: BoardFiles, note: Note) -> Path:
        """ArduPilot's own text format, the scripts beside it."""
        loader = any(d is not None and p.endswith(scripts.LOADER_NAME) for p, d in files.items())
        values = {n: v for n, v in snapshot.values.items() if loader or not n.startswith(_LIVE)}
        whole = Snapshot(values, snapshot.hash)
        return write_backup(folder, ".param", self.session.identity, whole, files, note)

    # -- writing -------------------------------------------------------------------------------------------

    def _in_order(self, content: Content) -> tuple[Mapping[str, Value], Mapping[str, Value]]:
        """Where the loader goes away, its parameters go with it."""
        gone = any(d is None and p.endswith(scripts.LOADER_NAME) for p, d in content.files.items())
        fixed = {n: v for n, v in content.values.items() if not n.startswith(_LIVE)}
        live = {n: v for n, v in content.values.items() if n.startswith(_LIVE)}
        return fixed, {} if gone else live

    def restarting(self) -> None:
        """What scripts reported before is no word on what they do after it."""
        self._words.forget()

    def refuse_unflown(self, plan: Plan) -> None:
        """Hear from the board itself that it flies the table. Raises CheckFailed, LinkError."""
        if not plan.scripts:
            return
        motors = plan.rotor_count if is_table(plan.scripts) else None
        if complaint := self._words.table_complaint(motors, self._script_s):
            raise CheckFailed(f"the table is written, but the board does not fly it: {complaint}")

    def _make_last(self) -> None:
        """ArduPilot saves every value as it comes, and has no command for it."""

    def _put_later(self, values: Mapping[str, Value], guard: Guard, settle_s: float) -> None:
        """The loader's parameters, its checksum last: it takes the table when that agrees."""
        if not await_loader(self.files, self.parameters, values, self._script_s):
            raise CheckFailed(
                f"{_SUM} does not appear: the loader script does not run (see the vehicle's messages)"
            )
        guard()
        if self._put_packed(values, settle_s):
            return
        numbers = {n: v for n, v in values.items() if n != _SUM}
        for group in (numbers, {n: v for n, v in values.items() if n == _SUM}):
            self._put_values(group, {}, guard, settle_s)

    def _put_packed(self, values: Mapping[str, Value], settle_s: float) -> bool:
        """The whole table in one small file; False where the board does not take such a file."""
        try:
            data = packed.pack({n: (float(v.value), v.type) for n, v in values.items()})
            self.files.write_plain(packed.PATH, data)
        except CheckFailed as error:
            self._talk.say(f"packed parameters are not taken ({error}); writing them one by one")
            return False
        self.session.clock.sleep(settle_s)
        found = self.parameters.read_many(values, missing_ok=True)
        return all(n in found and found[n].same(v) for n, v in values.items())

    # -- parts ---------------------------------------------------------------------------------------------

    def _other_matrices(self, take_over: bool) -> dict[str, bytes | None]:
        """Scripts of somebody else's that set the matrix too: with `take_over` to be removed (the backup has
        them), else refused; refused as well is one that keeps the board from arming."""
        others = self._folder.others({self._folder.path + "/" + n: None for n in OURS}, modules=True)
        gone: dict[str, bytes | None] = dict.fromkeys(matrix_scripts(others)) if take_over else {}
        for path in gone:
            self._talk.say(f"{path} sets the matrix and makes way; `restore` of the backup puts it back")
        if found := foreign_matrix({p: d for p, d in others.items() if p not in gone}):
            raise SafetyRefusal(f"{found}; `take_over` removes it, and the backup keeps it")
        failed = [r for r in self._words.prearm() or () if "Scripting" in r and "CRC" not in r]
        if failed and others and not gone and not self._folder.has_table:
            names = ", ".join(sorted(others))
            raise SafetyRefusal(
                f"a script on the card failed already ({failed[0]}): mend or remove it ({names})"
            )
        return gone

    def _refuse_other_motors(self, plan: Plan, snapshot: Snapshot) -> None:
        """A frame of ArduPilot's own may number its motors in another way than the table (Y6 does)."""
        numbers = {n: v.value for n, v in snapshot.values.items()}
        new = planned_table(plan.params, plan.scripts)
        old = present_table(numbers, lambda: matrix_script(self.files))
        if old is None or new is None:
            frame = f"FRAME_CLASS {numbers.get('FRAME_CLASS', 0):g}"
            self._talk.say(f"the motors of {frame} are not known to coaxlink: check each with `turn_motors`")
            return
        moved = moved_rotors(old, new)
        if moved:
            raise SafetyRefusal(
                f"another vehicle: {moved[0]} ({len(moved)} rotors differ); `new_geometry` to mean it"
            )

    def _as_stored(self, params: Mapping[str, float | int], snapshot: Snapshot) -> dict[str, Value]:
        """As the board will keep them. Raises SafetyRefusal for an unknown name."""
        values = {}
        for name, value in params.items():
            there = snapshot.values.get(name)
            if there is None and not name.startswith(_LIVE):
                raise SafetyRefusal(f"{self.session.identity.name} has no parameter {name}")
            kind = there.type if there else FLOAT
            values[name] = self.parameters.encode(name, ardupilot.as_stored(name, float(value), kind), kind)
        return values
