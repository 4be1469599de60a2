"""Who else is heard on a line: where there are several autopilots, one has to be named.

A radio, a router or a port that anyone may send to brings every vehicle's messages; a session talks to one.
What another vehicle says is never believed here, it is only known to be there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.mavlink.identity import is_vehicle, kind_name
from coaxlink.mavlink.strangers import address_text, whole_frames

# autopilots beat once a second (MAVLink's heartbeat protocol): each is heard once in this time
ONE_BEAT_S = 1.2
_BEAT, _SET = mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_PARAM_SET


class Autopilots:
    """Filled on the receiver thread; other threads only look."""

    def __init__(self, genuine: Callable[[bytes], bool] | None) -> None:
        """`genuine` tells of a frame whether it is signed with our key; None on an unsigned link."""
        self._genuine = genuine
        self._decoder = mavlink.MAVLink(None)
        self._by_system: dict[int, str] = {}
        self._writers: dict[tuple[int, int], str] = {}  # who else sets parameters

    def note(self, message: Any, peer: Any) -> None:
        """A message was read; of an autopilot's heartbeat, and of a write, it is remembered whose."""
        if message.get_type() == "PARAM_SET":
            who = message.get_srcSystem(), message.get_srcComponent()
            where = f" at {address_text(peer)}" if peer else ""
            self._writers.setdefault(who, f"system {who[0]} component {who[1]}{where}")
        if message.get_type() == "HEARTBEAT" and is_vehicle(message, None):
            what = f"system {message.get_srcSystem()} ({kind_name(message.autopilot)}"
            where = f" at {address_text(peer)})" if peer else ")"
            self._by_system.setdefault(message.get_srcSystem(), what + where)

    def look(self, data: bytes, peer: Any) -> None:
        """The same of a datagram that nobody else will read."""
        for who, number, frame in whole_frames(data):
            new = who not in self._writers if number == _SET else who[0] not in self._by_system
            if number in (_BEAT, _SET) and new and self._signed(frame):
                try:
                    self.note(self._decoder.decode(bytearray(frame)), peer)
                except mavlink.MAVError:
                    return

    def beside(self, system: int) -> list[str]:
        """The others, in words."""
        return [words for other, words in sorted(self._by_system.items()) if other != system]

    def writers(self) -> str:
        """Who else writes parameters, in words; one who does so over another line is not heard here."""
        heard = " and ".join(self._writers.values())
        return f"{heard} writes parameters too" if heard else "another station may write, none is heard here"

    def refuse_several(self) -> None:
        """Raises SafetyRefusal where more than one was heard."""
        if len(self._by_system) > 1:
            found = ", ".join(words for _, words in sorted(self._by_system.items()))
            raise SafetyRefusal(f"several autopilots are on this line: {found}; which? (`target_system`)")

    def _signed(self, frame: bytes) -> bool:
        return self._genuine is None or self._genuine(frame)
