"""The waiting half of a session: who wants to know of which messages, one that is waited for, requests until
they are answered."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterator

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import LinkError
from coaxlink.mavlink.clock import Clock
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.strangers import LOST_S
from coaxlink.mavlink.values import Message

Match = Callable[[Message], bool]
_OF_SOME = frozenset((290, 291, 11030, 11031, 11032))  # ESC_INFO, ESC_STATUS, ESC_TELEMETRY_*
TICK_S = 0.05  # so soon a line that broke is noticed


class Inbox:
    """Messages that wait to be taken; filled by the receiver, emptied by one thread."""

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self.filled = threading.Event()

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: Message) -> None:
        """One more."""
        self._messages.append(message)
        self.filled.set()

    def pop(self) -> Message | None:
        """The oldest, None when there is none."""
        if not self._messages:
            self.filled.clear()
        return self._messages.popleft() if self._messages else None

    def clear(self) -> None:
        """Forget what waits."""
        self._messages.clear()


class Requests:
    """Messages from the receiver to callbacks, inboxes and the newest of each type; thread-safe."""

    address: str

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._lock = threading.Lock()
        self._failure: BaseException | None = None  # what ended the receiving; raised by the next wait
        self._latest: dict[str, Message] = {}
        self._subscribers: tuple[tuple[Callable[[Message], None], bool], ...] = ()

    @property
    def identity(self) -> Identity:
        """Who answers. Raises LinkError before an autopilot was heard."""
        raise NotImplementedError

    def send(self, message: Message) -> None:
        """Send a message; thread-safe."""
        raise NotImplementedError

    # -- hearing -------------------------------------------------------------------------------------------

    def latest(self, type_name: str) -> Message | None:
        """The autopilot's last message of a type, None if there was none."""
        return self._latest.get(type_name)

    def subscribe(
        self, callback: Callable[[Message], None], *, whole_system: bool = False
    ) -> Callable[[], None]:
        """Call back with every message of the autopilot, on the receiver thread; returns the way out.

        With `whole_system` those of its gimbal, cameras and companions come too; none may answer for it.
        An error in a callback ends the session's receiving and is raised by the next wait.
        """
        entry = (callback, whole_system)
        with self._lock:
            self._subscribers = (*self._subscribers, entry)

        def unsubscribe() -> None:
            with self._lock:
                self._subscribers = tuple(s for s in self._subscribers if s is not entry)

        return unsubscribe

    @contextlib.contextmanager
    def listen(self, type_names: Collection[str], match: Match | None = None) -> Iterator[Inbox]:
        """The messages of these types that arrive inside the block."""
        inbox = Inbox()

        def keep(message: Message) -> None:
            if message.get_type() in type_names and (match is None or match(message)):
                inbox.put(message)

        leave = self.subscribe(keep)
        try:
            yield inbox
        finally:
            leave()

    def wait(
        self, type_names: str | Collection[str], timeout_s: float, match: Match | None = None
    ) -> Message | None:
        """The next message of these types, None after `timeout_s`. Raises LinkError when the line broke."""
        names = (type_names,) if isinstance(type_names, str) else type_names
        with self.listen(names, match) as inbox:
            return self.take(inbox, timeout_s)

    def take(self, inbox: Inbox, timeout_s: float) -> Message | None:
        """The next message of a `listen` block, None after `timeout_s`. Raises what broke the line."""
        end = self.clock.monotonic() + timeout_s
        while True:
            if self._failure is not None:
                raise self._failure
            if (message := inbox.pop()) is not None:
                return message
            left = end - self.clock.monotonic()
            if left <= 0:
                return None
            self.clock.wait(inbox.filled, min(left, TICK_S))

    def _tell(self, name: str, message: Message, of_autopilot: bool) -> None:
        """On the receiver thread: a message of the vehicle came."""
        if of_autopilot:
            self._latest[name] = message
        for subscriber, whole_system in self._subscribers:
            if of_autopilot or whole_system:
                subscriber(message)

    # -- asking --------------------------------------------------------------------------------------------

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
                patience_s = timeout_s
                while (ack := self.take(inbox, patience_s)) is not None:
                    if ack.result != mavlink.MAV_RESULT_IN_PROGRESS:
                        return int(ack.result)
                    patience_s = max(timeout_s, LOST_S)
        raise LinkError(self.address, f"command {command_id} was not acknowledged ({tries} tries)")

    def exchange(
        self, request: Message, answer: str, *, timeout_s: float = 0.6, tries: int = 4
    ) -> tuple[Message | None, int]:
        """Send a request until an `answer` comes; (that message or None, how often it was sent again)."""
        with self.listen((answer,)) as inbox:
            for attempt in range(tries):
                self.send(request)
                if (message := self.take(inbox, timeout_s)) is not None:
                    return message, attempt
        return None, tries - 1

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        """Ask for a message at a rate; False when the autopilot will not send it.

        An ArduPilot tells every ground station of a request that it does not know (GCS_Common.cpp,
        set_mavlink_message_id_interval), so of what not every board has (ESCs) it is first asked whether it
        knows it.
        """
        if self.identity.is_ardupilot and message_id in _OF_SOME:
            known = self.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id)
            if known == mavlink.MAV_RESULT_FAILED:
                return False
        interval_us = -1.0 if rate_hz <= 0 else 1e6 / rate_hz
        result = self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
        return result == mavlink.MAV_RESULT_ACCEPTED
