"""The one peer a session believes: an address, a system and component, an autopilot type, a board's uid."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.mavlink.clock import Clock
from coaxlink.mavlink.identity import Identity, type_name, uid_of
from coaxlink.mavlink.strangers import Stranger, Strangers, address_text

_UNBOUND = 32  # addresses that are listened to before one of them is the vehicle's
_ASK_S, _REQUESTS = 0.35, 6  # a claimant is asked so often; then the first that was heard is believed
_HERE_S = 10.0  # heard within that time
_REPORTED_MOST = 8  # addresses that are named; a flood of them is only counted
_TURNS = 5  # changes of a vehicle's kind: a table that is written and taken back changes it twice
_NEWS = 8  # lines that wait to be read


@dataclass
class Claimant:
    """Who says from an address to be an autopilot, before the session is bound; forgers do not answer."""

    identity: Identity
    heartbeat: Any
    first_s: float
    requests: int = 0
    requested_s: float = -math.inf


class Bound:
    """Kept on the receiver thread; other threads only look. `peer` is None on a stream, which has one end.

    The vehicle is followed to another address when its own has been silent for LOST_S and its uid, asked
    again there, is the same; one without a uid of its own (zeros, PX4's SITL) is known by its address alone.
    """

    def __init__(
        self,
        line: str,
        new_parser: Callable[[], mavlink.MAVLink],
        genuine: Callable[[bytes], bool] | None,
        clock: Clock,
    ) -> None:
        self.identity: Identity | None = None
        self.peer: Any = None
        self.heard_s = 0.0  # the last heartbeat, monotonic
        self.bound_s = 0.0
        self.signs = False  # whether its heartbeats come signed
        self.strangers = Strangers(genuine)
        self._line, self._new_parser, self._clock = line, new_parser, clock
        self._stream = new_parser()
        self._parsers: dict[Any, mavlink.MAVLink] = {}  # one an address, until one of them is the vehicle's
        self._claimants: dict[Any, Claimant] = {}
        self._news: deque[str] = deque(maxlen=_NEWS)
        self._reported = 0
        self._other = ""  # who else answers behind the vehicle's own address
        self._kinds: list[int] = []  # MAV_TYPE of its heartbeats, where that changed
        self._beats = 0

    def parser(self, peer: Any) -> mavlink.MAVLink:
        """Of what comes from there: half a frame of one sender must not swallow another's."""
        if peer is None or self.identity is not None:
            return self._stream
        if peer not in self._parsers:
            if len(self._parsers) >= _UNBOUND:
                del self._parsers[next(iter(self._parsers))]
            self._parsers[peer] = self._new_parser()
        return self._parsers[peer]

    @property
    def claimants(self) -> bool:
        """Whether an autopilot was heard that may still answer."""
        return bool(self._claimants)

    def claimant(self, peer: Any) -> Claimant | None:
        """Who was heard there before the session is bound."""
        return self._claimants.get(peer)

    def suggest(self, identity: Identity, heartbeat: Any, peer: Any) -> None:
        """An autopilot's heartbeat came from there."""
        if peer not in self._claimants and len(self._claimants) >= _UNBOUND:
            del self._claimants[next(iter(self._claimants))]
        known = self._claimants.setdefault(peer, Claimant(identity, heartbeat, self._clock.monotonic()))
        if known.identity == identity:
            known.heartbeat = heartbeat

    def to_ask(self) -> list[tuple[Identity, Any]]:
        """Claimants whose turn it is to be asked who they are."""
        now, found = self._clock.monotonic(), []
        for peer, who in self._claimants.items():
            if who.requests < _REQUESTS and now - who.requested_s >= _ASK_S:
                who.requests, who.requested_s = who.requests + 1, now
                found.append((who.identity, peer))
        return found

    def silent_choice(self) -> tuple[Claimant, Any] | None:
        """The first that was heard, once it was asked often enough and nobody has answered."""
        patience_s = _ASK_S * _REQUESTS
        for peer, who in self._claimants.items():
            return (who, peer) if self._clock.monotonic() - who.first_s > patience_s else None
        return None

    def bind(self, identity: Identity, peer: Any) -> None:
        """This is the vehicle."""
        self._claimants.clear()
        self.peer, self.bound_s = peer, self._clock.monotonic()
        self._stream = self._parsers.pop(peer, self._stream)
        self._parsers.clear()
        self.identity = identity

    def elsewhere(self, peer: Any) -> bool:
        """Whether that is not where our vehicle is."""
        return peer is not None and peer != self.peer and self.identity is not None

    def look(self, data: bytes, peer: Any) -> bool:
        """Count a datagram from elsewhere; whether its sender is to be asked who it is."""
        known, now = self.identity, self._clock.monotonic()
        assert known is not None
        new = self.strangers.get(peer) is None
        stranger = self.strangers.take(data, peer, (known.system, known.component), now)
        if stranger is not None and new and self._reported < _REPORTED_MOST:
            self._reported += 1
            ours = f"the vehicle is at {address_text(self.peer)}"
            self._news.append(
                f"not believed: heartbeats of system {known.system} from {stranger.name}; {ours}"
            )
        heir = self.strangers.heir(known.uid, self.heard_s, now) if known.unique else None
        if heir is not None:
            was = address_text(self.peer)
            self.peer, self._stream, self.heard_s = heir.address, self._new_parser(), now
            self.strangers.forget(heir.address)
            self._news.append(
                f"{was} fell silent; its board {known.uid} answers at {heir.name}: the session goes on there"
            )
        return stranger is not None

    def same(self, message: Any) -> bool:
        """Whether a HEARTBEAT or AUTOPILOT_VERSION from the vehicle's own place is the vehicle's."""
        known = self.identity
        assert known is not None
        if message.get_type() == "HEARTBEAT":
            if message.autopilot != known.autopilot:
                if not self._other:
                    self._news.append(f"not believed: heartbeats of an autopilot of type {message.autopilot}")
                self._other = f"an autopilot of type {message.autopilot}"
                return False
            self._beat(message.type)
            self.heard_s = self._clock.monotonic()
            self.signs = bool(message.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED)
            for second in self.strangers.beat(known.uid):
                what = f"a second vehicle answers as system {known.system}"
                self._news.append(
                    f"{what}: {second.name} (board {second.uid}), beside {self.vehicle_address}"
                )
        elif known.uid and uid_of(message) != known.uid:
            self._other = f"board {uid_of(message)}"
            return False
        return True

    def _beat(self, kind: int) -> None:
        """A vehicle is of one kind, and of another after a restart at most: by turns of two, two send."""
        self._beats += 1
        if self._kinds[-1:] == [kind] or len(self._kinds) > _TURNS:
            return
        self._kinds.append(kind)
        if len(self._kinds) > _TURNS:
            names = " and ".join(type_name(k) for k in sorted(set(self._kinds)))
            rate = self._beats / max(self._clock.monotonic() - self.bound_s, 1.0)
            self._news.append(
                f"heartbeats of two kinds come by turns from {self.vehicle_address}: {names}, {rate:.0f} a "
                "second: somebody else sends under the vehicle's ids"
            )

    def news(self) -> list[str]:
        """What there is to say about who is on the line, since the last call; one line each."""
        reported = []
        while self._news:
            reported.append(self._news.popleft())
        return reported

    def standing(self) -> list[str]:
        """Who else is here now, a line each, for a screen."""
        now, reported = self._clock.monotonic(), []
        for s in self.strangers:
            if now - s.heard_s < _HERE_S:
                what = "another vehicle of its ids" if s.beside else "messages under its ids"
                reported.append(
                    f"{what} at {s.name}: not believed ({s.datagrams}); it is at {self.vehicle_address}"
                )
        if self._other:
            reported.append(
                f"behind {self.vehicle_address} another answers under the same ids: {self._other}"
            )
        return reported

    def refuse_others(self, *, alone: bool = True) -> None:
        """Raises SafetyRefusal when another vehicle uses the same ids: what is written must not stray.

        Without `alone` only one that cannot be told apart, behind the same address, is refused.
        """
        known = self.identity
        if known is None:
            return
        for stranger in self.strangers:
            if alone and stranger.beside:
                raise SafetyRefusal(self._two(known, stranger))
        if self._other:
            two = f"board {known.uid or 'unknown'} ({known.name}) and {self._other}"
            raise SafetyRefusal(f"two answer as system {known.system} at {self.vehicle_address}: {two}")

    @property
    def vehicle_address(self) -> str:
        """Where the vehicle is: its address, or the line."""
        return address_text(self.peer) if self.peer else self._line

    def _two(self, known: Identity, second: Stranger) -> str:
        ours = f"{self.vehicle_address} (board {known.uid or 'unknown'})"
        advice = "give one of them another system id, or a line of its own"
        if second.uid == known.uid and known.unique:
            advice = f"{advice}; if it is one board with two ways to here, close one"
        return (
            f"two vehicles answer as system {known.system} component {known.component}, {ours} and "
            f"{second.name} (board {second.uid}): {advice}"
        )
