"""The newest of all that one vehicle sends, and when it came: one store for mixing, flying, uploads, screen.

Whoever receives calls `hear` with the autopilot's messages. `newest` gives a message as it came, `get` and
`each` quantities, decoded once (a value that is not finite is passed over):

| quantity | unit | from |
|---|---|---|
| attitude | (3,) roll, pitch, yaw, rad | ATTITUDE |
| rates | (3,) rad/s, body | ATTITUDE |
| position, velocity | (3,) m, m/s, NED | LOCAL_POSITION_NED |
| sinking | m/s, down | LOCAL_POSITION_NED, GLOBAL_POSITION_INT, VFR_HUD |
| height | m above ground | DISTANCE_SENSOR that looks down, inside its range |
| home_height | m above home | GLOBAL_POSITION_INT |
| altitude | m above the sea | GLOBAL_POSITION_INT |
| pressure | Pa | HIGHRES_IMU, SCALED_PRESSURE |
| air | degC; a barometer's own is the board's, not the air's | HYGROMETER_SENSOR |
| voltage | V, of the first battery | BATTERY_STATUS, SYS_STATUS |
| remaining | 0..1, of any battery | BATTERY_STATUS, SYS_STATUS |
| battery | `Battery`, each: id, or ON_BOARD for SYS_STATUS | BATTERY_STATUS, SYS_STATUS |
| esc_rpm, esc_current | rpm, A; each: ESC, from 0 | ESC_STATUS, ESC_TELEMETRY_* |
| esc_temperature | degC; each: ESC, from 0 | ESC_INFO, ESC_TELEMETRY_* |
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.clock import SYSTEM
from firmware_params.ardupilot.messages import ESC_TELEMETRY, NAMES
from firmware_params.plain import plain

STALE_S = 2.0  # what is older says nothing of now
ON_BOARD = 256  # the battery of SYS_STATUS: beyond every id
SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
MOST_TEXTS = 500  # that are kept
_LONG = 1000  # characters of one text: a sender may go on for ever
_NO_CELL = 0xFFFF
_NO_TEMPERATURE = 32767  # INT16_MAX, in 0.01 degC
_IMU_PRESSURE = 0x200  # of HIGHRES_IMU.fields_updated
# several of a kind are told apart by this field
_INDEX = {
    "ESC_STATUS": "index",
    "ESC_INFO": "index",
    "SERVO_OUTPUT_RAW": "port",
    "ACTUATOR_CONTROL_TARGET": "group_mlx",
    "BATTERY_STATUS": "id",
    "DISTANCE_SENSOR": "id",
}
_FIRST_ESC = dict(zip(NAMES, ESC_TELEMETRY.values(), strict=True))


class Timed(NamedTuple):
    """A message, or a value that was in one."""

    value: Any
    received_s: float  # of the store's clock
    kind: str  # of the message


@dataclass(frozen=True)
class Battery:
    """What one battery holds; None is not reported, as the 0 V of a power module that is not there."""

    voltage_V: float | None
    current_A: float | None
    remaining: float | None  # 0..1
    charge_state: int = 0  # MAV_BATTERY_CHARGE_STATE
    remaining_s: float = 0.0  # until it is empty; 0 is not reported


@dataclass(frozen=True)
class Text:
    """What the autopilot reported in words."""

    received_s: float
    clock_s: float | None  # the vehicle's time since boot, of its newest stamped message before
    severity: int  # 0 (emergency) .. 7 (debug), MAV_SEVERITY
    text: str

    @property
    def word(self) -> str:
        """The severity in a word."""
        return SEVERITIES[self.severity] if 0 <= self.severity < len(SEVERITIES) else str(self.severity)


class Telemetry:
    """See the module. Heard on one thread, asked on any."""

    def __init__(self, now: Callable[[], float] = SYSTEM.monotonic) -> None:
        self.now = now
        self._lock = Lock()
        self.clear()

    def clear(self) -> None:
        """Forget all: another vehicle, or another place in a recording."""
        with self._lock:
            self.clock_s: float | None = None  # the vehicle's time since boot, of its newest stamped message
            self._messages: dict[str, dict[int, Timed]] = {}
            self._values: dict[str, dict[int, Timed]] = {}
            self._texts: deque[Text] = deque(maxlen=MOST_TEXTS)
            self._piece, self._reported = (
                (0, 0),
                "",
            )  # the last piece of a text: id and number; what there is of it

    def hear(self, message: Any) -> None:
        """Take a message of the autopilot; a session's subscriber."""
        kind, now = message.get_type(), self.now()
        index = int(getattr(message, _INDEX[kind], 0)) if kind in _INDEX else 0
        decode = _DECODERS.get(kind)
        with self._lock:
            self._messages.setdefault(kind, {})[index] = Timed(message, now, kind)
            stamp_ms = getattr(message, "time_boot_ms", None)
            if stamp_ms is not None:
                self.clock_s = stamp_ms / 1000.0
            if kind == "STATUSTEXT":
                self._say(message, now)
            for name, number, value in decode(message) if decode else ():
                if _finite(value):
                    self._values.setdefault(name, {})[number] = Timed(value, now, kind)

    # -- what is known -------------------------------------------------------------------------------------

    def newest(self, kind: str, index: int = 0) -> Timed | None:
        """The newest message of a kind, None if there was none."""
        return self._messages.get(kind, {}).get(index)

    def latest(self, name: str, index: int = 0) -> Timed | None:
        """The newest value of a quantity however old, None if there was none."""
        return self._values.get(name, {}).get(index)

    def each(self, name: str) -> dict[int, Timed]:
        """The newest value of a quantity by its index, in order."""
        with self._lock:
            return dict(sorted(self._values.get(name, {}).items()))

    def get(self, name: str) -> Any:
        """The value of a quantity; None where there is none or it is stale."""
        found = self.latest(name)
        return found.value if found and self.now() - found.received_s <= STALE_S else None

    def age(self, name: str) -> float:
        """Seconds since the value came; 0 where there is none."""
        found = self.latest(name)
        return max(self.now() - found.received_s, 0.0) if found else 0.0

    @property
    def armed(self) -> bool:
        """By the last heartbeat; False before the first."""
        heartbeat = self.newest("HEARTBEAT")
        return heartbeat is not None and bool(heartbeat.value.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def landed_state(self) -> int:
        """MAV_LANDED_STATE however old; UNDEFINED before the first."""
        state = self.newest("EXTENDED_SYS_STATE")
        return int(state.value.landed_state) if state else mavlink.MAV_LANDED_STATE_UNDEFINED

    @property
    def texts(self) -> tuple[Text, ...]:
        """The last MOST_TEXTS things it reported, oldest first."""
        with self._lock:
            return tuple(self._texts)

    def _say(self, message: Any, now: float) -> None:
        """A long text comes in pieces; PX4 ends what is an event as well with a tab."""
        raw = message.text
        words = (raw.decode("utf-8", "replace") if isinstance(raw, bytes) else str(raw)).partition("\0")[0]
        piece = int(message.id), int(message.chunk_seq)
        follows = piece[1] > 0 and piece == (self._piece[0], self._piece[1] + 1)
        self._piece = piece
        self._reported = (self._reported + words)[:_LONG] if follows else words
        text = plain(self._reported.rstrip("\t"), _LONG).strip()
        if follows and self._texts:
            self._texts.append(replace(self._texts.pop(), text=text))
        elif text:
            self._texts.append(Text(now, self.clock_s, int(message.severity), text))


# -- what is in a message: (quantity, index, value) ----------------------------------------------------------

Decoded = Iterator[tuple[str, int, Any]]


def _attitude(m: Any) -> Decoded:
    yield "attitude", 0, (m.roll, m.pitch, m.yaw)
    yield "rates", 0, (m.rollspeed, m.pitchspeed, m.yawspeed)


def _local(m: Any) -> Decoded:
    yield "position", 0, (m.x, m.y, m.z)
    yield "velocity", 0, (m.vx, m.vy, m.vz)
    yield "sinking", 0, m.vz


def _global(m: Any) -> Decoded:
    yield "home_height", 0, m.relative_alt / 1e3
    yield "altitude", 0, m.alt / 1e3
    yield "sinking", 0, m.vz / 100.0


def _distance(m: Any) -> Decoded:
    looks_down = m.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    if looks_down and m.min_distance < m.current_distance < m.max_distance:
        yield "height", 0, m.current_distance / 100.0


def _battery_status(m: Any) -> Decoded:
    yield from _battery(m, m.id, m.voltages, m.charge_state, m.time_remaining)


def _sys_status(m: Any) -> Decoded:
    yield from _battery(m, ON_BOARD, [m.voltage_battery])


def _battery(
    m: Any, number: int, cells_mV: list[int], charge_state: int = 0, remaining_s: int = 0
) -> Decoded:
    voltage = sum(v for v in cells_mV if 0 < v < _NO_CELL) / 1e3 or None
    current = m.current_battery / 100.0 if m.current_battery >= 0 else None
    remaining = m.battery_remaining / 100.0 if m.battery_remaining >= 0 else None
    yield "battery", number, Battery(voltage, current, remaining, charge_state, max(float(remaining_s), 0.0))
    if voltage is not None and number in (0, ON_BOARD):
        yield "voltage", 0, voltage
    if remaining is not None:
        yield "remaining", 0, remaining


def _highres_imu(m: Any) -> Decoded:
    if m.fields_updated & _IMU_PRESSURE:
        yield "pressure", 0, 100.0 * m.abs_pressure


def _esc_status(m: Any) -> Decoded:
    for k in range(4):
        yield "esc_rpm", m.index + k, float(m.rpm[k])
        yield "esc_current", m.index + k, float(m.current[k])


def _esc_info(m: Any) -> Decoded:
    for k, hundredths in enumerate(m.temperature):
        if hundredths not in (0, _NO_TEMPERATURE):  # an ESC that does not measure sends 0
            yield "esc_temperature", m.index + k, hundredths / 100.0


def _esc_telemetry(m: Any) -> Decoded:
    first = _FIRST_ESC[m.get_type()]
    for k in range(4):
        yield "esc_rpm", first + k, float(m.rpm[k])
        yield "esc_current", first + k, m.current[k] / 100.0
        if m.temperature[k]:
            yield "esc_temperature", first + k, float(m.temperature[k])


_DECODERS: dict[str, Callable[[Any], Decoded]] = {
    "ATTITUDE": _attitude,
    "LOCAL_POSITION_NED": _local,
    "GLOBAL_POSITION_INT": _global,
    "VFR_HUD": lambda m: iter((("sinking", 0, -m.climb),)),
    "DISTANCE_SENSOR": _distance,
    "BATTERY_STATUS": _battery_status,
    "SYS_STATUS": _sys_status,
    "HIGHRES_IMU": _highres_imu,
    "SCALED_PRESSURE": lambda m: iter((("pressure", 0, 100.0 * m.press_abs),)),
    "HYGROMETER_SENSOR": lambda m: iter((("air", 0, m.temperature / 100.0),)),
    "ESC_STATUS": _esc_status,
    "ESC_INFO": _esc_info,
    **dict.fromkeys(NAMES, _esc_telemetry),
}


def _finite(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(math.isfinite, value))
    return not isinstance(value, float) or math.isfinite(value)
