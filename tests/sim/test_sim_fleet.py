"""Several vehicles in one process: own ports, own system ids, own flights, flown at once by pymavlink."""

import itertools
import math
import socket
import struct
from contextlib import ExitStack
from pathlib import Path

import pytest
from ground import client, command, get

from coaxlink.studies.simulator import free_port
from sim.errors import SimError, WorldError
from sim.testing import standin, standins
from sim.world import World, build_many

EXAMPLES = Path(__file__).parents[2] / "examples"


def as_int(field: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", field))[0])


@pytest.mark.parametrize(("firmware", "id_name"), [("px4", b"MAV_SYS_ID"), ("ardupilot", b"MAV_SYSID")])
def test_three_fly_at_once(firmware: str, id_name: bytes) -> None:
    with ExitStack() as stack:
        ports = stack.enter_context(standins("--vehicles", "3", "--firmware", firmware, "--speed", "2"))
        assert len(set(ports)) == 3
        links = [stack.enter_context(client(port)) for port in ports]
        for system, link in enumerate(links, 1):
            assert link.target_system == system
            for unread in (30, 31, 83, 85, 105, 132, 291, 375):
                link.mav.command_long_send(system, 1, 511, 0, unread, -1, 0, 0, 0, 0, 0)
            for number in (32, 33):
                assert command(link, 511, number, 100000, system=system) == 0
            if firmware == "ardupilot":
                assert command(link, 176, 1, 4, system=system) == 0
            else:  # a busy machine may take its time between arming and take-off
                link.mav.param_set_send(system, 1, b"COM_DISARM_PRFLT", -1.0, 9)
        links[2].mav.command_long_send(2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)  # not its own number: not heard
        links[1].mav.param_request_read_send(2, 1, id_name, -1)
        answer = get(links[1], "PARAM_VALUE", met=lambda v: v.param_id == id_name.decode())
        number = answer.param_value if firmware == "ardupilot" else as_int(answer.param_value)
        assert number == 2
        boards = set()
        for system, link in enumerate(links, 1):
            assert command(link, 512, 148, system=system) == 0
            version = get(link, "AUTOPILOT_VERSION")
            boards.add((version.uid, bytes(version.uid2)))
        assert len(boards) == 3
        heights = (3.0, 4.0, 5.0)
        for system, (link, height) in enumerate(zip(links, heights, strict=True), 1):
            assert not get(link, "HEARTBEAT").base_mode & 128
            assert command(link, 400, 1, system=system) == 0
            sea = height if firmware == "ardupilot" else 488.0 + height
            assert command(link, 22, 0, 0, 0, math.nan, math.nan, math.nan, sea, system=system) == 0
        for link, height in zip(links, heights, strict=True):
            low, high = -height - 0.25, -height + 0.25
            assert get(link, "LOCAL_POSITION_NED", met=lambda p, a=low, b=high: a < p.z < b) is not None
        east = [get(link, "GLOBAL_POSITION_INT").lon * 1e-7 for link in links]
        apart = [(b - a) * 111319.49 * math.cos(math.radians(47.397742)) for a, b in itertools.pairwise(east)]
        assert apart == pytest.approx([5.0, 5.0], abs=0.5)
        assert command(links[1], 21, system=2) == 0
        assert get(links[1], "HEARTBEAT", met=lambda h: not h.base_mode & 128) is not None
        assert get(links[0], "HEARTBEAT").base_mode & 128 and get(links[2], "HEARTBEAT").base_mode & 128


def test_ports_follow_one_another_and_are_let_go() -> None:
    base = free_port()
    world = World(EXAMPLES / "x8_demo.toml")
    address = f"udpin:127.0.0.1:{base}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", base + 2))
        with pytest.raises(SimError, match="cannot be opened"):
            build_many(world, 3, [address], 1.0)
    fleet = build_many(world, 3, [address], 1.0)
    names = [port.name for one in fleet for port in one.ports]
    assert names == [f"udpin:127.0.0.1:{base + k}" for k in range(3)]
    for one in fleet:
        one.ports[0].close()
    with pytest.raises(WorldError, match="1 to 50"):
        build_many(world, 0, [address], 1.0)


def test_a_new_system_id_counts_from_the_next_boot() -> None:
    with standin("--firmware", "ardupilot", "--speed", "4") as port, client(port) as link:
        link.mav.param_set_send(1, 1, b"MAV_SYSID", 42.0, 4)
        assert get(link, "PARAM_VALUE").param_value == 42
        assert get(link, "HEARTBEAT").get_srcSystem() == 1
        assert command(link, 246, 1) == 0
        assert get(link, "HEARTBEAT", met=lambda h: h.get_srcSystem() == 42) is not None
        assert command(link, 511, 32, 100000, system=42) == 0


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_a_board_says_the_uid_it_was_given_as_real_ones_do(firmware: str) -> None:
    def boards(*options: str) -> list[tuple[int, bytes]]:
        found = []
        with ExitStack() as stack:
            for port in stack.enter_context(standins("--firmware", firmware, *options)):
                link = stack.enter_context(client(port))
                assert command(link, 512, 148, system=link.target_system) == 0
                version = get(link, "AUTOPILOT_VERSION")
                found.append((version.uid, bytes(version.uid2)))
        return found

    words = bytes.fromhex("111111112222222233333333")
    one, two = boards("--uid", words.hex(), "--vehicles", "2")
    if firmware == "px4":  # stm32_common/version/board_identity.c, mavlink_main.cpp
        assert one == (0x2222222211111111, b"\x00\x06\x00\x00\x00\x00" + words)
        assert two[1].endswith(b"\x33\x33\x33\x34")
    else:  # AP_HAL_ChibiOS/Util.cpp, GCS_Common.cpp
        assert one == (0, words + bytes(6))
        assert two[1][:12].endswith(b"\x34")
    assert boards("--uid", "0") == [(0, bytes(18))]
    assert boards() == boards()


@pytest.mark.parametrize("uid", ["", "x", "1" * 25, "-1", "0x1", "1\n"])
def test_a_uid_that_is_none_is_refused(uid: str) -> None:
    from sim.world import read_uid

    with pytest.raises(WorldError, match="hex digits are expected"):
        read_uid(uid)
