"""The stand-in ArduCopter's MAVLink manners, where they differ from PX4's."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from sim.ardupilot.copter import Copter
from sim.ardupilot.files import MANNERS
from sim.ardupilot.telemetry import BUILDERS, DEFAULT_HZ, GROUPS
from sim.line.links import Peer
from sim.line.wire import Clock
from sim.px4.autopilot import Refused
from sim.px4.protocol import ACCEPTED, DENIED, FAILED, TEMPORARILY, UNSUPPORTED, Conversation, _text

NO_SUCH_PARAM, NOT_ALLOWED = 1, 3  # MAV_PARAM_ERROR_DOES_NOT_EXIST, _PERMISSION_DENIED
SCRIPTING = 42701
NO_INDEX = 65535
RATE_GROUPS = {
    "MAV1_RAW_SENS": 1,
    "MAV1_EXT_STAT": 2,
    "MAV1_RC_CHAN": 3,
    "MAV1_RAW_CTRL": 4,
    "MAV1_POSITION": 6,
    "MAV1_EXTRA1": 10,
    "MAV1_EXTRA2": 11,
    "MAV1_EXTRA3": 12,
}


class ApConversation(Conversation):
    """What one peer has asked of an ArduCopter."""

    builders = BUILDERS
    default_hz = DEFAULT_HZ
    file_manners = MANNERS
    first_log = 1
    unknown_stream = DENIED
    own_pace: frozenset[int] = frozenset()
    words_to_stations_only = False
    words_end = ""

    def __init__(self, autopilot: Copter, peer: Peer, everyone: Callable[[Any], None], clock: Clock) -> None:
        super().__init__(autopilot, peer, everyone, clock)
        self.copter = autopilot
        for name in RATE_GROUPS:
            if autopilot.store[name] > 0:
                self._take_rates(name)
        self._handlers["REQUEST_DATA_STREAM"] = self._data_stream
        autopilot.store.announce = lambda name: everyone(self._named(name))
        autopilot.send_raw = lambda link, number, payload: everyone(_Raw(number, payload, link))

    def hear(self, message: Any) -> None:
        """As any; and what a script listens to goes to it."""
        self.copter.scripts.hear(message.get_msgId(), bytes(message.get_msgbuf()), self.peer.link)
        super().hear(message)

    def send(self, message: Any) -> None:
        """As any; what a script says goes to the link it was reported to."""
        if not isinstance(message, _Raw) or message.link == self.peer.link:
            super().send(message)

    def _heartbeat(self, message: Any) -> None:
        """Of the one ground station that it knows, whatever else it says it is."""
        if message.get_srcSystem() == int(self.copter.store["MAV_GCS_SYSID"]):
            self.copter.links.heard(self.copter.plant.time_s)

    # -- parameters ----------------------------------------------------------------------------

    def _param_value(self, index: int) -> None:
        store = self.copter.store
        if 0 <= index < len(store.names):
            name = store.names[index]
            kind, count = store.type(name), len(store.names)
            self.send(m.MAVLink_param_value_message(name.encode(), store[name], kind, count, index))

    def _param_read(self, message: Any) -> None:
        store = self.copter.store
        if message.param_index >= 0:
            self._param_value(message.param_index)
            return
        name = _text(message.param_id)
        if name in store:
            self.send(self._named(name))
        else:
            self._param_error(message, name)

    def _named(self, name: str) -> Any:
        """A value that was asked for by name: it comes without its index."""
        store = self.copter.store
        return m.MAVLink_param_value_message(
            name.encode(), store[name], store.type(name), len(store.names), NO_INDEX
        )

    def _param_error(self, message: Any, name: str, why: int = NO_SUCH_PARAM) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        self.send(m.MAVLink_param_error_message(*source, name.encode(), -1, why))

    def _param_list(self, message: Any) -> None:
        self._listed_at = self._clock()
        self._listing = deque(range(len(self.copter.store.names)))

    def _param_set(self, message: Any) -> None:
        name, store = _text(message.param_id), self.copter.store
        if name not in store or not math.isfinite(message.param_value):
            self._param_error(message, name)
            return
        if store.refuses(name):
            self._say(4, f"Param write denied ({name})")
            self._param_error(message, name, NOT_ALLOWED)
            self._everyone(self._named(name))
            return
        store.write(name, message.param_value)
        if name.startswith("MAV1_"):
            self._take_rates(name)
        self._everyone(self._named(name))

    def _take_rates(self, name: str) -> None:
        """A stream group's own rate, as MAV1_* have it."""
        rate = self.copter.store[name]
        for number in GROUPS.get(RATE_GROUPS.get(name, 0), ()):
            self.interval_us.pop(number, None)
            if rate > 0:
                self.interval_us[number] = 1e6 / rate

    # -- commands ------------------------------------------------------------------------------

    def _set_interval(self, message_id: int, interval_us: float) -> int:
        """A message that it does not know is told of to everyone."""
        if message_id not in self.builders:
            self._say(6, f"No ap_message for mavlink id ({message_id})")
        return super()._set_interval(message_id, interval_us)

    def _set_mode(self, message: Any) -> None:
        try:
            self.copter.set_ap_mode(message.custom_mode)
        except Refused as error:
            self._say(4, str(error))

    def _refusal(self, command: int) -> tuple[int, int]:
        return 2, FAILED

    def _command_long(self, message: Any) -> None:
        """Reposition comes as COMMAND_INT only."""
        if message.command == 192:
            source = message.get_srcSystem(), message.get_srcComponent()
            self.send(m.MAVLink_command_ack_message(192, UNSUPPORTED, 0, 0, *source))
            return
        super()._command_long(message)

    def _execute(self, command: int, p: list[float]) -> tuple[int, Any]:
        a = self.copter
        if command == 22:  # above home
            a.take_off(p[6])
        elif command == 176:
            a.set_ap_mode(int(p[1]))
        elif command in (20, 21):
            a.set_ap_mode(6 if command == 20 else 9)
        elif command == 192:
            if a.ap_mode != 4:
                return DENIED, None
            a.go_to((*a.home.local(p[4], p[5]), a.home.alt - p[6]), p[3])
        elif command == SCRIPTING:
            if p[0] == 3:
                a.restart_scripts()
        elif command == 183:  # set servo: not one that a motor holds
            function = int(a.store[f"SERVO{int(p[0])}_FUNCTION"]) if 1 <= p[0] <= 16 else 33
            return (FAILED if function else ACCEPTED), None
        elif command == 209:  # motor test
            return (ACCEPTED if a.test_motor(int(p[0]), int(p[1]), p[2], p[3]) else FAILED), None
        elif command == 510 and round(p[0]) not in self.builders:
            return FAILED, m.MAVLink_message_interval_message(round(p[0]), 0)
        elif command == 401:  # run the pre-arm checks, and say what they find
            if a.armed:
                return TEMPORARILY, None
            if reason := a.prearm():
                self._say(2, reason)
        elif command == 310:
            return UNSUPPORTED, None
        else:
            return super()._execute(command, p)
        return ACCEPTED, None

    def _storage(self, action: float) -> int:
        """It keeps every value at once and knows no such request."""
        return DENIED

    def _reboot(self, action: float) -> int:
        if self.copter.armed:
            return FAILED
        return super()._reboot(action)

    def _data_stream(self, message: Any) -> None:
        groups = list(GROUPS) if message.req_stream_id == 0 else [message.req_stream_id]
        for group in groups:
            for number in GROUPS.get(group, ()):
                self.interval_us.pop(number, None)
                if message.start_stop and message.req_message_rate:
                    self.interval_us[number] = 1e6 / message.req_message_rate

    def demand_due(self) -> bool:
        """No such stream: only a script sends the demand."""
        return False

    def _actuator_target(self, message: Any) -> None:
        """No handler: only a script can take it."""


class _Raw:
    """A message of a script's own: a number and a payload, for one link."""

    def __init__(self, number: int, payload: bytes, link: int) -> None:
        self.link = link
        self._message = m.MAVLink_message(number, "SCRIPT")
        self._payload = payload
        known = m.mavlink_map.get(number)
        self._extra = known.crc_extra if known else 0

    def pack(self, mav: Any) -> bytes:
        """The frame."""
        return bytes(self._message._pack(mav, self._extra, self._payload))
