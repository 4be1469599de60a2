"""What of a backup goes back: what the upload after it wrote, or all that is not the board's own.

A backup notes what was about to be written. What later uploads from here wrote besides belongs to the undo as
well, so the journal's names are added. Backups of coaxlinks that noted nothing fall back to every name that a
mixer table can hold on that firmware.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from coaxlink.mavlink.parameters import Number, Snapshot
from coaxlink.uploading.backup import Backup


@dataclass(frozen=True)
class Choice:
    """The part of one backup that is to go back."""

    table: frozenset[str]  # names of parameters; one that the board refuses undoes the restore
    files: frozenset[str]  # names of files; one that the backup lacks is removed
    rest: frozenset[str] = frozenset()  # with --all: names that the board may refuse
    left_out: Mapping[str, str] = field(
        default_factory=dict
    )  # the board's own among the rest, and their kind
    noted: bool = True  # False: the backup does not say what was to be written

    def takes(self, name: str) -> bool:
        """Whether a parameter goes back."""
        return name in self.table or name in self.rest


def choose(
    backup: Backup,
    *,
    touched: Iterable[str],
    holds: frozenset[str],
    loads: Callable[[str], bool],
    kind: Callable[[str], str] | None = None,
) -> Choice:
    """The choice; with `kind` (a name's kind where it is the board's own, else "") also of the rest.

    `holds` are the names that a table can write on this firmware, `loads` says of a name that it comes and
    goes with a table's file.
    """
    names = set(touched) | (backup.note.names if backup.note else holds)
    table = frozenset(n for n in backup.params if n in names or loads(n))
    files = backup.note.files if backup.note else frozenset(backup.files)
    if kind is None:
        return Choice(table, files, noted=backup.note is not None)
    kinds = {n: kind(n) for n in backup.params if n not in table}
    rest = frozenset(n for n, why in kinds.items() if not why)
    left_out = {n: why for n, why in kinds.items() if why}
    return Choice(table, files | frozenset(backup.files), rest, left_out, backup.note is not None)


def differing(backup: Backup, board: Snapshot) -> list[str]:
    """Names of the backup's parameters that the board holds otherwise."""
    held = board.values
    return [n for n, v in backup.params.items() if n in held and v == v and _differ(v, held[n].value)]


def _differ(a: Number, b: Number) -> bool:
    if isinstance(a, int) and isinstance(b, int):
        return a != b
    try:
        return struct.pack("<f", a) != struct.pack("<f", b)  # as boards keep them
    except OverflowError:
        return True
