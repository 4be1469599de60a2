"""Recordings as messages on one clock: a tlog as it was recorded, a ULog or DataFlash log as an autopilot
would have sent it. A player brings them to what is heard, at any speed, from anywhere.

A tlog is played by its recorder's clock, which is when messages came. The other two hold samples rather than
messages: their columns (`data.flight`) become the messages the monitor reads, at most RATE_HZ of each, motor
commands as ACTUATOR_OUTPUT_STATUS without rounding. What such a log does not hold is not shown.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

import firmware_params.ardupilot.messages  # noqa: F401 - teaches the dialect ESC_TELEMETRY_*
from coaxlink.data.logs.flight import MOTOR, log_kind, read_flights
from coaxlink.data.logs.mavlink_frames import stamped_frames
from coaxlink.data.logs.tlog import FLIGHT_MESSAGES, chosen, flight_numbers
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.frames import IMU_COLUMNS
from coaxlink.mavlink.clock import SYSTEM
from coaxlink.mavlink.modes import NO_MODE
from coaxlink.monitor.incoming.heard import Heard
from firmware_params.px4.messages import MAVLink_esc_status_message

RATE_HZ = 50.0
GAP_S = 60.0  # a recorder's clock that stands, or jumps by more, is taken to have gone on by so much
WARM_S = 10.0  # what is played before the place that is sought: rarer messages are older than is shown
MOST_AHEAD_S = 60.0  # a step of more than this is a leap
SLOWEST, FASTEST = 1 / 64, 1024.0
_TEXT = 253  # STATUSTEXT
UNSTATED = 6  # severity of texts whose log has none
_KEPT = {22, _TEXT}  # PARAM_VALUE too: sent once, and still true later
_STAMPED = {30, 32, 33}  # ATTITUDE and positions, which carry the time since boot


class Recording(Protocol):
    """What can be played."""

    name: str
    length_s: float
    notes: tuple[str, ...]  # what must be known to trust it
    target: tuple[int, int]
    parameters: Mapping[str, float]  # known before the first message

    flights: Sequence[Samples]  # the same as columns, where they can be had

    def before(self, to_s: float) -> Iterator[tuple[float, Any]]:
        """(s from the start, message) of parameters and texts in [0, to_s), which last."""

    def between(self, from_s: float, to_s: float) -> Iterator[tuple[float, Any]]:
        """(s from the start, message) of all in [from_s, to_s)."""


class Player:
    """Brings a recording to `heard`, whose clock is the player's `now`; it stops at the end."""

    def __init__(
        self,
        recording: Recording,
        *,
        speed: float = 1.0,
        start_s: float = 0.0,
        clock: Callable[[], float] = SYSTEM.monotonic,
    ) -> None:
        self.recording, self.speed, self.playing = recording, speed, True
        self.position_s = 0.0
        self._clock = clock
        self._last_s: float | None = None
        self._at_s = 0.0  # of the message that is being heard
        self.heard = Heard(self.now)
        self.heard.line = lambda: list(recording.notes)
        self.seek(start_s)

    def now(self) -> float:
        """The recording's time, in s from its start."""
        return self._at_s

    def advance(self) -> None:
        """Play on to where the recording has got to by now."""
        now = self._clock()
        gone = 0.0 if self._last_s is None else max(now - self._last_s, 0.0)
        self._last_s = now
        if self.playing:
            to = min(self.position_s + gone * self.speed, self.recording.length_s)
            if to - self.position_s > MOST_AHEAD_S:
                self.seek(to)
            else:
                self.play_to(to)
            self.playing = to < self.recording.length_s

    def play_to(self, to_s: float) -> None:
        """All of the recording from here on to there, at once."""
        self._hear(self.recording.between(_beyond(self.position_s), _beyond(to_s)), to_s)

    def seek(self, to_s: float) -> None:
        """Go to a place, in s from the start; beyond either end to that end."""
        to = min(max(to_s, 0.0), self.recording.length_s)
        warm = max(to - WARM_S, 0.0)
        self.heard.follow(*self.recording.target, anew=True)
        self.heard.put_parameters(self.recording.parameters)
        self._hear(self.recording.before(warm), warm, counted=False)
        self._hear(self.recording.between(warm, _beyond(to)), to)

    def toggle(self) -> None:
        """Stop or go on; at the end, from the start."""
        if not self.playing and self.position_s >= self.recording.length_s:
            self.seek(0.0)
        self.playing = not self.playing

    def scale(self, factor: float) -> None:
        """Play so many times as fast."""
        self.speed = min(max(self.speed * factor, SLOWEST), FASTEST)

    def _hear(self, messages: Iterator[tuple[float, Any]], to_s: float, *, counted: bool = True) -> None:
        for self._at_s, message in messages:
            self.heard.take(message, counted=counted)
        self._at_s = self.position_s = to_s


