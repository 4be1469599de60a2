"""The companion's end of the PX4 module that `coaxlink bridge` writes (`onboard/px4_module`).

The module's demand is a DEBUG_FLOAT_ARRAY of name "coax" with, in `data`: roll, pitch, yaw, thrust; system
and component of the companion followed; how many answers it took, modulo COUNTED; the number of the demand;
the identity of the vehicle; the token of the companion followed; the companion's share in what is flown; and
one of FACTS in turn, as its number and its value; then of the upper rotors' share what is flown, whether on
trial, the law's own, and the least and the most that these rotors have (0 of older modules). An answer is a
TUNNEL of type PAYLOAD_TYPE for the demand of a number. uORB carries neither the sender of a TUNNEL nor its
link: whose an answer is stands in it, with a token drawn anew by every run of `mix`.
"""

from __future__ import annotations

import math
import secrets
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.live.arrival import Count
from coaxlink.live.onboard.ardupilot import COUNTED
from coaxlink.live.onboard.description import HASH_BITS, board_vehicle
from coaxlink.live.wire import Demand, Header
from coaxlink.mavlink import codec

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session
    from coaxlink.vehicle import Vehicle

PAYLOAD_TYPE, PROTOCOL, NAME = 40001, 1, b"coax"
REFUSALS = ("foreign", "rival", "invalid", "stale", "implausible")
FACTS = (*REFUSALS, "handed_back", "unsettled", "failed_motors")  # 0 ..; then the 16 of the wrench
WRENCH_FROM, TURN = len(FACTS), len(FACTS) + 16
FIND_S, AGAIN_S = 1.5, 1.0  # listened for so long; asked for again after so much silence
_HEAD = struct.Struct("<IIIBBBB")  # identity, token, number, system, component, rotors, protocol


@dataclass(frozen=True)
class SharesFlown:
    """Of the hover thrust from the upper rotors."""

    flown: float
    on_trial: bool
    own: float  # the law's
    least: float
    most: float

    @classmethod
    def of(cls, data: Sequence[float]) -> SharesFlown | None:
        """What a demand says, None where its module knows no shares or its rotors have one only."""
        flown, trial, own, least, most = data[13:18]
        by_companion = data[10] > 0.0  # its motors, not this share
        tried = trial > 0.5 and not by_companion
        return cls(flown, tried, own, least, most) if 0.0 < least < most < 1.0 else None


class ModuleEnd:
    """Finds the module, reads its demands, words the answers: a `Wire`, and what `BridgeEnd` is otherwise."""

    demand, answer = codec.DEBUG_FLOAT_ARRAY, codec.TUNNEL

    def __init__(self, session: Session, vehicle: Vehicle, rate_hz: float) -> None:
        self._session, self._clock, self._rate_hz = session, session.clock, rate_hz
        of = board_vehicle(vehicle.declared)
        self.identity, self._rotors = of.identity, of.rotors
        self.token = 1 + secrets.randbelow((1 << HASH_BITS) - 1)
        self.taken = Count(COUNTED)
        self.acknowledged = False  # at some time it reported that it follows us
        self.reported: dict[int, float] = {}  # facts by their numbers
        self.share: SharesFlown | None = None
        self._number = 0  # of the demand read last
        self._followed: tuple[int, int, int] = (0, 0, 0)  # system, component, token
        self._theirs: int | None = None  # identity that the board says
        self._heard_s = self._asked_s = self._clock.monotonic()

    # -- before it begins ----------------------------------------------------------------------------------

    def find(self) -> bool:
        """Whether the module speaks, with all its facts. Raises SafetyRefusal for another vehicle's."""
        with self._session.listen((self.demand.name,)) as heard:
            if not self._session.request_stream(self.demand.number, self._rate_hz):
                return False
            end = self._clock.monotonic() + FIND_S
            while len(self.reported) < TURN and (left := end - self._clock.monotonic()) > 0:
                message: Any = self._session.take(heard, left)
                if message is not None and message.array_id == PAYLOAD_TYPE:
                    self._note(message.data)
        if len(self.reported) < TURN:
            return False
        if self._theirs != self.identity:
            raise SafetyRefusal(
                f"the module on board was made for another vehicle (0x{self._theirs or 0:06x}, this airframe "
                f"file is 0x{self.identity:06x}): write and build it again (`px4_module`)"
            )
        return True

    @property
    def wrench(self) -> NDArray[np.float64]:
        """(4, 4) thrust, roll, pitch, yaw (N, N m) per roll, pitch, yaw, thrust demanded, as it says."""
        return np.array([self.reported[WRENCH_FROM + n] for n in range(16)]).reshape(4, 4)

    # -- a demand and its answer ---------------------------------------------------------------------------

    def read(self, payload: bytes) -> Demand | None:
        """See Wire."""
        stamp, array_id, name, *data = self.demand.unpack(payload)
        if array_id != PAYLOAD_TYPE or not name.startswith(NAME):
            return None
        self._note(data)
        return (stamp, *data[:7], 0.0, 0)

    def is_command(self, payload: bytes) -> bool:
        """See Wire."""
        return bool(self.answer.unpack(payload)[0] == PAYLOAD_TYPE)

    def pack(self, header: Header, stamp: int, commands: Sequence[float], target: tuple[int, int]) -> bytes:
        """See Wire."""
        head = _HEAD.pack(self.identity, self.token, self._number, *header[1:], self._rotors, PROTOCOL)
        body = head + struct.pack(f"<{self._rotors}f", *commands[: self._rotors])
        return self.answer.pack(*header, PAYLOAD_TYPE, *target, len(body), body)

    def tick(self, now: float) -> None:
        """A board that restarted has forgotten what it was asked for."""
        if now - max(self._heard_s, self._asked_s) > AGAIN_S:
            self._asked_s = now
            identity, interval_us = self._session.identity, 1e6 / self._rate_hz
            self._session.send(
                mavlink.MAVLink_command_long_message(
                    identity.system, identity.component, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                    float(self.demand.number), interval_us, 0, 0, 0, 0, 0,
                )
            )  # fmt: skip

    def hear(self, demand: Demand) -> str | None:
        """Another companion that the demand read last says the module follows."""
        self.taken.hear(demand[7])
        system, component, token = self._followed
        ours = (system, component, token) == (*self._session.source, self.token)
        self.acknowledged = self.acknowledged or ours
        if ours or (system, component) == (0, 0):
            return None
        return f"system {system} component {component}"

    @property
    def companion(self) -> str:
        """Whom the module follows, empty: nobody."""
        system, component, _ = self._followed
        return f"system {system} component {component}" if system or component else ""

    def account(self) -> dict[str, int]:
        """What the module reported of itself last, as `coaxlink mix --json` has it under `board`."""
        facts = {name: int(self.reported.get(n, 0)) for n, name in enumerate(FACTS)}
        return {"taken": self.taken.total, **facts}

    def _note(self, data: Sequence[float]) -> None:
        self._heard_s = self._clock.monotonic()
        if not all(map(math.isfinite, data[4:13])):
            return
        self._number, self._theirs = int(data[7]), int(data[8])
        self._followed = int(data[4]), int(data[5]), int(data[9])
        self.reported[int(data[11])] = data[12]
        self.share = SharesFlown.of(data)
