"""A recording as messages on one clock: a tlog as it was recorded, a ULog or DataFlash log as an autopilot
would have sent it.

A tlog is played by its recorder's clock, which is when messages came. The other two hold samples rather than
messages: their columns (`data.flight`) become the messages the monitor reads, at most RATE_HZ of each, motor
commands as ACTUATOR_OUTPUT_STATUS without rounding. What such a log does not hold is not shown.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

import firmware_params.ardupilot.messages  # noqa: F401 - teaches the dialect ESC_TELEMETRY_*
from coaxlink.data.logs.flight import MOTOR, log_kind, read_flight_log
from coaxlink.data.logs.tlog import stamped_frames
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.monitor.telemetry.modes import NO_MODE
from coaxlink.monitor.telemetry.readings import AUTOPILOT_INVALID, AUTOPILOT_PX4, Collector
from firmware_params.px4.messages import MAVLink_esc_status_message

RATE_HZ = 50.0
GAP_S = (
    60.0  # a recorder's clock that stands, or jumps by more than this, is taken to have gone on by so much
)
_TEXT = 253  # STATUSTEXT
_KEPT = {22, _TEXT}  # PARAM_VALUE too: told once, and still true later
_STAMPED = {30, 32, 33}  # ATTITUDE and positions, which carry the time since boot
_ARDUPILOT = 3


class Tape:
    """A tlog. `length_s` is its length, `notes` what must be known to trust it."""

    def __init__(self, path: Path) -> None:
        """Raises InputError."""
        self.name = path.name
        self.notes: tuple[str, ...] = ()
        self._times: list[float] = []
        self._frames: list[bytes] = []
        now, last = 0.0, None
        for stamp_us, frame in stamped_frames(path):
            step = 0.0 if last is None else (stamp_us - last) / 1e6
            now += min(max(step, 0.0), GAP_S)
            last = stamp_us
            self._times.append(now)
            self._frames.append(frame)
        if not self._times:
            raise InputError(path, "", "no MAVLink frame in this tlog")
        self.length_s = self._times[-1]
        senders = [_autopilot(frame) for frame in self._frames]
        self._target = next((who for who in senders if who), None)
        if self._target is None:
            raise InputError(path, "", "no heartbeat of an autopilot in this tlog")
        self._lasting_indices = self._lasting()
        self._beats = [k for k, who in enumerate(senders) if who == self._target]

    def _lasting(self) -> list[int]:
        """Where parameters and texts are, and before each text what tells its time on the vehicle."""
        lasting: list[int] = []
        stamped: int | None = None
        for k, frame in enumerate(self._frames):
            number = _number(frame)
            if number in _STAMPED and _header(frame)[1:] == self._target:
                stamped = k
            elif number in _KEPT:
                if number == _TEXT and stamped is not None and stamped not in lasting[-1:]:
                    lasting.append(stamped)
                lasting.append(k)
        return lasting

    def begin(self, collector: Collector) -> None:
        """Forget what was played before."""
        collector.clear()
        assert self._target is not None
        collector.follow(*self._target)
        self._give(collector, self._beats[0], mavlink.MAVLink(None), counted=False)

    def play(self, collector: Collector, from_s: float, to_s: float, *, only_lasting: bool = False) -> None:
        """Give `collector` what came in [from_s, to_s); `only_lasting`: parameters and texts only."""
        parser = mavlink.MAVLink(None)
        first, end = bisect_left(self._times, from_s), bisect_left(self._times, to_s)
        indices: Sequence[int] = range(first, end)
        if only_lasting:  # the last heartbeat goes before: it says how parameters are to be read
            beat = bisect_left(self._beats, end)
            lasting = self._lasting_indices[
                bisect_left(self._lasting_indices, first) : bisect_left(self._lasting_indices, end)
            ]
            indices = [*self._beats[max(beat - 1, 0) : beat], *lasting]
        for k in indices:
            self._give(collector, k, parser, counted=not only_lasting)

    def _give(self, collector: Collector, k: int, parser: Any, *, counted: bool) -> None:
        frame = self._frames[k]
        if _number(frame) not in mavlink.mavlink_map:
            if counted:
                sequence, system, component = _header(frame)
                collector.pass_by(system, component, sequence, self._times[k])
            return
        try:
            message = parser.decode(bytearray(frame))
        except mavlink.MAVError:
            return  # garbled on its way: a loss
        collector.take(message, self._times[k], counted=counted)


@dataclass
class SampleTape:
    """A log of samples."""

    name: str
    samples: Samples
    autopilot: int
    parameters: Mapping[str, float]
    texts: list[tuple[float, int, str]] = field(default_factory=list)  # time_s of the log, severity, words

    def __post_init__(self) -> None:
        """Raises InputError."""
        time = self.samples["time_s"]
        self._start = float(time[0])
        self.length_s = float(time[-1]) - self._start
        rows = len(time)
        step = max(round(rows / max(self.length_s * RATE_HZ, 1.0)), 1)
        self._rows = np.arange(0, rows, step)
        self._times = (time[self._rows] - self._start).tolist()
        names = self.samples.columns
        self._motors = sum(MOTOR.fullmatch(name) is not None for name in names)
        self._rpm = max((int(name[3:]) for name in names if name.startswith("rpm")), default=0)
        self.notes = ("a log of samples: link, mode and current are not in it", *self.samples.notes)

    def begin(self, collector: Collector) -> None:
        """As `Tape.begin`."""
        collector.clear()
        collector.follow(1, 1)
        collector.put_parameters(self.parameters)

    def play(self, collector: Collector, from_s: float, to_s: float, *, only_lasting: bool = False) -> None:
        """As `Tape.play`."""
        if not only_lasting:
            for k in range(bisect_left(self._times, from_s), bisect_left(self._times, to_s)):
                for message in self._messages(int(self._rows[k])):
                    self._send(collector, message, self._times[k])
        for time_s, severity, text in self.texts:
            at = max(time_s - self._start, 0.0)
            if from_s <= at < to_s:
                self._send(collector, mavlink.MAVLink_statustext_message(severity, text.encode()), at)

    def _send(self, collector: Collector, message: Any, at_s: float) -> None:
        message.get_srcSystem = message.get_srcComponent = lambda: 1
        collector.take(message, at_s, counted=False)

    def _value(self, name: str, row: int, default: float = math.nan) -> float:
        column = self.samples.columns.get(name)
        return default if column is None else float(column[row])

    def _heartbeat(self, row: int) -> Any:
        armed = self._value("armed", row, 1.0) > 0.5
        return mavlink.MAVLink_heartbeat_message(2, self.autopilot, 128 if armed else 0, NO_MODE, 4, 3)

    def _messages(self, row: int) -> Iterator[Any]:
        boot_ms = round(1e3 * float(self.samples["time_s"][row])) & 0xFFFFFFFF
        yield self._heartbeat(row)
        roll, pitch, yaw = (self._value(f"{a}_rad", row) for a in ("roll", "pitch", "yaw"))
        yield mavlink.MAVLink_attitude_message(boot_ms, roll, pitch, yaw, 0.0, 0.0, 0.0)
        commands = [self._value(f"motor{n}", row) for n in range(1, self._motors + 1)]
        padded = [*commands, *[0.0] * (32 - len(commands))]
        yield mavlink.MAVLink_actuator_output_status_message(boot_ms, (1 << self._motors) - 1, padded)
        for first in range(0, self._rpm, 4):
            rpm = [self._value(f"rpm{first + k + 1}", row) for k in range(4)]
            yield MAVLink_esc_status_message(first, 0, rpm, [0.0] * 4, [0.0] * 4)  # type: ignore[arg-type]
        if self.samples.has("height_m"):
            vn, ve, vd = (self._value(f"vel_{a}_m_s", row) for a in "ned")
            down = -self._value("height_m", row)
            yield mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, down, vn, ve, vd)
        if self.samples.has("voltage_V"):
            cells = [min(round(1e3 * self._value("voltage_V", row)), 65534), *[65535] * 9]
            yield mavlink.MAVLink_battery_status_message(0, 0, 0, 32767, cells, -1, -1, -1, -1)
        if self.samples.has("landed"):
            state = 1 if self._value("landed", row) > 0.5 else 2
            yield mavlink.MAVLink_extended_sys_state_message(0, state)


def load_tape(path: Path) -> Tape | SampleTape:
    """A recording by its content. Raises InputError for what is none."""
    kind = log_kind(path)
    if kind == "tlog":
        return Tape(path)
    if kind == "ulog":
        from coaxlink.data.logs.ulog import ulog_parameters, ulog_texts

        parameters = {name: float(value) for name, value in ulog_parameters(path).items()}
        return SampleTape(path.name, read_flight_log(path), AUTOPILOT_PX4, parameters, ulog_texts(path))
    if kind == "dataflash":
        from coaxlink.data.logs.dataflash import dataflash_parameters, dataflash_texts

        texts = [(time_s, 6, text) for time_s, text in dataflash_texts(path)]
        return SampleTape(path.name, read_flight_log(path), _ARDUPILOT, dataflash_parameters(path), texts)
    raise InputError(path, "", "a tlog, a ULog or a DataFlash log (.bin) is expected, found text")


def _number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == 0xFD else frame[5]


def _autopilot(frame: bytes) -> tuple[int, int] | None:
    """(system, component) of a frame that is an autopilot's heartbeat."""
    at = (10 if frame[0] == 0xFD else 6) + 5
    if _number(frame) or len(frame) <= at or frame[at] == AUTOPILOT_INVALID:
        return None
    return _header(frame)[1:]


def _header(frame: bytes) -> tuple[int, int, int]:
    """Sequence, system, component."""
    at = 4 if frame[0] == 0xFD else 2
    return frame[at], frame[at + 1], frame[at + 2]
