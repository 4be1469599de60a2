"""Parameters on board: values of a fixed type by name, and who hears of changes; both firmwares alike."""

from __future__ import annotations

from collections.abc import Callable


class ParameterStore:
    """Values by name; `names` are those listed, their places their indices on the wire."""

    names: list[str]

    def __init__(self) -> None:
        self._types: dict[str, int] = {}
        self._values: dict[str, float] = {}
        self._listeners: list[Callable[[str], None]] = []

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def values(self) -> dict[str, float]:
        """A copy of all."""
        return dict(self._values)

    def memory(self) -> dict[str, float]:
        """What a power cut leaves."""
        return self.values()

    def type(self, name: str) -> int:
        """As MAV_PARAM_TYPE."""
        return self._types[name]

    def listen(self, callback: Callable[[str], None]) -> None:
        """Call `callback(name)` after every change."""
        self._listeners.append(callback)

    def tell(self, name: str) -> None:
        """A value has changed."""
        for callback in self._listeners:
            callback(name)
