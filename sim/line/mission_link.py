"""The mission protocol of one peer: upload, download, clear, set current (MISSION_ITEM_INT)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as m

from sim.line.mission import DELAY, FRAMES, KNOWN, NAVIGATION, RTL, Item
from sim.line.wire import Clock

ACCEPTED, ERROR, BAD_FRAME, UNSUPPORTED, NO_SPACE, INVALID, BAD_SEQUENCE, CANCELLED = 0, 1, 2, 3, 4, 5, 13, 15
FENCE_AND_RALLY = {5000, 5001, 5002, 5003, 5004, 5100}
MOST = 500
AGAIN_S, TRIES = 0.3, 8  # wall time


class MissionTransfer:
    """One list at a time, either way."""

    def __init__(
        self,
        autopilot: Any,
        send: Callable[[Any], None],
        everyone: Callable[[Any], None],
        request: Callable[..., Any],
        clock: Clock,
    ) -> None:
        self._autopilot, self._send, self._everyone, self._request = autopilot, send, everyone, request
        self._clock = clock
        self._kind, self._count = 0, 0
        self._items: list[Item] | None = None  # of an upload that runs
        self._peer = (255, 190)
        self._requested_at, self._tries = 0.0, 0
        self.handlers: dict[str, Callable[[Any], None]] = {
            "MISSION_COUNT": self._begin,
            "MISSION_ITEM_INT": self._item,
            "MISSION_ITEM": self._old_item,
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST_INT": self._give,
            "MISSION_REQUEST": self._give,
            "MISSION_CLEAR_ALL": self._clear,
            "MISSION_SET_CURRENT": self._set_current,
            "MISSION_ACK": self._ended,
        }

    # -- upload --------------------------------------------------------------------------------

    def _begin(self, message: Any) -> None:
        self._peer = message.get_srcSystem(), message.get_srcComponent()
        kind = message.mission_type
        if kind not in self._autopilot.mission.items or message.count > MOST:
            self._ack(UNSUPPORTED if message.count <= MOST else NO_SPACE, kind)
            return
        self._kind, self._count, self._items = kind, message.count, []
        if message.count:
            self._ask()
        else:
            self._finish()

    def _ask(self, again: bool = False) -> None:
        assert self._items is not None
        self._requested_at, self._tries = self._clock(), self._tries + 1 if again else 0
        self._send(self._request(*self._peer, len(self._items), self._kind))

    def go_on(self) -> None:
        """Ask again for what did not come; give up in the end."""
        if self._items is None or self._clock() - self._requested_at < AGAIN_S:
            return
        if self._tries >= TRIES:
            self._ack(CANCELLED, self._kind)
            self._items = None
        else:
            self._ask(again=True)

    def _old_item(self, message: Any) -> None:
        """The same with degrees in floats."""
        self._take(message, round(1e7 * message.x), round(1e7 * message.y))

    def _item(self, message: Any) -> None:
        self._take(message, message.x, message.y)

    def _take(self, message: Any, x: int, y: int) -> None:
        if self._items is None:
            if message.command == 16 and message.current == 2:  # ArduPilot's old way to say "fly there"
                return
            self._ack(ERROR, message.mission_type)
            return
        if message.mission_type != self._kind or message.seq != len(self._items):
            return  # a copy, or out of order: what is wanted is asked for again
        known = KNOWN if self._kind == 0 else FENCE_AND_RALLY
        if message.command not in known or (message.frame not in FRAMES and message.command in (16, 21, 22)):
            self._ack(UNSUPPORTED if message.command not in known else BAD_FRAME, self._kind)
            self._items = None
            return
        params = (message.param1, message.param2, message.param3, message.param4)
        placed = message.command in NAVIGATION and message.command not in (RTL, DELAY)
        if (placed and not math.isfinite(message.z)) or any(map(math.isinf, params)):
            self._ack(INVALID, self._kind)
            self._items = None
            return
        item = Item(message.frame, message.command, params, x, y, message.z, message.autocontinue)
        self._items.append(item)
        if len(self._items) < self._count:
            self._ask()
        else:
            self._finish()

    def _finish(self) -> None:
        assert self._items is not None
        self._autopilot.mission.put(self._kind, self._items)
        self._items = None
        self._ack(ACCEPTED, self._kind)

    def _ack(self, result: int, kind: int) -> None:
        self._send(m.MAVLink_mission_ack_message(*self._peer, result, kind))

    # -- download and the rest -----------------------------------------------------------------

    def _list(self, message: Any) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        count = len(self._autopilot.mission.items.get(message.mission_type, []))
        self._send(m.MAVLink_mission_count_message(*source, count, message.mission_type))

    def _give(self, message: Any) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        mission = self._autopilot.mission
        items = mission.items.get(message.mission_type, [])
        if message.seq >= len(items):
            self._send(m.MAVLink_mission_ack_message(*source, BAD_SEQUENCE, message.mission_type))
            return
        i = items[message.seq]
        current = int(message.mission_type == 0 and message.seq == mission.current)
        head = (*source, message.seq, i.frame, i.command, current, i.autocontinue, *i.params)
        if message.get_type() == "MISSION_REQUEST":
            position = (i.x * 1e-7, i.y * 1e-7, i.z, message.mission_type)
            self._send(m.MAVLink_mission_item_message(*head, *position))
        else:
            self._send(m.MAVLink_mission_item_int_message(*head, i.x, i.y, i.z, message.mission_type))

    def _clear(self, message: Any) -> None:
        self._peer = message.get_srcSystem(), message.get_srcComponent()
        kinds = self._autopilot.mission.items
        for kind in list(kinds) if message.mission_type == 255 else [message.mission_type]:
            if kind in kinds:
                self._autopilot.mission.put(kind, [])
        self._ack(ACCEPTED, message.mission_type)

    def _set_current(self, message: Any) -> None:
        if self._autopilot.mission.go_to(message.seq):
            self._everyone(m.MAVLink_mission_current_message(message.seq))

    def _ended(self, message: Any) -> None:
        """A download is over, or an upload called off."""
        if message.type == CANCELLED:
            self._items = None
