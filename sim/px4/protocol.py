"""The stand-in's MAVLink manners: parameters, commands, set-points, streams. One `Conversation` a peer."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as ap
from pymavlink.dialects.v20 import common as m

from sim.line.ftp import Manners, Server
from sim.line.links import Peer
from sim.line.logs import LogTransfer
from sim.line.wire import Clock
from sim.px4.autopilot import AttitudeGoal, Autopilot, Goal, Mode, Refused
from sim.px4.store import HASH_CHECK
from sim.px4.telemetry import BUILDERS, DEFAULT_HZ, stamp_us
from sim.words import spoken

DEMANDS = (140, 350)  # go out before mixing
UINT32 = 5
LIST_HZ = 2000.0  # parameters a second of wall time while a list goes out
FORCE = 21196.0
GROUND_STATION = 6  # MAV_TYPE
NO_SUCH_PARAM, WRONG_TYPE = 1, 5  # MAV_PARAM_ERROR
SAYS_NO = (1, 17, 0)  # from here on an unknown parameter is answered by PARAM_ERROR, before by silence
ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4


class Conversation:
    """What one peer has asked for, and the answers."""

    builders = BUILDERS
    default_hz = DEFAULT_HZ
    file_manners = Manners(one_session=True, counts_written=True, empty_folder_ends=False)
    first_log = 0
    words_to_stations_only = True  # STATUSTEXT goes where a ground station's heartbeat is heard
    words_end = "\t"  # of a text that is an event as well
    unknown_stream = FAILED  # answer to SET_MESSAGE_INTERVAL of a message that is not known
    # HEARTBEAT: no other interval is taken (mavlink_receiver.cpp of 1.13 to 1.16, set_message_interval)
    own_pace: frozenset[int] = frozenset({0})

    def __init__(
        self, autopilot: Autopilot, peer: Peer, everyone: Callable[[Any], None], clock: Clock
    ) -> None:
        self.autopilot, self.peer, self._everyone, self._clock = autopilot, peer, everyone, clock
        self._station = False  # a ground station was heard on this link
        self.builders = self._known_messages()
        self.interval_us = {k: 1e6 / hz for k, hz in self.default_hz.items()}
        self._due_us: dict[int, float] = {}
        self._listing: deque[int] = deque()
        self._listed_at = 0.0
        self._files = Server(autopilot.files, self.file_manners, self._file_reply)
        self._file_source = (255, 190)
        self._logs = LogTransfer(autopilot, self.send, self.first_log, clock)
        self._handlers: dict[str, Callable[[Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_SET": self._param_set,
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
            "SET_MODE": self._set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._position_target,
            "SET_ATTITUDE_TARGET": self._attitude_target,
            "SET_ACTUATOR_CONTROL_TARGET": self._actuator_target,
            "TUNNEL": self._tunnel,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "FILE_TRANSFER_PROTOCOL": self._file_transfer,
            **self._logs.handlers,
            "MISSION_REQUEST_LIST": self._no_mission,
            "MISSION_COUNT": self._no_mission,
        }

    def _known_messages(self) -> dict[int, Callable[[Any], Any]]:
        """By the version: since 1.14 no message carries the torque that the mixer gets."""
        late = self.autopilot.version >= (1, 14, 0)
        return {k: b for k, b in type(self).builders.items() if not (late and k == 140)}

    # -- outgoing ------------------------------------------------------------------------------

    def send(self, message: Any) -> None:
        """One message or several."""
        for one in message if isinstance(message, list) else [message]:
            if self._station or not self.words_to_stations_only or one.get_type() != "STATUSTEXT":
                self.peer.send(one)

    def stream(self, requested: int = 0) -> bool:
        """Send what has come due at this reading; whether message `asked` was among it."""
        now, sent = stamp_us(self.autopilot), False
        for message_id, interval in self.interval_us.items():
            due = self._due_us.get(message_id, 0.0)
            if now + 1 < due:
                continue
            self._due_us[message_id] = max(due + interval, now + 0.5 * interval)
            if message_id not in DEMANDS:
                self.send(self.builders[message_id](self.autopilot))
                sent |= message_id == requested
        return sent

    def demand_due(self) -> bool:
        """Whether a demand goes out now: before mixing, so that the answer can count."""
        now = stamp_us(self.autopilot)
        due = (n for n in DEMANDS if n in self.interval_us and now + 1 >= self._due_us.get(n, 0.0))
        return any(n != 350 or self.autopilot.module is not None for n in due)

    def list_on(self) -> None:
        """Go on with a parameter list or a log, at the pace a real link has."""
        self._logs.go_on()
        if not self._listing:
            return
        now = self._clock()
        share = int(min((now - self._listed_at) * LIST_HZ, 40.0))
        if share:
            self._listed_at = now
        for _ in range(min(share, len(self._listing))):
            self._param_value(self._listing.popleft())

    def _param_value(self, index: int) -> None:
        store = self.autopilot.store
        names = store.names
        if index < 0:
            field = struct.unpack("<f", struct.pack("<I", store.hash()))[0]
            self.send(m.MAVLink_param_value_message(HASH_CHECK.encode(), field, UINT32, len(names), 65535))
            return
        name = names[index]
        self.send(
            m.MAVLink_param_value_message(
                name.encode(), store.wire(name), store.type(name), len(names), index
            )
        )

    # -- incoming ------------------------------------------------------------------------------

    def hear(self, message: Any) -> None:
        """Deal with one message; one for another system is not ours."""
        if getattr(message, "target_system", 0) not in (0, self.peer.packer.srcSystem):
            return
        if getattr(message, "target_component", 0) not in (0, 1):
            return
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return
        try:
            handler(message)
        except (ValueError, OverflowError, struct.error):
            return  # NaN where a number belongs: an autopilot drops it without a word

    def _heartbeat(self, message: Any) -> None:
        if message.type == GROUND_STATION:
            self._station = True
            self.autopilot.links.heard(self.autopilot.plant.time_s)

    def _param_read(self, message: Any) -> None:
        names = self.autopilot.store.names
        if message.param_index >= 0:
            if message.param_index < len(names):
                self._param_value(message.param_index)
            return
        name = _text(message.param_id)
        if name == HASH_CHECK:
            self._param_value(-1)
        elif name in self.autopilot.store:
            self._param_value(names.index(name))
        else:
            self._param_error(message, name)

    def _param_error(self, message: Any, name: str) -> None:
        if self.autopilot.version < SAYS_NO:
            return
        source = message.get_srcSystem(), message.get_srcComponent()
        why = WRONG_TYPE if name in self.autopilot.store else NO_SUCH_PARAM
        self.send(ap.MAVLink_param_error_message(*source, name.encode(), -1, why))

    def _param_list(self, message: Any) -> None:
        self._listed_at = self._clock()
        self._param_value(-1)
        self._listing = deque(range(len(self.autopilot.store.names)))

    def _param_set(self, message: Any) -> None:
        name, store = _text(message.param_id), self.autopilot.store
        if name == HASH_CHECK:
            self._listing.clear()  # "I have them all"
            return
        changed = store.write(name, message.param_type, message.param_value)
        if changed is None:
            self._param_error(message, name)
            return
        index = store.names.index(name)
        self._param_value(index)
        if changed:
            # and once more, to everyone, as news
            self._everyone(
                m.MAVLink_param_value_message(
                    name.encode(), store.wire(name), store.type(name), len(store.names), index
                )
            )

    def _say(self, severity: int, text: str) -> None:
        for piece in spoken(severity, text + self.words_end):
            self._everyone(piece)

    def _set_mode(self, message: Any) -> None:
        try:
            self.autopilot.set_mode(Mode(message.custom_mode))
        except (ValueError, Refused) as error:
            self._say(4, str(error))

    def _command_long(self, message: Any) -> None:
        params = [getattr(message, f"param{k}") for k in range(1, 8)]
        self._command(message, message.command, params)

    def _command_int(self, message: Any) -> None:
        lat = math.nan if message.x == 2**31 - 1 else message.x * 1e-7
        lon = math.nan if message.y == 2**31 - 1 else message.y * 1e-7
        up = message.z + self.autopilot.home.alt if self._above_home(message) else message.z
        params = [message.param1, message.param2, message.param3, message.param4, lat, lon, up]
        self._command(message, message.command, params)

    @staticmethod
    def _above_home(message: Any) -> bool:
        return bool(message.command == 192 and message.frame in (3, 6))

    def _takeoff_height(self, above_sea: float) -> float:
        """Above home; PX4 goes to MIS_TAKEOFF_ALT at least, and says so."""
        a = self.autopilot
        height, least = above_sea - a.home.alt, float(a.settings["MIS_TAKEOFF_ALT"])
        if math.isfinite(height) and height < least - 0.1:
            self._say(2, f"Using minimum takeoff altitude: {least:.2f} m")
            return least
        return height if math.isfinite(height) else math.nan

    def _no_mission(self, message: Any) -> None:
        """None on board, none taken: a ground station that asks for one gets its answer."""
        source, kind = (message.get_srcSystem(), message.get_srcComponent()), message.mission_type
        if message.get_type() == "MISSION_COUNT":
            self.send(m.MAVLink_mission_ack_message(*source, m.MAV_MISSION_UNSUPPORTED, kind))
        else:
            self.send(m.MAVLink_mission_count_message(*source, 0, kind))

    def _command(self, message: Any, command: int, params: list[float]) -> None:
        try:
            result, after = self._execute(command, params)
        except Refused as error:
            severity, result, after = *self._refusal(command), None
            self._say(severity, str(error))
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send(m.MAVLink_command_ack_message(command, result, 0, 0, *source))
        if after is not None:
            self.send(after)

    def _refusal(self, command: int) -> tuple[int, int]:
        """Severity of the text and result of a command that the autopilot refuses."""
        return 4, TEMPORARILY if command == 400 else DENIED

    def _execute(self, command: int, p: list[float]) -> tuple[int, Any]:
        """Result and a message to send after the acknowledgement. Raises Refused."""
        a = self.autopilot
        if command == 400:  # arm, disarm
            a.arm() if p[0] == 1 else a.disarm(force=p[1] == FORCE)
        elif command == 22:  # take off; altitude above mean sea level
            a.take_off(self._takeoff_height(p[6]))
        elif command in (20, 21):
            a.set_mode(Mode.RTL if command == 20 else Mode.LAND)
        elif command in (224, 300):  # a mission's item, a mission's start: there is none
            return DENIED, None
        elif command == 176:
            return self._do_set_mode(p), None
        elif command == 192:  # reposition
            a.go_to((*a.home.local(p[4], p[5]), a.home.alt - p[6]), p[3])
        elif command == 511:
            return self._set_interval(round(p[0]), p[1]), None
        elif command == 510:
            known = self.interval_us.get(round(p[0]), 0.0)
            return ACCEPTED, m.MAVLink_message_interval_message(round(p[0]), round(known) or -1)
        elif command == 512:
            builder = self.builders.get(round(p[0]))
            return (ACCEPTED, builder(a)) if builder else (UNSUPPORTED, None)
        elif command in (519, 520):
            return (ACCEPTED, self.builders[148](a)) if command == 520 else (UNSUPPORTED, None)
        elif command == 246:
            return self._reboot(p[0]), None
        elif command == 310:
            return self._actuator_test(p), None
        elif command == 209 and a.version < (1, 14, 0):
            done = (
                not a.armed
                and p[1] == 0
                and a.motor_test.turn(int(p[0]) - 1, p[2] / 100.0, p[3], a.plant.time_s)
            )
            return (ACCEPTED if done else DENIED), None
        elif command == 401:  # run the pre-arm checks, and say what they find
            for reason in a.preflight():
                self._say(2, reason)
        elif command == 178:
            a.cruise = p[1] if p[1] > 0 else a.cruise
        elif command == 245:
            return self._storage(p[0]), None
        elif command != 179:  # home: taken, of no effect
            return UNSUPPORTED, None
        return ACCEPTED, None

    def _actuator_test(self, p: list[float]) -> int:
        """One motor, disarmed, 3 s at most; NaN stops it."""
        a = self.autopilot
        if a.armed or a.store["COM_MOT_TEST_EN"] != 1:
            return DENIED
        value = p[0] if math.isfinite(p[0]) else 0.0
        return ACCEPTED if a.motor_test.turn(round(p[4]) - 1, value, p[1], a.plant.time_s) else DENIED

    def _do_set_mode(self, p: list[float]) -> int:
        if not int(p[0]) & 1:
            return DENIED
        try:
            mode = Mode(int(p[1]) << 16 | int(p[2]) << 24)
        except ValueError:
            return DENIED
        self.autopilot.set_mode(mode)
        return ACCEPTED

    def _set_interval(self, message_id: int, interval_us: float) -> int:
        if message_id not in self.builders:
            return self.unknown_stream
        if message_id in self.own_pace:
            return FAILED
        if interval_us < 0:
            self.interval_us.pop(message_id, None)
        elif interval_us == 0:
            if message_id in self.default_hz:
                self.interval_us[message_id] = 1e6 / self.default_hz[message_id]
            else:
                self.interval_us.pop(message_id, None)
        else:
            self.interval_us[message_id] = max(interval_us, 4000.0)
        self._due_us.pop(message_id, None)
        return ACCEPTED

    def _storage(self, action: float) -> int:
        """Parameters on disk at once; never in the air."""
        if self.autopilot.armed:
            return TEMPORARILY
        if action == 1:
            self.autopilot.keep()
        return ACCEPTED

    def _reboot(self, action: float) -> int:
        if self.autopilot.armed:
            return DENIED
        if action == 1:
            self.autopilot.boot()
        return ACCEPTED

    def _position_target(self, message: Any) -> None:
        if message.coordinate_frame != 1:
            return
        mask = message.type_mask

        def pick(bits: int, values: tuple[float, ...]) -> tuple[float, float, float]:
            x, y, z = (math.nan if mask & (bits << k) else v for k, v in enumerate(values))
            return x, y, z

        yaw = message.yaw if not mask & 1024 else math.nan
        self.autopilot.offboard(
            Goal(
                pick(1, (message.x, message.y, message.z)),
                pick(8, (message.vx, message.vy, message.vz)),
                pick(64, (message.afx, message.afy, message.afz)),
                self.autopilot.goal.yaw if math.isnan(yaw) else yaw,
                0.0 if mask & 2048 else message.yaw_rate,
            )
        )

    def _attitude_target(self, message: Any) -> None:
        rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        w, x, y, z = message.q
        size = math.sqrt(w * w + x * x + y * y + z * z)
        if not message.type_mask & 128 and not 0.5 < size < 2.0:
            return  # no rotation
        attitude = None if message.type_mask & 128 else (w / size, x / size, y / size, z / size)
        self.autopilot.offboard(AttitudeGoal(attitude, rates, min(max(message.thrust, 0.0), 1.0)))

    def _actuator_target(self, message: Any) -> None:
        if message.group_mlx == 0:
            self.autopilot.drive(np.array(message.controls, float))

    def _tunnel(self, message: Any) -> None:
        if self.autopilot.module is not None:
            self.autopilot.module.hear(self.autopilot.plant.time_s, message)

    def _timesync(self, message: Any) -> None:
        if message.tc1 == 0:
            self.send(m.MAVLink_timesync_message(stamp_us(self.autopilot) * 1000, message.ts1))

    def _ping(self, message: Any) -> None:
        if message.target_system == 0:
            source = message.get_srcSystem(), message.get_srcComponent()
            self.send(m.MAVLink_ping_message(message.time_usec, message.seq, *source))

    def _file_transfer(self, message: Any) -> None:
        self._file_source = message.get_srcSystem(), message.get_srcComponent()
        self._files.hear(bytes(message.payload))

    def _file_reply(self, payload: bytes) -> None:
        self.send(m.MAVLink_file_transfer_protocol_message(0, *self._file_source, list(payload)))


def _text(param_id: str | bytes) -> str:
    raw = param_id.encode() if isinstance(param_id, str) else param_id
    return raw.split(b"\0")[0].decode(errors="replace")
