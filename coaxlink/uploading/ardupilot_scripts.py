"""The script folder of an ArduPilot board: where it is, what a table changes in it."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping

from coaxlink.errors import CheckFailed
from coaxlink.mavlink.ftp import Files
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.ardupilot_words import matrix_line
from coaxlink.uploading.content import BoardFiles
from firmware_params.ardupilot import scripts

SCRIPT_S = 15.0  # until a script's parameters appear
_LOOK_S = 0.5
OURS = (scripts.MATRIX_NAME, scripts.LOADER_NAME)


def is_table(names: Iterable[str]) -> bool:
    """Whether one of these scripts is a mixer table."""
    return any(name in OURS for name in names)


def present_folder(board: Files) -> str | None:
    """Where scripts lie on a board, None where there is no such folder; nothing is made."""
    return next((folder for folder in scripts.SCRIPT_FOLDERS if board.listing(folder) is not None), None)


def matrix_script(board: Files) -> bytes | None:
    """The script that sets the matrix, ours before an owner's; None where there is none."""
    for folder in scripts.SCRIPT_FOLDERS:
        names = board.listing(folder) or []
        for name in sorted(names, key=lambda name: (name != scripts.MATRIX_NAME, name)):
            data = board.read(f"{folder}/{name}") if name.endswith(".lua") else None
            if data is not None and (
                name == scripts.MATRIX_NAME or matrix_line(data.decode("utf-8", "replace"))
            ):
                return data
    return None


def await_loader(
    board: Files, parameters: Parameters, names: Iterable[str] = (), wait_s: float = SCRIPT_S
) -> bool:
    """Wait for the loader's parameters on a board that is starting; False where none will come, or did.

    ArduPilot serves MAVLink during its start and runs scripts after it (AP_Vehicle::setup: init_ardupilot,
    then scripting.init): until then it has no parameter of a script's own, and says so.
    """
    wanted = [n for n in names if n.startswith(scripts.PREFIX)] or [scripts.LAST]
    enabled = parameters.read_many(["SCR_ENABLE"], missing_ok=True)
    folder = present_folder(board)
    if not enabled or enabled["SCR_ENABLE"].value != 1 or folder is None:
        return False
    if board.crc(f"{folder}/{scripts.LOADER_NAME}") is None:
        return False
    clock = board.clock
    end = clock.monotonic() + wait_s
    while len(parameters.answering(wanted)) < len(wanted):
        if clock.monotonic() > end:
            return False
        clock.sleep(_LOOK_S)
    return True


class ScriptFolder:
    """The folder on one board; listed once, when it is first needed."""

    def __init__(self, board: Files) -> None:
        self._board = board

    @functools.cached_property
    def path(self) -> str:
        """Where it is; made if it is not there. Raises CheckFailed."""
        return self._found[0]

    def planned(self, wanted: Mapping[str, bytes], *, table: bool = True) -> BoardFiles:
        """The scripts that change, as they are to be, by path.

        Of coaxlink's own tables only the wanted one stays: the other would stop with an error at boot. That
        it is not there is given as well, or an interrupted upload's way back would bring it along. What is no
        `table` (the bridge) leaves the table alone.
        """
        new: dict[str, bytes | None] = {f"{self.path}/{name}": data for name, data in wanted.items()}
        for name in OURS:
            if table and name not in wanted:
                new[f"{self.path}/{name}"] = None
        return new

    def checksum(self, changes: BoardFiles) -> int:
        """SCR_LD_CHECKSUM of the whole folder once `changes` are made."""
        total = scripts.load_checksum(data for data in changes.values() if data is not None)
        for path in self._paths:
            if path not in changes:
                total ^= (self._board.crc(path) or 0) & 0x7FFFFF
        return total

    def others(self, known: BoardFiles, *, modules: bool = False) -> BoardFiles:
        """Every script on board by path, but those known; with `modules` also what scripts take in."""
        paths = [path for path in self._paths if path not in known]
        if modules:
            folder = f"{self.path}/modules"
            names = self._board.listing(folder) or ()
            paths += [f"{folder}/{name}" for name in names if name.endswith(".lua")]
        return {path: self._board.read(path) for path in paths}

    @property
    def has_table(self) -> bool:
        """Whether one of coaxlink's own tables lies there."""
        return is_table(path.rpartition("/")[2] for path in self._paths)

    @property
    def _paths(self) -> list[str]:
        folder, names = self._found
        return [f"{folder}/{name}" for name in names if name.endswith(".lua")]

    @functools.cached_property
    def _found(self) -> tuple[str, list[str]]:
        for made in (False, True):
            for folder in scripts.SCRIPT_FOLDERS:
                if made:
                    self._board.make_folder(folder)
                names = self._board.listing(folder)
                if names is not None:
                    return folder, names
        raise CheckFailed(f"no folder for scripts on board ({' or '.join(scripts.SCRIPT_FOLDERS)})")
