"""All that was heard of one vehicle: newest telemetry, parameters, and how well the line carries it.

`take` runs on the thread that receives; everything else may be asked on any thread. Times are those of the
clock passed in and only tell how old something is; the vehicle's own time (`telemetry.clock_s`) is what the
plots use, as a simulator may run faster than we do.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.clock import SYSTEM
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mavlink.values import decode, is_bytewise
from firmware_params.plain import is_parameter_name

MOST_PARAMETERS = 10_000  # an autopilot has some 1200; a flood of invented names ends here
WINDOW_S = 5.0  # rate and loss are those of the last five seconds


@dataclass(frozen=True)
class Traffic:
    """Messages of the vehicle over the last WINDOW_S seconds, and since the start."""

    rate_hz: float = 0.0
    loss: float | None = None  # 0..1, from gaps in the sequence numbers; None without messages
    received: int = 0
    missed: int = 0
    disorder: float = 0.0  # 0..1, share that came out of sequence: much of it means two senders of one id


class Heard:
    """See the module. Nothing is taken before `follow` says of whom."""

    def __init__(self, now: Callable[[], float] = SYSTEM.monotonic) -> None:
        self.now = now
        self.telemetry = Telemetry(now)
        self.listener: Callable[[Any], None] | None = None  # of the autopilot's messages, once folded in
        self.waiting = ""  # what the link waits for
        self.line: Callable[[], list[str]] = list  # what is to be known of the line, or of the recording
        self.begun = 0  # how often all was forgotten: another vehicle, another place of a recording
        self.unheard: Callable[[], str] = str  # why the autopilot's words do not arrive
        self._lock = Lock()
        self._forget(None)

    def _forget(self, target: tuple[int, int] | None) -> None:
        self.telemetry.clear()
        self.begun += 1
        self.target = target  # (system, component)
        self.others: tuple[int, ...] = ()  # further systems whose autopilots are heard here
        self.parameters: Mapping[str, float] = {}  # replaced as a whole, never changed
        self.last_s: float | None = None  # when the newest message came
        self._sequence: dict[int, int] = {}  # component -> last sequence number
        self._recent: deque[tuple[float, int, bool]] = deque()  # time, missed before it, out of order
        self._received = self._missed = 0

    def follow(self, system: int, component: int, *, anew: bool = False) -> None:
        """Watch this autopilot from now on. What another one sent is forgotten, and with `anew` its own."""
        if anew or self.target != (system, component):
            with self._lock:
                self._forget((system, component))

    def take(self, message: Any, *, counted: bool = True) -> None:
        """Fold one message in; `counted` is False for one of before we listened to all of them."""
        if self.target is None:
            return
        kind, system, component = message.get_type(), message.get_srcSystem(), message.get_srcComponent()
        if system != self.target[0]:
            if kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self.others = tuple(sorted({*self.others, system}))
            return
        if counted:
            self._count(message.get_seq(), component)
        if component != self.target[1] or kind.startswith("UNKNOWN"):
            return  # a gimbal of the same vehicle, or of another dialect: part of the traffic only
        self.last_s = self.now()
        self.telemetry.hear(message)
        if kind == "PARAM_VALUE":
            self._parameter(message)
        if self.listener is not None:
            self.listener(message)

    def put_parameters(self, values: Mapping[str, float], replace_prefix: str = "") -> None:
        """Take parameters read elsewhere; those under `replace_prefix` that are not among them go."""
        with self._lock:
            kept = self.parameters
            if replace_prefix:
                kept = {n: v for n, v in kept.items() if not n.startswith(replace_prefix)}
            self.parameters = {**kept, **values}

    @property
    def traffic(self) -> Traffic:
        """As of now."""
        with self._lock:
            self._drop_old()
            received, missed = len(self._recent), sum(missed for _, missed, _ in self._recent)
            # in the first seconds the window is only as long as we have listened
            span = min(WINDOW_S, max(self.now() - self._recent[0][0], 1.0)) if received else WINDOW_S
            disorder = sum(back for *_, back in self._recent) / received if received else 0.0
            loss = missed / (received + missed) if received else None
            return Traffic(received / span, loss, self._received, self._missed, disorder)

    def _parameter(self, message: Any) -> None:
        heartbeat = self.telemetry.newest("HEARTBEAT")
        if heartbeat is None:
            return
        value = decode(message, is_bytewise(heartbeat.value.autopilot))
        if is_parameter_name(value.name) and len(self.parameters) < MOST_PARAMETERS:
            self.put_parameters({value.name: float(value.value)})

    def _count(self, sequence: int, component: int) -> None:
        with self._lock:
            previous = self._sequence.get(component)
            self._sequence[component] = sequence
            gap = 0 if previous is None else (sequence - previous - 1) % 256
            back = gap > 127  # out of order, doubled, or the sender restarted: not a loss
            self._received += 1
            self._missed += 0 if back else gap
            self._recent.append((self.now(), 0 if back else gap, back))
            self._drop_old()

    def _drop_old(self) -> None:
        while self._recent and self._recent[0][0] < self.now() - WINDOW_S:
            self._recent.popleft()
