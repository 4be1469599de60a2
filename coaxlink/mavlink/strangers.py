"""Who else speaks with our vehicle's ids on a datagram line, and which of them are vehicles.

Anyone who reaches a port can forge a heartbeat; one who answers a request sent to its address hears us, too,
and counts as a second vehicle. Nothing of theirs is believed: they are counted, asked who they are, and told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.identity import uid_of

LOST_S = 5.0  # no heartbeat for so long: the link counts as lost
TWO_BEATS_S = 2.2  # vehicles beat once a second: in this time one is heard even if a beat is lost
MOST_ADDRESSES = 16  # addresses that are kept track of
ASK_S, ASK_MOST_S = 0.4, 2.0  # between questions to an address: doubled each time, up to the second
DOUBT_S = 2.0  # one who was asked and has not answered for so long hears nothing: three questions
_DOUBLED = 8
_BEAT, _VERSION = mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION


@dataclass
class Stranger:
    """One address that is not our vehicle's and uses its ids. Times are monotonic seconds."""

    address: Any
    datagrams: int = 0
    first_s: float = -math.inf
    heard_s: float = -math.inf
    requests: int = 0
    requested_s: float = -math.inf
    uid: str = ""  # what it answered
    answered_s: float = -math.inf
    beside: bool = False  # our vehicle was heard after it had answered: they are two
    overtaken: bool = False  # the same of one that gives our vehicle's uid: two once it is heard again
    overtaken_s: float = -math.inf  # when it was heard last before that

    @property
    def answers(self) -> bool:
        """Whether it hears us."""
        return self.answered_s > -math.inf

    @property
    def name(self) -> str:
        """HOST:PORT."""
        return address_text(self.address)


class Strangers:
    """Kept on the receiver thread; other threads only look."""

    def __init__(self, genuine: Callable[[bytes], bool] | None) -> None:
        """`genuine` tells of a frame whether it is signed with our key; None on an unsigned link."""
        self.datagrams = 0  # with our vehicle's system id, from other addresses than its own
        self._genuine = genuine
        self._by_address: dict[Any, Stranger] = {}
        self._decoder = mavlink.MAVLink(None)

    def __iter__(self) -> Iterator[Stranger]:
        return iter(tuple(self._by_address.values()))

    def get(self, address: Any) -> Stranger | None:
        """The one at an address."""
        return self._by_address.get(address)

    def forget(self, address: Any) -> None:
        """It is a stranger no more."""
        self._by_address.pop(address, None)

    def beat(self, uid: str) -> list[Stranger]:
        """Our vehicle `uid` was heard just now; those who answered before that and are hereby a second one.

        One who gives the same uid may be it, restarted: its last words at the old address come late, or it
        has restarted again. They are two once both are heard by turns.
        """
        found = []
        for s in self._by_address.values():
            if s.answers and not s.beside:
                s.beside = s.uid != uid or (s.overtaken and s.heard_s > s.overtaken_s)
                if not s.overtaken:
                    s.overtaken, s.overtaken_s = True, s.heard_s
                found += [s] if s.beside else []
        return found

    def undecided(self, now: float) -> bool:
        """Whether one of those heard of late may yet turn out to be a vehicle."""
        for s in self._by_address.values():
            waits = not s.beside if s.answers else now - s.first_s < DOUBT_S
            if now - s.heard_s < LOST_S and waits:
                return True
        return False

    def heir(self, uid: str, heard_s: float, now: float) -> Stranger | None:
        """Where the board `uid`, silent at its own address since `heard_s`, has answered; only one may."""
        since = heard_s + LOST_S
        found = [
            s
            for s in self._by_address.values()
            if s.answered_s > since and not s.beside and now - s.heard_s < TWO_BEATS_S
        ]
        return found[0] if now > since and len(found) == 1 and found[0].uid == uid else None

    def take(self, data: bytes, address: Any, ids: tuple[int, int], now: float) -> Stranger | None:
        """Look at a datagram; the stranger if it has to be asked who it is."""
        frames = [(who, number, frame) for who, number, frame in whole_frames(data) if who[0] == ids[0]]
        if not frames:
            return None  # another vehicle, or a ground station: none of our business
        self.datagrams += 1
        known = self._by_address.get(address)
        if known is not None:
            known.datagrams += 1
        beats = [frame for who, number, frame in frames if number == _BEAT and who == ids]
        if known is None:
            if not any(self._meant(frame, ids) for frame in beats):
                return None  # a camera or a gimbal with an address of its own, or noise
            known = self._by_address[address] = Stranger(address, 1)
            self._make_room()
        for _, number, frame in frames:
            if number == _VERSION and known.requests and (answer := self._meant(frame, ids)):
                known.uid, known.answered_s = uid_of(answer), now
        if not beats:
            return None
        known.first_s = known.first_s if known.requests else now
        known.heard_s = now
        if now - known.requested_s < min(ASK_S * 2 ** min(known.requests, _DOUBLED), ASK_MOST_S):
            return None
        known.requests += 1
        known.requested_s = now
        return known

    def _meant(self, frame: bytes, ids: tuple[int, int]) -> Any:
        """The message of a whole frame from just these ids, on a signed link a signed one; or None."""
        if self._genuine is not None and not self._genuine(frame):
            return None
        try:
            message: Any = self._decoder.decode(bytearray(frame))
        except mavlink.MAVError:
            return None
        if (message.get_srcSystem(), message.get_srcComponent()) != ids:
            return None
        return None if message.get_type() == "HEARTBEAT" and message.autopilot == _NO_AUTOPILOT else message

    def _make_room(self) -> None:
        """With too many, the one that never answered and was heard longest ago goes."""
        if len(self._by_address) > MOST_ADDRESSES:
            others = sorted(self._by_address.values(), key=lambda s: (s.answers, s.heard_s))
            new = next(reversed(self._by_address))
            del self._by_address[next(s.address for s in others if s.address != new)]


_NO_AUTOPILOT = mavlink.MAV_AUTOPILOT_INVALID


def address_text(address: Any) -> str:
    """A socket's address as HOST:PORT."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def whole_frames(data: bytes) -> Iterator[tuple[tuple[int, int], int, bytes]]:
    """(system, component), message number and bytes of the frames a datagram begins with."""
    at = 0
    while at + 8 <= len(data):
        if data[at] == 0xFD and at + 12 <= len(data):
            end = at + 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
            who, number = (data[at + 5], data[at + 6]), int.from_bytes(data[at + 7 : at + 10], "little")
        elif data[at] == 0xFE:
            end = at + 8 + data[at + 1]
            who, number = (data[at + 3], data[at + 4]), data[at + 5]
        else:
            return
        if end > len(data):
            return
        yield who, number, data[at:end]
        at = end
