"""A small autopilot for the tests: heartbeats, AUTOPILOT_VERSION, the parameter protocol, faults to order.

It shares no code with coaxlink; frames are pymavlink's. With `net` (`memory_net.Net`) it lives in memory on
the net's virtual clock, else on a loopback port with a thread of its own.
"""

import random
import socket
import struct
import threading
import time

from pymavlink.dialects.v20 import common as m

INT32, FLOAT = 6, 9
BYTEWISE = 16


BEAT_S = 0.05


class ScriptedAutopilot:
    """Answers at `address` (`url`) until closed. Attributes may be changed while it runs."""

    def __init__(
        self,
        params,
        *,
        net=None,
        px4=True,
        version=(1, 16, 1),
        system=1,
        seed=0,
        uid=0xC0A1,
        key=None,
        towards=None,
    ):
        self.params = dict(params)  # name -> (value, type)
        self.px4, self.version, self.system, self.uid = px4, version, system, uid
        self.vehicle_type = m.MAV_TYPE_OCTOROTOR
        self.armed = False
        self.loss = 0.0  # share of frames lost, each way
        self.param_errors = False  # answer unknown names with PARAM_ERROR
        self.keeps = {}  # name -> value it keeps, whatever is set
        self.refuses = set()  # names answered with PARAM_ERROR on set
        self.arm_after = None  # number of sets after which it arms
        self.mute_after = None  # number of sets after which it falls silent
        self.deaf = False
        self.hash = 0x12345678
        self.after_set = {}  # number of sets -> what then happens
        self.ears_closed = threading.Event()
        self.storage = lambda: 0  # what MAV_CMD_PREFLIGHT_STORAGE is answered
        self.skip_in_list = set()  # indices the next list loses
        self.sets = []
        self.sent = []
        self.commands = []
        self.heard = []
        self._random = random.Random(seed)
        self.net, self._socket, self._stop = net, None, threading.Event()
        if net is None:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.bind(("127.0.0.1", 0))
            self._socket.settimeout(0.02)
            self.address = self._socket.getsockname()
        else:
            self.address = net.address()
        self.url = f"udpout:{self.address[0]}:{self.address[1]}"
        self._out, self._in = m.MAVLink(None, system, 1), m.MAVLink(None, system, 1)
        self._in.robust_parsing = True
        if key:
            for mav in (self._out, self._in):
                mav.signing.secret_key, mav.signing.link_id = key, 3
                mav.signing.timestamp = int((time.time() - 1420070400) * 1e5)
                mav.signing.sign_outgoing = True
        self._peer = towards  # whom to talk to before anyone was heard
        self._thread = threading.Thread(target=self._run, daemon=True)
        if net is None:
            self._thread.start()
        else:
            net.bind(self.address, self._hear)
            self._live()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self._stop.set()
        if self.net is not None:
            self.net.leave(self.address)
            return
        self._thread.join(2)
        self._socket.close()

    def send(self, message):
        frame = message.pack(self._out)
        self._out.seq = (self._out.seq + 1) % 256
        if self._peer and not self.deaf and self._random.random() >= self.loss:
            self.put(frame)
        self.sent.append(frame)

    def put(self, frame):
        """Send bytes as they are."""
        if self.net is not None:
            self.net.send(frame, self.address, self._peer)
        else:
            self._socket.sendto(frame, self._peer)

    def _beat(self):
        autopilot = m.MAV_AUTOPILOT_PX4 if self.px4 else m.MAV_AUTOPILOT_ARDUPILOTMEGA
        mode = 128 if self.armed else 0
        self.send(m.MAVLink_heartbeat_message(self.vehicle_type, autopilot, mode, 0, 4, 3))

    def _live(self):
        if not self._stop.is_set():
            self._beat()
            self.net.clock.later(BEAT_S, self._live)

    def _run(self):
        beat = 0.0
        while not self._stop.is_set():
            if time.monotonic() > beat:
                beat = time.monotonic() + BEAT_S
                self._beat()
            try:
                self._hear(*self._socket.recvfrom(4096))
            except TimeoutError:
                continue

    def _hear(self, data, source):
        self._peer = source
        for message in self._in.parse_buffer(data) or []:
            if not self.deaf and self._random.random() >= self.loss:
                self._handle(message)

    def _handle(self, message):
        kind = message.get_type()
        self.heard.append(message)
        if kind == "COMMAND_LONG":
            self.commands.append((message.command, message.param1, message.param2))
            if message.command == 512 and message.param1 == 148:
                self._send_version()
            known = message.command in (245, 400, 511, 512)
            result = self.storage() if message.command == 245 else 0 if known else 3
            self.send(m.MAVLink_command_ack_message(message.command, result))
        elif kind == "PARAM_REQUEST_READ":
            names = list(self.params)
            name = message.param_id if message.param_index < 0 else names[message.param_index]
            if name == "_HASH_CHECK" and self.px4:
                self._send_hash()
            else:
                self._send_value(name) if name in self.params else self._unknown(name)
        elif kind == "PARAM_REQUEST_LIST":
            skip, self.skip_in_list = self.skip_in_list, set()
            if self.px4:
                self._send_hash()
            for index, name in enumerate(self.params):
                if index not in skip:
                    self._send_value(name)
        elif kind == "PARAM_SET":
            self._set(message)

    def _set(self, message):
        name = message.param_id
        self.sets.append(name)
        if self.arm_after is not None and len(self.sets) >= self.arm_after:
            self.armed, self.arm_after = True, None
            self.send(m.MAVLink_heartbeat_message(self.vehicle_type, 12 if self.px4 else 3, 128, 0, 4, 3))
        if self.mute_after is not None and len(self.sets) >= self.mute_after:
            self.deaf = True
        if name not in self.params or message.param_type != self.params[name][1]:
            self._unknown(name)
            return
        if name in self.refuses:
            self.send(m.MAVLink_param_error_message(255, 0, name.encode(), -1, 5))
            return
        bits = bytes(message.get_msgbuf()[10:14])
        if self.params[name][1] == INT32 and self.px4:
            value = struct.unpack("<i", bits)[0]
        else:
            value = struct.unpack("<f", bits)[0]
            value = int(value) if self.params[name][1] == INT32 else value
        self.params[name] = (self.keeps.get(name, value), self.params[name][1])
        self._send_value(name)

        self.after_set.pop(len(self.sets), lambda: None)()

    def close_ears(self):
        self.deaf = True
        self.ears_closed.set()

    def _send_hash(self):
        self._send_raw("_HASH_CHECK", struct.pack("<I", self.hash), 5, 65535)

    def _unknown(self, name):
        if self.param_errors:
            self.send(m.MAVLink_param_error_message(255, 0, name.encode(), -1, 1))

    def _send_value(self, name):
        value, kind = self.params[name]
        code = "<i" if kind == INT32 and self.px4 else "<f"
        self._send_raw(name, struct.pack(code, value), kind, list(self.params).index(name))

    def _send_raw(self, name, bits, kind, index):
        count = len(self.params)
        message = m.MAVLink_param_value_message(name.encode(), 0.0, kind, count, index)
        rest = message.unpacker.pack(0.0, count, index, name.encode(), kind)
        message.pack = lambda mav, force_mavlink1=False: message._pack(
            mav, message.crc_extra, bits + rest[4:]
        )
        self.send(message)

    def _send_version(self):
        packed = (self.version[0] << 24) | (self.version[1] << 16) | (self.version[2] << 8) | 255
        capabilities = BYTEWISE if self.px4 else 2
        zeros = [0] * 8
        self.send(
            m.MAVLink_autopilot_version_message(
                capabilities,
                packed,
                0,
                0,
                7,
                [1, 2, 3, 4, 5, 6, 7, 8],
                zeros,
                zeros,
                12,
                34,
                self.uid,
                [0] * 18,
            )
        )