def _beyond(time_s: float) -> float:
    """Just after, so that what came at that very moment has come."""
    return time_s + 1e-9


class Tlog:
    """A tlog, frame by frame: of several vehicles all are there, and one is shown."""

    parameters: Mapping[str, float] = {}

    def __init__(self, path: Path, system: int | None = None) -> None:
        """Raises InputError."""
        self.name = path.name
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
        flying = flight_numbers()
        sent = dict.fromkeys((who for who in senders if who), 0)
        for frame in self._frames:
            if _number(frame) in flying and (who := _header(frame)[1:]) in sent:
                sent[who] += 1
        if not sent:
            raise InputError(path, "", "no heartbeat of an autopilot in this tlog")
        self.target, self.notes = chosen(path, sent, system, FLIGHT_MESSAGES)
        try:
            self.flights: Sequence[Samples] = read_flights(path, self.target[0])
            self.notes += self.flights[0].provenance[len(self.notes) :]  # what is of several vehicles
        except InputError:  # shown all the same
            self.flights = ()
        target = self.target
        self._beats = [k for k, who in enumerate(senders) if who == target]
        self._lasting = self._lasting_frames()

    def _lasting_frames(self) -> list[int]:
        """Where parameters and texts are, and before each text what tells its time on the vehicle."""
        lasting: list[int] = []
        stamped: int | None = None
        for k, frame in enumerate(self._frames):
            number = _number(frame)
            if number in _STAMPED and _header(frame)[1:] == self.target:
                stamped = k
            elif number in _KEPT:
                if number == _TEXT and stamped is not None and stamped not in lasting[-1:]:
                    lasting.append(stamped)
                lasting.append(k)
        return lasting

    def before(self, to_s: float) -> Iterator[tuple[float, Any]]:
        """As `Recording.before`, the last heartbeat ahead: it says how parameters are to be read."""
        end = bisect_left(self._times, to_s)
        beat = max(bisect_left(self._beats, end) - 1, 0)
        return self._messages([self._beats[beat], *self._lasting[: bisect_left(self._lasting, end)]])

    def between(self, from_s: float, to_s: float) -> Iterator[tuple[float, Any]]:
        """As `Recording.between`."""
        return self._messages(range(bisect_left(self._times, from_s), bisect_left(self._times, to_s)))

    def _messages(self, indices: Sequence[int]) -> Iterator[tuple[float, Any]]:
        parser = mavlink.MAVLink(None)
        for k in indices:
            frame = self._frames[k]
            try:
                message = parser.decode(bytearray(frame))
            except mavlink.MAVError:
                continue  # garbled on its way: a loss
            if message.get_type().startswith("UNKNOWN"):  # pymavlink leaves the header of these empty
                message._header = mavlink.MAVLink_header(_number(frame), 0, 0, 0, *_header(frame))
            yield self._times[k], message


