"""What came over the link: the newest message of each kind, when it came, how many were lost.

`Collector.take` runs on the link's receiver thread; `Collector.readings` hands out a frozen copy.
Arrival times are this machine's monotonic clock and serve only to tell how old something is; the
vehicle's own time (`Readings.clock_s`) is what the plots use, as a simulator may run faster than we do.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from types import MappingProxyType
from typing import Any

from coaxlink.monitor.telemetry.texts import Said, Texts
from firmware_params.plain import is_parameter_name

AUTOPILOT_INVALID = 8  # MAV_AUTOPILOT_INVALID: a ground station, a companion, a camera
AUTOPILOT_PX4 = 12  # MAV_AUTOPILOT_PX4: sends integers bytewise in the float field
MOST_PARAMETERS = 10_000  # an autopilot has some 1200; a flood of invented names ends here
WINDOW_S = 5.0  # rate and loss are those of the last five seconds
_BIN_S = 0.25
_BATCHED = {
    "ESC_STATUS": "index",
    "ESC_INFO": "index",
    "SERVO_OUTPUT_RAW": "port",
    "ACTUATOR_CONTROL_TARGET": "group_mlx",
    "BATTERY_STATUS": "id",
    "DISTANCE_SENSOR": "id",
}
_INTEGER_FORMAT = {1: "<B3x", 2: "<b3x", 3: "<H2x", 4: "<h2x", 5: "<I", 6: "<i"}  # MAV_PARAM_TYPE


@dataclass(frozen=True)
class Arrival:
    """One message and when it came (monotonic seconds)."""

    message: Any
    received_s: float


@dataclass(frozen=True)
class Traffic:
    """Messages of the watched autopilot over the last WINDOW_S seconds, and since the start."""

    rate_hz: float = 0.0
    loss: float | None = None  # 0..1, from gaps in the sequence numbers; None without messages
    received: int = 0
    missed: int = 0
    disorder: float = 0.0  # 0..1, share that came out of sequence: much of it means two senders of one id


@dataclass(frozen=True)
class Readings:
    """Everything heard so far, at one moment."""

    target: tuple[int, int] | None = None  # (system, component) of the watched autopilot
    others: tuple[int, ...] = ()  # further systems that send autopilot heartbeats here
    latest: Mapping[str, Arrival] = field(default_factory=dict)  # "ATTITUDE", "ESC_STATUS[4]", ...
    parameters: Mapping[str, float] = field(default_factory=dict)  # every PARAM_VALUE heard, decoded
    traffic: Traffic = Traffic()
    last_s: float | None = None  # arrival of the newest message of the target
    clock_s: float | None = None  # the vehicle's own time since boot, of its newest stamped message
    texts: tuple[Said, ...] = ()  # oldest first

    def get(self, key: str) -> Arrival | None:
        """The newest message under `key`, or None."""
        return self.latest.get(key)

    def batches(self, kind: str) -> dict[int, Arrival]:
        """Newest message of each index of a batched kind: {0: ..., 4: ...} for ESC_STATUS."""
        found = {}
        for key, arrival in self.latest.items():
            if key.startswith(f"{kind}["):
                found[int(key[len(kind) + 1 : -1])] = arrival
        return dict(sorted(found.items()))


def key_of(message: Any) -> str:
    """Under which key a message is kept: its type, with its index where one kind comes in batches."""
    kind: str = message.get_type()
    part = _BATCHED.get(kind)
    return kind if part is None else f"{kind}[{int(getattr(message, part, 0))}]"


def parameter_value(message: Any, bytewise: bool) -> float:
    """The number in a PARAM_VALUE; `bytewise` when integers travel as raw bytes (PX4)."""
    layout = _INTEGER_FORMAT.get(int(message.param_type)) if bytewise else None
    if layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


class Collector:
    """Folds messages into `Readings`; locks on to the first autopilot heard. Thread-safe."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._target: tuple[int, int] | None = None
        self._others: set[int] = set()
        self._latest: dict[str, Arrival] = {}
        self._parameters: dict[str, float] = {}
        self._sequence: dict[int, int] = {}  # component -> last sequence number
        self._bins: deque[list[float]] = deque()  # [start_s, received, missed, out of order]
        self._received = self._missed = 0
        self._last_s: float | None = None
        self._clock_s: float | None = None
        self._texts = Texts()
        self.listener: Callable[[Any], None] | None = None  # of every message of the target, once folded in

    def take(self, message: Any, received_s: float, *, counted: bool = True) -> None:
        """Fold one message in; `counted` is False for one of before we listened to all of them."""
        kind = message.get_type()
        if kind == "BAD_DATA" or kind.startswith("UNKNOWN"):
            return
        system, component = message.get_srcSystem(), message.get_srcComponent()
        with self._lock:
            if kind == "HEARTBEAT" and message.autopilot != AUTOPILOT_INVALID:
                if self._target is None:
                    self._target = (system, component)
                elif self._target[0] != system:
                    self._others.add(system)
            if self._target is None or self._target[0] != system:
                return
            if counted:
                self._count(message.get_seq(), component, received_s)
            if component != self._target[1]:
                return  # a gimbal or companion of the same vehicle: part of the traffic, not of the picture
            self._last_s = received_s
            self._latest[key_of(message)] = Arrival(message, received_s)
            stamp = getattr(message, "time_boot_ms", None)
            if stamp is not None:
                self._clock_s = stamp / 1000.0
            if kind == "STATUSTEXT":
                self._texts.take(message, received_s, self._clock_s)
            if kind == "PARAM_VALUE":
                heartbeat = self._latest.get("HEARTBEAT")
                bytewise = heartbeat is not None and heartbeat.message.autopilot == AUTOPILOT_PX4
                name = str(message.param_id)
                if is_parameter_name(name) and len(self._parameters) < MOST_PARAMETERS:
                    self._parameters[name] = parameter_value(message, bytewise)
        if self.listener is not None:
            self.listener(message)

    def follow(self, system: int, component: int) -> None:
        """Watch this autopilot from now on; what another one said is forgotten."""
        with self._lock:
            if self._target == (system, component):
                return
            if self._target is not None:
                self._latest.clear()
                self._parameters.clear()
                self._texts.clear()
                self._clock_s = None
            self._target = (system, component)
            self._others.discard(system)

    def put_parameters(self, values: Mapping[str, float], replace_prefix: str = "") -> None:
        """Take parameters read elsewhere; those under `replace_prefix` that are not among them go."""
        with self._lock:
            if replace_prefix:
                for name in [n for n in self._parameters if n.startswith(replace_prefix)]:
                    del self._parameters[name]
            self._parameters.update(values)

    def clear(self) -> None:
        """Forget everything, also whom to watch: a replay begins elsewhere."""
        with self._lock:
            self._target, self._last_s, self._clock_s = None, None, None
            for store in (
                self._others,
                self._latest,
                self._parameters,
                self._sequence,
                self._bins,
                self._texts,
            ):
                store.clear()

    def pass_by(self, system: int, component: int, sequence: int, received_s: float) -> None:
        """Count a message that nobody here can read: it did not get lost."""
        with self._lock:
            if self._target is not None and self._target[0] == system:
                self._count(sequence, component, received_s)

    def readings(self, now_s: float) -> Readings:
        """A frozen copy of what is known at `now_s`."""
        with self._lock:
            while self._bins and self._bins[0][0] < now_s - WINDOW_S:
                self._bins.popleft()
            received = sum(b[1] for b in self._bins)
            missed = sum(b[2] for b in self._bins)
            # in the first seconds the window is only as long as we have listened
            span = min(WINDOW_S, max(now_s - self._bins[0][0], 1.0)) if self._bins else WINDOW_S
            loss = missed / (received + missed) if received else None
            disorder = sum(b[3] for b in self._bins) / received if received else 0.0
            return Readings(
                self._target,
                tuple(sorted(self._others)),
                MappingProxyType(dict(self._latest)),
                MappingProxyType(dict(self._parameters)),
                Traffic(received / span, loss, self._received, self._missed, disorder),
                self._last_s,
                self._clock_s,
                self._texts.all(),
            )

    def _count(self, sequence: int, component: int, received_s: float) -> None:
        previous = self._sequence.get(component)
        self._sequence[component] = sequence
        gap = 0 if previous is None else (sequence - previous - 1) % 256
        back = gap > 127
        if back:
            gap = 0  # out of order, doubled, or the sender restarted: not a loss
        self._received += 1
        self._missed += gap
        if not self._bins or received_s - self._bins[-1][0] >= _BIN_S:
            self._bins.append([received_s, 0, 0, 0])
        self._bins[-1][1] += 1
        self._bins[-1][2] += gap
        self._bins[-1][3] += back
