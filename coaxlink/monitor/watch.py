"""From an address to views: the vehicle to hold the readings against, and the headless look."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from threading import Lock
from typing import Any

from coaxlink.errors import CoaxlinkError
from coaxlink.live.in_air import InAir
from coaxlink.mixer import Law, make_law
from coaxlink.monitor.board import ardupilot as board_ardupilot
from coaxlink.monitor.board.description import describe, table_parameters
from coaxlink.monitor.board.view import Board
from coaxlink.monitor.state import View, observe
from coaxlink.monitor.telemetry.battery import Drain, battery_of
from coaxlink.monitor.telemetry.hover import Hover
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.monitor.telemetry.sources import commanded_speeds
from coaxlink.monitor.telemetry.vehicle import is_armed
from coaxlink.vehicle import Vehicle

OUTPUTS = ("SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS")  # the first is taken where both come


class Watch:
    """What one screen looks at: readings of `collector`, held against `vehicle`."""

    def __init__(self, address: str, vehicle: Vehicle) -> None:
        self.address, self.vehicle = address, vehicle
        self.collector = Collector()
        self._lock = Lock()
        self.line: Callable[[], list[str]] = list  # who else is on the line, said among the notes
        self._waiting = ""
        self._table: dict[str, float] | None = None
        self._board = Board("unread")
        self._hover = Hover()
        self._drain = Drain()
        self._law = _exact(vehicle)
        self._target: tuple[int, int] | None = None
        self._in_air = InAir(vehicle)
        self._outputs = ""  # the kind of message that tells the commands
        self.collector.listener = self._hear

    def wait_for(self, what: str) -> None:
        """Say what the link is waiting for (any thread)."""
        with self._lock:
            self._waiting = what

    def judge_table(self) -> None:
        """Work out what the table is that was read; on the link's thread, as it may take seconds."""
        table = table_parameters(self.collector.readings(0.0).parameters)
        with self._lock:
            known = table == self._table
        if not known:
            board = describe(table, self.vehicle)
            with self._lock:
                self._table, self._board = table, board

    def look(self, now_s: float) -> View:
        """The view at `now_s` of the monotonic clock."""
        readings = self.collector.readings(now_s)
        table = table_parameters(readings.parameters)
        with self._lock:
            waiting, board = self._waiting, self._board if table == self._table else None
        if board is None and board_ardupilot.is_table(table):
            board = Board("partial", notes=("its table is being compared",))
        elif board is None:
            self.judge_table()  # the reduced coefficients are a fit: not five times a second
            board = self._board
        if readings.target != self._target:
            if self._target is not None:
                self._in_air = InAir(self.vehicle)
            self._target, self._hover, self._drain = readings.target, Hover(), Drain()
        self._hover = self._hover.extended(readings, self.vehicle, now_s)
        self._drain = self._drain.extended(
            readings.clock_s, battery_of(readings).remaining, is_armed(readings)
        )
        return observe(
            readings,
            self.vehicle,
            now_s,
            address=self.address,
            waiting=waiting,
            board=board,
            verdict=self._hover.verdict,
            line=self.line(),
            law=self._law,
            trend_min=self._drain.minutes,
            health=self._in_air.now,
        )

    def _hear(self, message: Any) -> None:
        """Every message of the vehicle, on the link's thread: what its rotors' health is judged by."""
        kind = message.get_type()
        if kind in OUTPUTS and self._outputs in ("", kind, OUTPUTS[1]) and not getattr(message, "port", 0):
            self._outputs = kind
            stamp_s, now_s = message.time_usec * 1e-6, math.inf
            readings = self.collector.readings(0.0)
            self._in_air.commanded(
                stamp_s, commanded_speeds(readings, len(self.vehicle.airframe.rotors), now_s).u
            )
        self._in_air.heard(message)


def _exact(vehicle: Vehicle) -> Law | None:
    """The law whose split is the ideal one; None for rotors that it cannot serve."""
    try:
        return make_law("exact", vehicle)
    except CoaxlinkError:
        return None


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
