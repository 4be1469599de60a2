"""What stands on a board where arming ended a write: read only, held against the old and the new."""

from __future__ import annotations

from dataclasses import dataclass

from coaxlink.errors import CheckFailed, LinkError
from coaxlink.uploading.board import Board
from coaxlink.uploading.content import Content
from firmware_params.ardupilot.scripts import file_crc


@dataclass(frozen=True)
class Standing:
    """Names of the parameters and paths of the files that the write was to change."""

    new: tuple[str, ...] = ()
    old: tuple[str, ...] = ()
    other: tuple[str, ...] = ()  # neither: another writer, or a file half in place
    unknown: tuple[str, ...] = ()  # the board did not say

    @property
    def untouched(self) -> bool:
        """Whether the board holds its old table whole, as far as it reported, and it reported all."""
        return not (self.new or self.other or self.unknown)

    def to_json(self) -> dict[str, tuple[str, ...]]:
        """For the JSON of `upload`."""
        return {"new": self.new, "old": self.old, "other": self.other, "unknown": self.unknown}

    def lines(self) -> list[str]:
        """A line each, for those that are not empty."""
        return [f"{held}: {', '.join(names)}" for held, names in self.to_json().items() if names]

    def counts(self) -> str:
        """In a few words."""
        return ", ".join(f"{len(names)} {held}" for held, names in self.to_json().items() if names)


def what_stands(board: Board, old: Content, new: Content) -> Standing:
    """Read what the write was to change. A board that falls silent leaves the rest unknown."""
    changed = new.differs_from(old)
    held: dict[str, list[str]] = {"new": [], "old": [], "other": [], "unknown": []}
    try:
        found, answered = board.parameters.read_many(changed.values, missing_ok=True), True
    except LinkError:
        found, answered = {}, False
    for name, value in changed.values.items():
        before, now = old.values.get(name), found.get(name)
        if now is None and not answered:
            is_ = "unknown"
        elif now is None:
            is_ = "other" if before else "old"  # a loader's parameter that is not there yet
        elif now.same(value):
            is_ = "new"
        else:
            is_ = "old" if before and now.same(before) else "other"
        held[is_].append(name)
    for path, data in changed.files.items():
        held[_file(board, path, data, old)].append(path)
    return Standing(*(tuple(held[key]) for key in ("new", "old", "other", "unknown")))


def _file(board: Board, path: str, data: bytes | None, old: Content) -> str:
    try:
        crc = board.files.crc(path)
    except (LinkError, CheckFailed):
        return "unknown"
    if crc == _crc(data):
        return "new"
    return "old" if path in old.files and crc == _crc(old.files[path]) else "other"


def _crc(data: bytes | None) -> int | None:
    return None if data is None else file_crc(data)
