"""The script folder of an ArduPilot board: where it is, what a table changes in it."""

from __future__ import annotations

from coaxlink.errors import CheckFailed
from coaxlink.link.ftp import Files
from firmware_params.ardupilot import scripts

Scripts = dict[str, bytes | None]  # by path on board; None: no such file
_OURS = (scripts.MATRIX_NAME, scripts.LOADER_NAME)


def script_folder(board: Files) -> str:
    """The script folder, made if it is not there. Raises CheckFailed."""
    for folder in scripts.SCRIPT_FOLDERS:
        if board.listing(folder) is not None:
            return folder
    for folder in scripts.SCRIPT_FOLDERS:
        board.make_folder(folder)
        if board.listing(folder) is not None:
            return folder
    raise CheckFailed(f"no folder for scripts on board ({' or '.join(scripts.SCRIPT_FOLDERS)})")


def plan_scripts(board: Files, folder: str, wanted: dict[str, bytes]) -> tuple[Scripts, Scripts, int]:
    """(as they are, as they are to be) by path, and the load checksum of the whole folder then.

    Of coaxlink's own tables only the wanted one stays: the other would stop with an error at boot. What is
    no table (the bridge) leaves the table alone.
    """
    present = [n for n in board.listing(folder) or [] if n.endswith(".lua")]
    new: Scripts = {f"{folder}/{name}": data for name, data in wanted.items()}
    table = any(n in _OURS for n in wanted)
    gone = {n for n in present if table and n in _OURS and n not in wanted}
    new |= {f"{folder}/{n}": None for n in gone}
    old = {path: board.read(path) for path in new}
    checksum = scripts.load_checksum(wanted.values())
    for name in present:
        if name not in wanted and name not in gone:
            checksum ^= (board.crc(f"{folder}/{name}") or 0) & 0x7FFFFF
    return old, new, checksum
