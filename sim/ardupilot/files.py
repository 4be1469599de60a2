"""ArduPilot's files: `/APM/...` of a board and `...` of a simulation are one place; `@PARAM/param.pck`."""

from __future__ import annotations

from sim.ardupilot.store import ArduPilotStore
from sim.line.ftp import FAIL, CardFiles, Manners

PARAMS = "@PARAM/param.pck"
MANNERS = Manners(unknown=FAIL)  # so MAVSDK, which lists with times, lists nothing of it


class Card(CardFiles):
    """The card, and the parameters packed into a file that is made while it is read."""

    def __init__(self, store: ArduPilotStore) -> None:
        super().__init__("APM")
        self._store = store

    @staticmethod
    def _packed(path: str) -> bool:
        return path.lstrip("/").startswith(PARAMS)

    def read(self, path: str) -> bytes | None:
        return self._store.packed() if self._packed(path) else super().read(path)

    def announced(self, path: str, size: int) -> int:
        return size + 1000 if self._packed(path) else size  # a guess, and too large

    def begin(self, path: str, data: bytes) -> bool:
        return self._packed(path) or super().begin(path, data)

    def keep(self, path: str, data: bytes) -> bool:
        return self._packed(path) or super().keep(path, data)

    def end(self, path: str, data: bytes) -> bool:
        return self._store.unpack(data) if self._packed(path) else True
