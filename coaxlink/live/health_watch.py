"""Rotors' health beside the live mixer: a thread of its own that tells, and commands nothing by itself.

The session's receiver only puts messages and the commands of that moment into a queue (bounded: what is not
fetched in time is lost, and the test sees a gap); the test runs in this thread, twenty times a second. Judged
is what our own commands did: while the autopilot's mixer flies, in a fade and in a dry run nothing is judged.
The law, the guard and their states are not touched.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CoaxlinkError
from coaxlink.live.guard import LIVE
from coaxlink.live.in_air import InAir, short
from coaxlink.premises.answer import as_json

if TYPE_CHECKING:
    from coaxlink.live.mixer import LiveMixer

POLL_S = 0.05
WAITING = 512  # messages: some seconds of them
RATES = ("HIGHRES_IMU", "ATTITUDE", "ATTITUDE_QUATERNION")
HEARD = frozenset({"HEARTBEAT", "EXTENDED_SYS_STATE", "RAW_IMU", "SCALED_IMU", "SYS_STATUS", *RATES})
JUDGED_HZ = 50.0  # of what the rotors are judged by
ASK_AFTER_S = 2.0  # streams that come by themselves have come by then


class HealthWatch:
    """Around a mixer's flight; `say` gets every call, again once its size is settled, or why none."""

    def __init__(self, live: LiveMixer, say: Callable[[str], None]) -> None:
        self._live, self._say = live, say
        self._reasons: set[str] = set()  # that were reported
        self.in_air = InAir(live.core.vehicle)
        self.problem = ""  # why it watches no longer
        self._queue: deque[tuple[Any, int, tuple[float, ...]]] = deque(maxlen=WAITING)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="coaxlink-health", daemon=True)
        self._unsubscribe: Callable[[], None] | None = None

    def listen(self) -> None:
        """Hear what the vehicle says from now on; `work` judges it."""
        self._unsubscribe = self._live.session.subscribe(self._hear)

    def __enter__(self) -> HealthWatch:
        self.listen()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._unsubscribe is not None:
            self._unsubscribe()
        self._stopping.set()
        self._thread.join(1.0)

    def _hear(self, message: Any) -> None:
        """On the receiver's thread: nothing but an append."""
        if message.get_type() in HEARD:
            live = self._live
            flown = live.guard.state == LIVE and not live.dry_run
            stamp = (live.core.last_us or 0) if flown else 0
            self._queue.append((message, stamp, tuple(live.core.sent[: live.core.count]) if stamp else ()))

    def _run(self) -> None:
        try:
            self._ask()
            while not self._stopping.wait(POLL_S):
                self.work()
        except Exception as error:  # whatever it is, the vehicle flies on
            self.problem = str(error) or type(error).__name__

    def work(self) -> None:
        """Judge what was heard since the last time."""
        while self._queue:
            self._one(*self._queue.popleft())

    def _one(self, message: Any, stamp_us: int, commands: tuple[float, ...]) -> None:
        if stamp_us:
            self.in_air.commanded(stamp_us * 1e-6, commands)
        call = self.in_air.heard(message)
        if call is not None:
            self.tell(call.text, mavlink.MAV_SEVERITY_CRITICAL, call.text)
        for reason in self.in_air.reasons:
            if short(reason) not in self._reasons:
                self._reasons.add(short(reason))
                self.tell(short(reason), mavlink.MAV_SEVERITY_WARNING, reason.line())

    def _ask(self) -> None:
        """For rates where none come by themselves, or too slowly (an ArduPilot sends nothing unasked)."""
        if self._stopping.wait(ASK_AFTER_S):
            return
        session = self._live.session
        wanted = {"EXTENDED_SYS_STATE": 2.0} if session.latest("EXTENDED_SYS_STATE") is None else {}
        if self.in_air.slow or not any(session.latest(name) for name in RATES):
            names = ("HIGHRES_IMU",) if session.identity.is_px4 else ("ATTITUDE", "RAW_IMU")
            wanted |= dict.fromkeys(names, JUDGED_HZ)
        for name, rate_hz in wanted.items():
            try:
                session.request_stream(getattr(mavlink, f"MAVLINK_MSG_ID_{name}"), rate_hz)
            except CoaxlinkError:
                return

    def tell(self, text: str, severity: int, words: str) -> None:
        """STATUSTEXT to the vehicle, for its log and those it forwards to; `words` to whoever flies it."""
        self._live.session.send(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))
        self._say(words)

    def account(self) -> dict[str, Any]:
        """For the JSON of `coaxlink mix`."""
        now = self.in_air.now
        return {
            "word": now.word or None,
            "why": self.problem or now.why,
            "calls": [call.to_json() for call in now.calls],
            **as_json(now.reasons),
        }
