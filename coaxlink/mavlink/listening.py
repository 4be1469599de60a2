"""The hearing half of a session: who wants to know of which messages, and waiting for one."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Collection, Iterator

from coaxlink.mavlink.values import Message

Match = Callable[[Message], bool]
_TICK_S = 0.05


class Ears:
    """Messages on the receiver thread to callbacks, queues and the last of each type; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._failure: BaseException | None = None  # what ended the receiving; raised by the next wait
        self._latest: dict[str, Message] = {}
        self._subscribers: tuple[tuple[Callable[[Message], None], bool], ...] = ()
        self._watchers: tuple[Callable[[bytes], None], ...] = ()

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
    def listen(
        self, type_names: Collection[str], match: Match | None = None
    ) -> Iterator[queue.SimpleQueue[Message]]:
        """A queue of the messages of these types that arrive inside the block."""
        inbox: queue.SimpleQueue[Message] = queue.SimpleQueue()

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
            return self.take_until(inbox, time.monotonic() + timeout_s)

    def take(self, inbox: queue.SimpleQueue[Message], timeout_s: float) -> Message | None:
        """The next message of a `listen` queue, None after `timeout_s`."""
        return self.take_until(inbox, time.monotonic() + timeout_s)

    def watch(self, callback: Callable[[bytes], None]) -> Callable[[], None]:
        """Call back with the frames that `book` keeps: with `subscribe`, all of the vehicle's."""
        self._watchers = (*self._watchers, callback)

        def leave() -> None:
            self._watchers = tuple(w for w in self._watchers if w is not callback)

        return leave

    def take_until(self, inbox: queue.SimpleQueue[Message], end: float) -> Message | None:
        """The next message of a `listen` queue, None at `end` (monotonic). Raises what broke the line."""
        while True:
            if self._failure is not None:
                raise self._failure
            left = end - time.monotonic()
            try:
                return inbox.get(timeout=min(max(left, 0.0), _TICK_S)) if left > 0 else inbox.get_nowait()
            except queue.Empty:
                if left <= 0:
                    return None

    def _tell(self, name: str, message: Message, of_autopilot: bool) -> None:
        """On the receiver thread: a message of the vehicle came."""
        if of_autopilot:
            self._latest[name] = message
        for subscriber, whole_system in self._subscribers:
            if of_autopilot or whole_system:
                subscriber(message)
