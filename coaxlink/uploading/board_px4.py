"""PX4 during an upload: parameters, held against the board's own list and saved before they are read back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.parameters import Snapshot
from coaxlink.uploading.backup import Backup, Note, write_backup
from coaxlink.uploading.board import Board
from coaxlink.uploading.content import BoardFiles, Content
from coaxlink.uploading.limits import Limits, board_limits, refuse_beyond
from coaxlink.uploading.plan import Plan, refuse_table
from coaxlink.uploading.restore_choice import Choice
from firmware_params.px4 import PARAMETERS

_AUTOSAVE_S = 2.5  # PX4 v1.16 saves 0.3 s after a change, at most every 2 s (parameters/autosave.cpp)
_SAVED_S = 5.0  # a save that runs already, 0.3 to 2.3 s, has ended by then
_KNOWN = (1, 17)  # newest version whose allocation was read and flown
_OUTPUT, _MOTOR_1 = re.compile(r"_FUNC\d+$"), 101


class Px4Board(Board):
    """See the module."""

    stands = "PX4 flies these numbers as they are, in flight too: land and disarm before anything else"
    holds = frozenset(PARAMETERS)

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
        refuse_table(plan, self.session.identity, snapshot.values, new_geometry=new_geometry)
        limits = self.metadata()
        if limits is not None:
            refuse_beyond(plan.params, limits, self.session.identity.name)
            self._talk.say(f"values held against the {len(limits)} parameters of the board's own list")
        self._remark(plan, snapshot)
        return Content(self._stored(plan.params, plan.types, snapshot, known_only=False))

    def _remark(self, plan: Plan, snapshot: Snapshot) -> None:
        """What the flight engineer should know, though it forbids nothing."""
        identity = self.session.identity
        if identity.version and identity.version[:2] > _KNOWN:
            known = ".".join(map(str, _KNOWN))
            self._talk.say(
                f"what {identity.name} drops of a table is only known up to {known}: look at it fly"
            )
        outputs = {v.value for n, v in snapshot.values.items() if _OUTPUT.search(n)}
        bare = [n for n in range(1, (plan.rotor_count or 0) + 1) if _MOTOR_1 + n - 1 not in outputs]
        if outputs and bare:
            self._talk.say(
                f"no output of this board drives rotor {', '.join(map(str, bare))} (*_FUNCn = 101..112)"
            )

    def metadata(self) -> Mapping[str, Limits] | None:
        """The board's `parameters.json.xz`."""
        return board_limits(self.files, self.session.identity)

    def saved(self, backup: Backup, snapshot: Snapshot, choice: Choice) -> Content:
        """The chosen parameters."""
        params = {n: v for n, v in backup.params.items() if choice.takes(n)}
        return Content(self._stored(params, backup.types, snapshot, known_only=True))

    def write_backup(self, folder: Path, snapshot: Snapshot, files: BoardFiles, note: Note) -> Path:
        """QGC's format, with the board's own hash."""
        return write_backup(folder, ".params", self.session.identity, snapshot, files, note)

    def _make_last(self) -> None:
        """PX4 saves late; a power cut before that would leave the old values, or some of each."""
        for _ in range(2):  # a second request is only taken once the save of the first has ended
            result = self._save()
            if result != mavlink.MAV_RESULT_ACCEPTED:
                self._talk.say(f"it does not save on request (result {result}); waiting until it has")
                self.session.clock.sleep(_AUTOSAVE_S)
                return

    def _save(self) -> int:
        clock = self.session.clock
        end = clock.monotonic() + _SAVED_S
        while True:
            result = self.session.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1.0, timeout_s=0.4, tries=24)
            if result != mavlink.MAV_RESULT_TEMPORARILY_REJECTED or clock.monotonic() > end:
                return result
            clock.sleep(0.05)
