"""Requests in the air: a window of them at a time, each repeated until it is answered.

How long an answer takes is learnt as TCP does (RFC 6298: mean and spread, from requests sent once). A second
answer to a repeated request means that the repeat was hasty; then the patience grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from coaxlink.mavlink.requests import Inbox
from coaxlink.mavlink.session import Message, Session

_SHORTEST_S = 0.04  # waits are never shorter, whatever was learnt
_JITTER_S = 0.02
_GROWTH = 1.1  # of the wait, from one try to the next
_BY_CHANCE = 1e-6  # silence that is no accident
_LEAST_LOSS, _MOST_LOSS = 0.06, 0.75

Key = TypeVar("Key", bound=Hashable)


class Pace:
    """How long to wait for an answer."""

    def __init__(self, most_s: float) -> None:
        self.most_s = most_s  # before anything is known, and at most for a first try
        self._mean_s, self._spread_s, self._patience = 0.0, 0.0, 1.0

    def took(self, seconds: float) -> None:
        """An answer came so long after its only request."""
        if not self._mean_s:
            self._mean_s, self._spread_s = seconds, 0.5 * seconds
        else:
            self._spread_s = 0.75 * self._spread_s + 0.25 * abs(self._mean_s - seconds)
            self._mean_s = 0.875 * self._mean_s + 0.125 * seconds
        self._patience = max(1.0, 0.97 * self._patience)

    def hasty(self) -> None:
        """A repeat was answered although the first request was, too."""
        self._patience = min(1.2 * self._patience, 20.0)

    def wait_s(self, attempt: int) -> float:
        """How long to wait after the `attempt`-th repeat (0: the first request)."""
        first = self.most_s
        if self._mean_s:
            learnt = self._patience * (self._mean_s + 4.0 * self._spread_s + _JITTER_S)
            first = min(max(learnt, _SHORTEST_S), self.most_s)
        return min(first * _GROWTH**attempt, 2.5 * self.most_s)


@dataclass(frozen=True)
class _Due:
    """A request in the air."""

    first: float  # sent
    when: float  # to be asked again
    tries: int


class Asker:
    """Sends requests and sorts their answers; `retries` counts requests that were repeated."""

    def __init__(self, session: Session, *, timeout_s: float, window: int) -> None:
        self._session, self._window, self._clock = session, window, session.clock
        self.pace = Pace(timeout_s)
        if session.answer_s:
            self.pace.took(min(session.answer_s, timeout_s))
        self.retries = 0

    def gather(
        self,
        requests: Mapping[Key, Callable[[], Message]],
        answers: Collection[str],
        settle: Callable[[Message], Key | None],
        *,
        patience: float = 8.0,
    ) -> list[Key]:
        """Ask for every key until settled; the keys that were not, after enough tries and time.

        `patience` is that time in first waits, short where silence is an answer. `settle` gets each message
        of the types `answers` and returns the key it settles; it may raise.
        """
        waiting = list(requests)
        due: dict[Key, _Due] = {}
        repeated: set[Key] = set()
        given_up: list[Key] = []
        with self._session.listen(answers) as inbox:
            while waiting or due:
                now = self._clock.monotonic()
                for key in [k for k, request in due.items() if request.when <= now]:
                    if self._enough(due[key], now, patience):
                        given_up.append(key)
                        del due[key]
                        continue
                    self.retries += 1
                    repeated.add(key)
                    self._session.send(requests[key]())
                    due[key] = _Due(
                        due[key].first, now + self.pace.wait_s(due[key].tries), due[key].tries + 1
                    )
                while waiting and len(due) < self._window:
                    key = waiting.pop(0)
                    self._session.send(requests[key]())
                    due[key] = _Due(now, now + self.pace.wait_s(0), 1)
                if due:
                    self._drain(inbox, due, repeated, settle)
        return given_up

    def tries(self) -> int:
        """Requests after which silence means something, at the loss the link shows."""
        both_ways = 1.0 - (1.0 - self._session.loss) ** 2
        share = min(max(both_ways, _LEAST_LOSS), _MOST_LOSS)
        return math.ceil(math.log(_BY_CHANCE) / math.log(share))

    def _enough(self, request: _Due, now: float, patience: float) -> bool:
        return request.tries >= self.tries() and now - request.first >= patience * self.pace.most_s

    def _drain(
        self,
        inbox: Inbox,
        due: dict[Key, _Due],
        repeated: set[Key],
        settle: Callable[[Message], Key | None],
    ) -> None:
        soonest = min(request.when for request in due.values())
        message = self._session.take(inbox, max(0.0, soonest - self._clock.monotonic()))
        while message is not None:
            key = settle(message)
            request = due.pop(key, None) if key is not None else None
            if request and request.tries == 1:
                self.pace.took(self._clock.monotonic() - request.first)
            elif key is not None and not request and key in repeated:
                repeated.discard(key)
                self.pace.hasty()
            message = self._session.take(inbox, 0.0) if due else None
