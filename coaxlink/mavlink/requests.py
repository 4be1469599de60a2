"""The asking half of a session: a message until its answer comes, a command until it is acknowledged."""

from __future__ import annotations

import time
from collections.abc import Collection

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import LinkError
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.listening import Ears, Match
from coaxlink.mavlink.strangers import LOST_S
from coaxlink.mavlink.values import Message


class Requests(Ears):
    """What asks and waits, over whatever sends."""

    address: str

    @property
    def identity(self) -> Identity:
        """Who answers. Raises LinkError before an autopilot was heard."""
        raise NotImplementedError

    def send(self, message: Message) -> None:
        """Send a message; thread-safe."""
        raise NotImplementedError

    def command(self, command_id: int, *params: float, timeout_s: float = 1.5, tries: int = 3) -> int:
        """Send COMMAND_LONG until it is acknowledged; the MAV_RESULT. Raises LinkError on silence."""
        target = self.identity
        values = [*map(float, params), *([0.0] * (7 - len(params)))]
        with self.listen(("COMMAND_ACK",), lambda m: m.command == command_id) as inbox:
            for attempt in range(tries):
                self.send(
                    mavlink.MAVLink_command_long_message(
                        target.system, target.component, command_id, attempt, *values
                    )
                )
                end = time.monotonic() + timeout_s
                while (ack := self.take_until(inbox, end)) is not None:
                    if ack.result != mavlink.MAV_RESULT_IN_PROGRESS:
                        return int(ack.result)
                    end = time.monotonic() + max(timeout_s, LOST_S)
        raise LinkError(self.address, f"command {command_id} was not acknowledged ({tries} tries)")

    def exchange(
        self,
        request: Message,
        type_names: Collection[str],
        match: Match,
        *,
        timeout_s: float = 0.6,
        tries: int = 4,
    ) -> tuple[Message | None, int]:
        """Send a request until an answer matches; (answer or None, how often it was sent again)."""
        with self.listen(type_names, match) as inbox:
            for attempt in range(tries):
                self.send(request)
                answer = self.take(inbox, timeout_s)
                if answer is not None:
                    return answer, attempt
        return None, tries - 1

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        """Ask for a message at a rate; False when the autopilot will not send it."""
        interval_us = -1.0 if rate_hz <= 0 else 1e6 / rate_hz
        result = self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
        return result == mavlink.MAV_RESULT_ACCEPTED
