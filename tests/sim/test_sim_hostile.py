"""Whatever arrives, the world goes on: random bytes, and well-formed messages full of nonsense."""

import math
import random
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as m

from sim.line.links import Peer, Port
from sim.standin import Standin
from sim.world import World, build

EXAMPLES = Path(__file__).parents[2] / "examples"
WILD = [0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 1e30, -1e30, 3.4e38, 1e-40, 255.0, 21196.0]
KINDS = [
    m.MAVLink_command_long_message,
    m.MAVLink_command_int_message,
    m.MAVLink_set_mode_message,
    m.MAVLink_param_set_message,
    m.MAVLink_param_request_read_message,
    m.MAVLink_param_request_list_message,
    m.MAVLink_set_position_target_local_ned_message,
    m.MAVLink_set_attitude_target_message,
    m.MAVLink_set_actuator_control_target_message,
    m.MAVLink_request_data_stream_message,
    m.MAVLink_file_transfer_protocol_message,
    m.MAVLink_timesync_message,
    m.MAVLink_ping_message,
    m.MAVLink_mission_request_list_message,
    m.MAVLink_log_request_list_message,
    m.MAVLink_log_request_data_message,
    m.MAVLink_log_erase_message,
    m.MAVLink_mission_count_message,
    m.MAVLink_mission_item_int_message,
    m.MAVLink_mission_item_message,
    m.MAVLink_mission_request_int_message,
    m.MAVLink_mission_clear_all_message,
    m.MAVLink_mission_set_current_message,
]
COMMANDS = [
    400,
    22,
    16,
    177,
    300,
    224,
    20,
    21,
    176,
    192,
    511,
    510,
    512,
    519,
    520,
    246,
    310,
    178,
    183,
    209,
    42701,
    31010,
]


class Pipe:
    """A socket whose far end is this test."""

    def sendto(self, data: bytes, address: object) -> None:
        assert len(data) < 300

    def close(self) -> None: ...


class Wirebox(Port):
    """A port with one peer; `inbox` is what it will bring next."""

    def __init__(self) -> None:
        super().__init__("test", "", 0, 1)
        self.peers = [Peer(Pipe(), ("", 0), 1)]  # type: ignore[arg-type]
        self.inbox: list[bytes] = []

    @property
    def sockets(self) -> list:
        return []

    def receive(self) -> list[tuple[Peer, bytes]]:
        found, self.inbox = self.inbox, []
        return [(self.peers[0], data) for data in found]


def nonsense(draw: random.Random, kind: type[Any], mav: Any, names: list[str]) -> bytes:
    """A well-formed frame of a kind, its fields drawn at random."""
    payload = b""
    for code, count in zip(kind.native_format[1:].decode(), kind.array_lengths, strict=True):
        for _ in range(max(count, 1)):
            if code == "f":
                payload += struct.pack("<f", draw.choice(WILD))
            else:
                payload += draw.randbytes(struct.calcsize(code))
    message, data = m.MAVLink_message(kind.id, kind.msgname), bytearray(payload)
    fields = kind.ordered_fieldnames
    for field, value in (("target_system", 1), ("target_component", 1), ("coordinate_frame", 1)):
        if field in fields:
            data[_offset(kind, field)] = value
    if "command" in fields:
        struct.pack_into("<H", data, _offset(kind, "command"), draw.choice(COMMANDS))
    if "param_id" in fields:
        struct.pack_into("<16s", data, _offset(kind, "param_id"), draw.choice(names).encode())
        if "param_type" in fields:
            data[_offset(kind, "param_type")] = draw.choice([6, 9])
    return bytes(message._pack(mav, kind.crc_extra, bytes(data)))


def _offset(kind: type[Any], field: str) -> int:
    at = 0
    codes = kind.native_format[1:].decode()
    for name, code, count in zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True):
        if name == field:
            return at
        at += struct.calcsize("<" + code) * max(count, 1)
    raise KeyError(field)


@pytest.mark.parametrize("firmware", ["px4:1.13", "px4", "ardupilot"])
def test_nonsense_does_not_stop_the_world(firmware: str) -> None:
    draw = random.Random(firmware)
    port = Wirebox()
    standin: Standin = build(World(EXAMPLES / "x8_demo.toml", firmware=firmware), [port], speed=1.0)
    mav = m.MAVLink(None, srcSystem=255, srcComponent=190)
    names = list(standin.autopilot.store.names)
    for tick in range(700):
        for _ in range(5):
            port.inbox.append(nonsense(draw, draw.choice(KINDS), mav, names))
        if tick % 7 == 0:
            port.inbox.append(draw.randbytes(draw.randrange(1, 400)))
        standin.tick()
        commands = standin.autopilot.command
        assert ((commands >= 0.0) & (commands <= 1.0)).all()
    assert port.peers[0].parser.total_packets_received > 3000
    assert np.isfinite(standin.autopilot.plant.state).all()