class SampleLog:
    """A log of samples (ULog, DataFlash): its flights one after another, each on a clock of its own."""

    target = (1, 1)

    def __init__(self, name: str, flights: Sequence[Samples], autopilot: int) -> None:
        self.name, self.flights, self._autopilot = name, flights, autopilot
        self.parameters = flights[0].parameters
        self.length_s = 0.0
        self._times: list[float] = []
        self._rows: list[tuple[Samples, int]] = []
        self._texts: list[tuple[float, int, str]] = []
        for samples in flights:
            time = samples["time_s"]
            start, lasts = float(time[0]), float(time[-1] - time[0])
            step = max(round(len(time) / max(lasts * RATE_HZ, 1.0)), 1)
            rows = np.arange(0, len(time), step)
            self._rows += [(samples, int(row)) for row in rows]
            self._times += (time[rows] - start + self.length_s).tolist()
            self._texts += [
                (max(at - start, 0.0) + self.length_s, UNSTATED if severity is None else severity, text)
                for at, severity, text in samples.texts
                if at <= time[-1]
            ]
            self.length_s += lasts
        self.notes = ("a log of samples: link, mode and current are not in it", *flights[0].provenance)
        self.notes += tuple(dict.fromkeys(note for samples in flights for note in samples.notes))

    def before(self, to_s: float) -> Iterator[tuple[float, Any]]:
        """As `Recording.before`."""
        return self._reported(0.0, to_s)

    def between(self, from_s: float, to_s: float) -> Iterator[tuple[float, Any]]:
        """As `Recording.between`."""
        for k in range(bisect_left(self._times, from_s), bisect_left(self._times, to_s)):
            for message in self._messages(*self._rows[k]):
                yield self._times[k], _sent(message)
        yield from self._reported(from_s, to_s)

    def _reported(self, from_s: float, to_s: float) -> Iterator[tuple[float, Any]]:
        for at, severity, text in self._texts:
            if from_s <= at < to_s:
                yield at, _sent(mavlink.MAVLink_statustext_message(severity, text.encode()))

    def _messages(self, samples: Samples, row: int) -> Iterator[Any]:
        def value(name: str, default: float = math.nan) -> float:
            column = samples.columns.get(name)
            return default if column is None else float(column[row])

        boot_ms = round(1e3 * float(samples["time_s"][row])) & 0xFFFFFFFF
        armed = 128 if value("armed", 1.0) > 0.5 else 0
        yield mavlink.MAVLink_heartbeat_message(2, self._autopilot, armed, NO_MODE, 4, 3)
        boot_us = 1000 * boot_ms
        roll, pitch, yaw = (value(f"{a}_rad") for a in ("roll", "pitch", "yaw"))
        rates = [value(f"gyro_{a}_rad_s") for a in "xyz"]
        yield mavlink.MAVLink_attitude_message(boot_ms, roll, pitch, yaw, *rates)
        if samples.has(*IMU_COLUMNS):
            accel = [value(f"accel_{a}_m_s2") for a in "xyz"]
            yield mavlink.MAVLink_highres_imu_message(boot_us, *accel, *rates, *[0.0] * 7, 0x3F, 0)
        motors = sum(MOTOR.fullmatch(name) is not None for name in samples.columns)
        speeds = max((int(n[3:]) for n in samples.columns if n.startswith("rpm")), default=0)
        commands = [value(f"motor{n}") for n in range(1, motors + 1)]
        padded = [*commands, *[0.0] * (32 - len(commands))]
        yield mavlink.MAVLink_actuator_output_status_message(boot_us, (1 << motors) - 1, padded)
        for first in range(0, speeds, 4):
            rpm = [value(f"rpm{first + k + 1}") for k in range(4)]
            if not all(math.isnan(speed) for speed in rpm):  # between two messages of slow ESCs
                yield MAVLink_esc_status_message(first, 0, rpm, [0.0] * 4, [0.0] * 4)
        if samples.has("height_m"):
            vn, ve, vd = (value(f"vel_{a}_m_s") for a in "ned")
            down = -value("height_m")
            yield mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, down, vn, ve, vd)
        if samples.has("voltage_V"):
            cells = [min(round(1e3 * value("voltage_V")), 65534), *[65535] * 9]
            yield mavlink.MAVLink_battery_status_message(0, 0, 0, 32767, cells, -1, -1, -1, -1)
        if samples.has("landed"):
            state = 1 if value("landed") > 0.5 else 2
            yield mavlink.MAVLink_extended_sys_state_message(0, state)


def load_recording(path: Path, system: int | None = None) -> Tlog | SampleLog:
    """A recording by its content; of several vehicles that of `system`. Raises InputError."""
    kind = log_kind(path)
    if kind == "tlog":
        return Tlog(path, system)
    if kind == "text":
        raise InputError(
            path, "", "a tlog, a mix.live, a ULog or a DataFlash log (.bin) is expected, found text"
        )
    ardupilot = kind == "dataflash"
    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if ardupilot else mavlink.MAV_AUTOPILOT_PX4
    return SampleLog(path.name, read_flights(path, system), autopilot)


def _sent(message: Any) -> Any:
    """The message as if it had come from the vehicle of a log."""
    message._header.srcSystem, message._header.srcComponent = SampleLog.target
    return message


def _number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little") if frame[0] == 0xFD else frame[5]


def _autopilot(frame: bytes) -> tuple[int, int] | None:
    """(system, component) of a frame that is an autopilot's heartbeat."""
    at = (10 if frame[0] == 0xFD else 6) + 5
    if _number(frame) or len(frame) <= at or frame[at] == mavlink.MAV_AUTOPILOT_INVALID:
        return None
    return _header(frame)[1:]


def _header(frame: bytes) -> tuple[int, int, int]:
    """Sequence, system, component."""
    at = 4 if frame[0] == 0xFD else 2
    return frame[at], frame[at + 1], frame[at + 2]
