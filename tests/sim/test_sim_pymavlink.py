"""A bare pymavlink client: PX4's manners on the wire, a flight, live motor commands, links that end."""

import itertools
import math
import socket
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from ground import client, command, get
from pymavlink.dialects.v20 import common as m

from sim.errors import SimError
from sim.testing import standin

HOLD, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16


def count(link: Any, kind: str, seconds: float, met: Callable[[Any], bool] = lambda _: True) -> int:
    end, n = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        message = link.recv_match(type=kind, blocking=True, timeout=0.05)
        n += message is not None and met(message)
    return n


def as_int(field: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", field))[0])


@pytest.fixture(scope="module")
def link() -> Iterator[Any]:
    with standin("--speed", "4") as port, client(port, dialect="common") as c:
        yield c


def test_the_list_starts_with_the_hash_of_what_follows(link: Any) -> None:
    link.mav.param_request_list_send(1, 1)
    first = get(link, "PARAM_VALUE")
    assert first.param_id == "_HASH_CHECK" and first.param_index == 65535 and first.param_type == 5
    values: dict[int, Any] = {}
    while len(values) < first.param_count:
        message = get(link, "PARAM_VALUE")
        assert message is not None, f"{len(values)} of {first.param_count}"
        values[message.param_index] = message
    crc = 0
    for index in range(first.param_count):
        v = values[index]
        form, value = ("<i", as_int(v.param_value)) if v.param_type == 6 else ("<f", v.param_value)
        crc = zlib.crc32(v.param_id.encode() + struct.pack(form, value), crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert crc == as_int(first.param_value) & 0xFFFFFFFF
    by_name = {v.param_id: v for v in values.values()}
    assert as_int(by_name["CA_ROTOR_COUNT"].param_value) == 8
    assert as_int(by_name["PWM_MAIN_FUNC8"].param_value) == 108
    assert by_name["CA_ROTOR0_KM"].param_value == pytest.approx(0.05)
    assert by_name["CA_ROTOR1_KM"].param_value == pytest.approx(-0.05)
    assert "SYS_CTRL_ALLOC" not in by_name and {"CA_METHOD", "MPC_THR_HOVER"} <= set(by_name)


def test_a_change_echoes_twice_and_the_same_value_once(link: Any) -> None:
    def echoes(value: float) -> list[float]:
        link.mav.param_set_send(1, 1, b"CA_ROTOR2_CT", value, 9)
        received = []
        while (message := get(link, "PARAM_VALUE", 0.4)) is not None:
            received.append(message.param_value)
        return received

    assert echoes(150.0) == [150.0, 150.0]  # out of range, and taken
    assert echoes(150.0) == [150.0]
    assert echoes(6.5) == [6.5, 6.5]


def test_unknown_names_and_wrong_types_are_met_with_silence(link: Any) -> None:
    link.mav.param_set_send(1, 1, b"CA_ROTOR2_CT", 7.0, 6)  # a float set as an int32
    link.mav.param_set_send(1, 1, b"NO_SUCH", 7.0, 9)
    link.mav.param_request_read_send(1, 1, b"NO_SUCH", -1)
    link.mav.param_request_read_send(7, 1, b"CA_ROTOR2_CT", -1)  # of another vehicle
    assert get(link, "PARAM_VALUE", 0.6) is None
    link.mav.param_set_send(1, 1, b"CA_METHOD", struct.unpack("<f", struct.pack("<i", 1))[0], 6)
    assert as_int(get(link, "PARAM_VALUE").param_value) == 1
    link.mav.param_set_send(1, 1, b"CA_METHOD", 1.0, 6)  # a C cast instead of the bytes
    assert (
        as_int(get(link, "PARAM_VALUE", met=lambda v: as_int(v.param_value) != 1).param_value) == 1065353216
    )
    link.mav.param_set_send(1, 1, b"CA_METHOD", struct.unpack("<f", struct.pack("<i", 2))[0], 6)


def test_streams_and_commands(link: Any) -> None:
    assert command(link, 511, 105, 10000) == 0  # 100 Hz of simulated time
    times = [get(link, "HIGHRES_IMU").time_usec for _ in range(200)]
    gaps = sorted(b - a for a, b in itertools.pairwise(times))
    assert gaps[100] in (8000, 12000) and (times[-1] - times[0]) / 199 < 11000  # on a grid of 4 ms
    assert command(link, 511, 105, -1) == 0
    assert count(link, "HIGHRES_IMU", 0.4) <= 20
    assert command(link, 511, 105, 0) == 0
    assert command(link, 511, 9999, 5000) == 4 and command(link, 31010) == 3  # as the real one
    assert command(link, 512, 148) == 0
    version = get(link, "AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 8 == 0x011001 and version.capabilities & 16
    stamps = [get(link, "ATTITUDE").time_boot_ms for _ in range(20)]
    assert all(b > a for a, b in itertools.pairwise(stamps))
    # where no other test came before: its clock goes on while it boots, and must have shown more before that
    since = get(link, "ATTITUDE", met=lambda a: a.time_boot_ms > 30_000).time_boot_ms
    assert command(link, 176, 1, 6, 0) == 2  # offboard without a stream
    assert command(link, 400, 0) == 0 and command(link, 246, 1) == 0
    assert get(link, "HEARTBEAT", 1.0) is None  # it is away for a while
    assert get(link, "ATTITUDE").time_boot_ms < since  # and its clock starts anew


def test_offboard_follows_a_stream_and_holds_without_it(link: Any) -> None:
    def stream(seconds: float, z: float) -> Any:
        end, message = time.monotonic() + seconds, None
        while time.monotonic() < end:
            message = get(link, "LOCAL_POSITION_NED")
            link.mav.set_position_target_local_ned_send(
                0, 1, 1, 1, 0x0800, 0.5, 0.0, z, 0, 0, 0, 0, 0, 0, 0.3, 0.0
            )
        return message

    stream(0.3, -2.0)
    assert command(link, 400, 1) == 0
    assert command(link, 246, 1) == 2  # no reboot while armed
    assert command(link, 176, 1, 6, 0) == 0
    assert abs(stream(2.0, -2.0).z + 2.0) < 0.3
    assert command(link, 400, 0) != 0  # not in the air
    beat = get(link, "HEARTBEAT", met=lambda h: h.custom_mode == HOLD and h.get_srcSystem() == 1)
    assert beat is not None and beat.base_mode & 128, "no failsafe"
    assert abs(get(link, "LOCAL_POSITION_NED").z + 2.0) < 0.5
    assert command(link, 21) == 0
    assert get(link, "HEARTBEAT", 8.0, lambda h: not h.base_mode & 128) is not None, "did not land"
    servo = get(link, "SERVO_OUTPUT_RAW")
    assert [getattr(servo, f"servo{n}_raw") for n in range(1, 10)] == [900] * 8 + [0]


def fly_live(link: Any) -> tuple[int, int]:
    """Take off, then answer every demand with its own eight numbers; outputs seen at them, and elsewhere."""
    link.mav.param_set_send(1, 1, b"COM_DISARM_PRFLT", -1.0, 9)
    command(link, 511, 140, 4000)
    assert command(link, 400, 1) == 0
    assert command(link, 22, 0, 0, 0, math.nan, math.nan, math.nan, math.nan) == 0
    assert get(link, "LOCAL_POSITION_NED", 10.0, lambda p: p.z < -2.0) is not None
    end, own, ours = time.monotonic() + 1.0, 0, 0
    while time.monotonic() < end:
        message = link.recv_match(blocking=True, timeout=0.5)
        kind = "nothing" if message is None else message.get_type()
        if kind == "ACTUATOR_CONTROL_TARGET":
            thrust = 0.30 + 0.01 * (message.controls[3] > 0)
            link.mav.set_actuator_control_target_send(0, 0, 1, 1, [thrust] * 8)
        elif kind == "SERVO_OUTPUT_RAW":
            same = all(getattr(message, f"servo{n}_raw") == 1310 for n in range(1, 9))
            own, ours = own + (not same), ours + same
    return own, ours


@pytest.mark.parametrize(("firmware", "taken"), [("px4:1.13", True), ("px4", False)])
def test_live_motor_commands_are_taken_by_1_13_only(firmware: str, taken: bool) -> None:
    with standin("--firmware", firmware, "--speed", "2") as port, client(port, dialect="common") as link:
        own, ours = fly_live(link)
        assert (ours > 3 * own and ours > 5) if taken else ours == 0
        # the stream has stopped: its own mixer flies again
        servo = get(link, "SERVO_OUTPUT_RAW", 2.0, lambda s: s.servo1_raw not in (1310, 900))
        assert servo is not None


def test_a_table_acts_at_once() -> None:
    with standin("--speed", "4") as port, client(port, dialect="common") as link:
        command(link, 400, 1)
        command(link, 22, 0, 0, 0, math.nan, math.nan, math.nan, math.nan)
        assert get(link, "LOCAL_POSITION_NED", 10.0, lambda p: p.z < -2.0) is not None

        def ratio() -> float:
            s = get(link, "SERVO_OUTPUT_RAW")
            upper = sum(getattr(s, f"servo{n}_raw") - 1000 for n in (1, 2, 3, 4))
            return sum(getattr(s, f"servo{n}_raw") - 1000 for n in (5, 6, 7, 8)) / upper

        assert ratio() == pytest.approx(1.0, abs=0.03)
        for n in range(4):
            link.mav.param_set_send(1, 1, b"CA_ROTOR%d_CT" % n, 4.37, 9)
        time.sleep(0.3)
        while link.recv_match(blocking=False) is not None:
            pass
        assert ratio() == pytest.approx(6.5 / 4.37, abs=0.05)


def test_tcp_serves_two_clients_and_outlives_them() -> None:
    with standin("--speed", "4", kind="tcpin") as port:
        with client(port, "tcp", "common") as a, client(port, "tcp", "common") as b:
            assert get(a, "ATTITUDE") is not None and get(b, "ATTITUDE") is not None
        with client(port, "tcp", "common") as again:
            assert get(again, "ATTITUDE") is not None


def test_a_busy_port_is_one_clear_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SimError, match="cannot be opened") as caught, standin("--listen", address):
            pass
        assert "\n" not in str(caught.value) and "Traceback" not in str(caught.value)


def test_esc_status_covers_eight_motors_in_two_batches(link: Any) -> None:
    from firmware_params.px4.messages import MAVLink_esc_status_message

    assert MAVLink_esc_status_message is not None
    m.mavlink_map[291] = MAVLink_esc_status_message
    found = {}
    while len(found) < 2:
        message = get(link, "ESC_STATUS")
        assert message is not None
        found[message.index] = message.rpm
    assert set(found) == {0, 4} and all(len(r) == 4 for r in found.values())
