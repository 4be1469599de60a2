"""From an address to views: the airframe and model to hold the readings against, and the headless look."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from threading import Lock
from typing import Any

from coaxlink.airframe import Airframe
from coaxlink.monitor.board import Board, describe, table_parameters
from coaxlink.monitor.readings import Collector
from coaxlink.monitor.state import View, observe
from coaxlink.rotor import RotorModel


class Watch:
    """What one screen looks at: readings of `collector`, held against `airframe` and `model`."""

    def __init__(self, address: str, airframe: Airframe, model: RotorModel) -> None:
        self.address, self.airframe, self.model = address, airframe, model
        self.collector = Collector()
        self._lock = Lock()
        self._waiting = ""
        self._table: dict[str, float] | None = None
        self._board = Board("unread")

    def wait_for(self, what: str) -> None:
        """Say what the link is waiting for (any thread)."""
        with self._lock:
            self._waiting = what

    def look(self, now_s: float) -> View:
        """The view at `now_s` of the monotonic clock."""
        readings = self.collector.readings(now_s)
        table = table_parameters(readings.parameters)
        if table != self._table:
            # the reduced coefficients are a fit: not five times a second
            self._table, self._board = table, describe(table, self.airframe, self.model)
        with self._lock:
            waiting = self._waiting
        return observe(
            readings,
            self.airframe,
            self.model,
            now_s,
            address=self.address,
            waiting=waiting,
            board=self._board,
        )


def to_json(view: View) -> dict[str, Any]:
    """The view as plain JSON values; unknown ones are null."""
    plain: dict[str, Any] = _plain(asdict(view))
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
