"""Whatever arrives, the world goes on: random bytes, and well-formed messages full of nonsense."""

import math
import random
import struct
from typing import Any

import numpy as np
import pytest
from case_table import case_table
from pymavlink.dialects.v20 import common as m
from sim_pilot import Pilot

WILD = [0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 1e30, -1e30, 3.4e38, 1e-40, 255.0, 21196.0]
KINDS = [
    getattr(m, f"MAVLink_{name}_message")
    for names in (
        "command_long command_int set_mode param_set param_request_read param_request_list ping timesync",
        "set_position_target_local_ned set_attitude_target set_actuator_control_target request_data_stream",
        "file_transfer_protocol mission_request_list mission_count mission_item_int mission_item",
        "mission_request_int mission_clear_all mission_set_current",
    )
    for name in names.split()
]
COMMANDS = (
    *(400, 22, 16, 177, 300, 224, 20, 21, 176, 192, 511, 510, 512, 519, 520, 246, 310, 178, 183, 209),
    *(42701, 31010),
)


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


@pytest.mark.slow
def test_nonsense_does_not_stop_the_world() -> None:
    with case_table() as case:
        for firmware in ("px4:1.13", "px4", "ardupilot"):
            with case(f"{firmware}"):
                draw, pilot = random.Random(firmware), Pilot(firmware)
                port, names = pilot.ports[0], list(pilot.autopilot.store.names)
                for tick in range(400):
                    for _ in range(5):
                        port.put(0, nonsense(draw, draw.choice(KINDS), pilot.mav, names))
                    if tick % 7 == 0:
                        port.put(0, draw.randbytes(draw.randrange(1, 400)))
                    pilot.now += 0.004
                    pilot.standin.tick()
                    commands = pilot.autopilot.command
                    assert ((commands >= 0.0) & (commands <= 1.0)).all()
                assert port.peers[0].parser.total_packets_received > 1500
                assert np.isfinite(pilot.autopilot.plant.state).all()
