"""What is said on the wire: parameters, a flight by set-points, live motors, tables, missions, ESCs, keys."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_table import case_table
from pymavlink.dialects.v20 import ardupilotmega as m
from sim_pilot import Pilot

from sim.errors import SimulationError
from sim.px4.autopilot import Mode
from sim.simulation import read_key, read_uid

NAN = math.nan
LAT, LON, METRE = 47.397742, 8.545594, 1 / 111319.49
TAKEOFF, WAYPOINT, LAND, RTL, JUMP = 22, 16, 21, 20, 177


def as_int(field: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", field))[0])


def target(z: float, yaw: float = 0.0) -> Any:
    return m.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0x0800, 0.5, 0.0, z, 0, 0, 0, 0, 0, 0, yaw, 0.0
    )


def test_px4_s_list_starts_with_the_hash_of_what_follows() -> None:
    pilot = Pilot()
    pilot.say(m.MAVLink_param_request_list_message(1, 1))
    pilot.run(1.0)
    first, *values = pilot.heard("PARAM_VALUE")
    assert (first.param_id, first.param_index, first.param_type) == ("_HASH_CHECK", 65535, 5)
    assert [v.param_index for v in values] == list(range(first.param_count))
    crc = 0
    for v in values:
        form, value = ("<i", as_int(v.param_value)) if v.param_type == 6 else ("<f", v.param_value)
        crc = zlib.crc32(v.param_id.encode() + struct.pack(form, value), crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert crc == struct.unpack("<I", struct.pack("<f", first.param_value))[0]


def test_a_new_value_is_answered_and_told_and_a_wrong_type_is_not_taken() -> None:
    pilot = Pilot()
    assert [v.param_value for v in pilot.set("CA_ROTOR0_CT", 30.0)] == [30.0, 30.0]
    assert len(pilot.set("CA_ROTOR0_CT", 30.0)) == 1  # no news
    assert pilot.set("CA_ROTOR0_CT", 1.0, 6) == [] and pilot.set("NO_SUCH", 1.0) == []
    assert pilot.set("CA_ROTOR0_CT", NAN) == []
    read = m.MAVLink_param_request_read_message(1, 1, b"CA_ROTOR0_CT", -1)
    assert pilot.answers(read, kind="PARAM_VALUE")[0].param_value == 30.0


def test_ardupilot_s_values_come_back_as_the_board_keeps_them() -> None:
    pilot = Pilot("ardupilot")
    for name, value, kept in (
        ("FRAME_CLASS", 3.7, 3.0), ("FRAME_CLASS", 300.0, 127.0), ("MOT_THST_EXPO", 5.0, 5.0),
    ):  # fmt: skip
        assert pilot.set(name, value)[-1].param_value == kept, name
    unknown = m.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)
    assert pilot.answers(unknown, kind="PARAM_ERROR")
    pilot.run(1.0)
    assert not pilot.heard("ATTITUDE")  # it says nothing unasked
    pilot.say(m.MAVLink_request_data_stream_message(1, 1, 10, 5, 1))
    pilot.run(1.0)
    assert pilot.heard("ATTITUDE")
    for number in (291, 11031):
        assert pilot.command(511, number, 50_000) == 2
        assert pilot.heard("STATUSTEXT")[-1].text == f"No ap_message for mavlink id ({number})"


@pytest.mark.slow
def test_offboard_follows_a_stream_and_holds_without_it() -> None:
    pilot = Pilot()
    pilot.run(0.3, lambda: pilot.say(target(-2.0)))
    assert pilot.command(400, 1) == 0
    assert pilot.command(246, 1) == 2  # no reboot while armed
    assert pilot.command(176, 1, 6, 0) == 0
    pilot.run(6.0, lambda: pilot.say(target(-2.0, 0.3)))
    assert pilot.heard("LOCAL_POSITION_NED")[-1].z == pytest.approx(-2.0, abs=0.3)
    assert pilot.command(400, 0) != 0  # not in the air
    pilot.run(2.0)
    beat = pilot.heard("HEARTBEAT")[-1]
    assert beat.custom_mode == Mode.HOLD and beat.base_mode & 128
    assert pilot.command(21) == 0
    pilot.until(lambda: not pilot.autopilot.armed)
    pilot.run(1.0)
    servo = pilot.heard("SERVO_OUTPUT_RAW")[-1]
    assert [getattr(servo, f"servo{n}_raw") for n in range(1, 10)] == [900] * 8 + [0]


@pytest.mark.slow
@pytest.mark.parametrize(("firmware", "taken"), [("px4:1.13", True), ("px4", False)])
def test_live_motor_commands_are_taken_by_1_13_only(firmware: str, taken: bool) -> None:
    pilot = Pilot(firmware)
    assert pilot.command(511, 140, 4000) == (0 if taken else 4)
    pilot.climb(2.0)
    live = m.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.31] * 8)
    pilot.run(0.2, lambda: pilot.say(live))
    assert (pilot.autopilot.outputs_us == [1310.0] * 8) == taken
    assert len(pilot.heard("ACTUATOR_CONTROL_TARGET")) > 100 or not taken
    pilot.run(0.3)  # the stream has stopped: its own mixer flies again
    assert pilot.autopilot.outputs_us != [1310.0] * 8


def test_a_table_acts_at_once() -> None:
    pilot = Pilot()
    pilot.climb(2.0)

    def ratio() -> float:
        us = np.array(pilot.autopilot.outputs_us) - 1000
        return float(us[4:].sum() / us[:4].sum())

    assert ratio() == pytest.approx(1.0, abs=0.03)
    for n in range(4):
        pilot.set(f"CA_ROTOR{n}_CT", 4.37)
    pilot.run(0.3)
    assert ratio() == pytest.approx(6.5 / 4.37, abs=0.05)


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_who_asks_for_a_mission_is_told_that_there_is_none(firmware: str) -> None:
    pilot = Pilot(firmware)
    (counted,) = pilot.answers(m.MAVLink_mission_request_list_message(1, 1, 0), kind="MISSION_COUNT")
    (refused,) = pilot.answers(m.MAVLink_mission_count_message(1, 1, 2, 0), kind="MISSION_ACK")
    assert counted.count == 0 and refused.type == 3
    assert pilot.command(300) != 0


@pytest.mark.slow
def test_escs_tell_what_they_measure_or_what_the_real_simulations_make_up() -> None:
    with case_table() as case:
        for kind in ("measured", "sitl", "none"):
            for firmware in ("px4", "ardupilot"):
                with case(f"{firmware}, {kind}"):
                    pilot = Pilot(firmware, escs=kind)
                    assert pilot.command(511, 11030 if pilot.copter else 291, 50_000) == 0
                    pilot.climb()
                    names = (
                        ["ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8"] if pilot.copter else ["ESC_STATUS"]
                    )
                    determined = [message.rpm for name in names for message in pilot.heard(name)[-20:]]
                    if kind == "none":
                        assert not determined
                        continue
                    outputs = (np.array(pilot.autopilot.outputs_us) - 1000) / 1000
                    full = np.mean(determined) / np.mean(outputs)
                    made_up = 0.0 if pilot.copter else 6000.0
                    assert full == pytest.approx(made_up if kind == "sitl" else 5400.0, rel=0.05)


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_a_board_says_the_uid_it_was_given_as_real_ones_do(firmware: str) -> None:
    pilot = Pilot(firmware, uid="0123456789abcdef01234567")
    command = m.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    version = pilot.answers(command, kind="AUTOPILOT_VERSION")[0]
    at = 0 if pilot.copter else 6  # PX4 puts its kind of processor first
    assert bytes(version.uid2)[at : at + 12] == bytes.fromhex("0123456789abcdef01234567")
    for text in ("", "xyz", "0" * 25):
        with pytest.raises(SimulationError, match="hex digits"):
            read_uid(text)


KEY = bytes(range(32))


def signed(pilot: Pilot, key: bytes | None) -> None:
    """Sign what is said from now on, or no longer."""
    pilot.mav.signing = m.MAVLinkSigning()
    pilot.mav.signing.sign_outgoing = key is not None
    pilot.mav.signing.secret_key = key
    pilot.mav.signing.timestamp = 10**15


@pytest.mark.parametrize(("firmware", "name"), [("px4", "CA_ROTOR0_CT"), ("ardupilot", "MOT_THST_EXPO")])
def test_only_who_has_the_key_is_heard_and_no_replay_on_another_link(
    tmp_path: Path, firmware: str, name: str
) -> None:
    (tmp_path / "key").write_bytes(KEY)
    pilot = Pilot(firmware, ports=2, signing_key=tmp_path / "key")
    held = pilot.autopilot.store[name]
    for key in (None, bytes(32 * [7])):
        signed(pilot, key)
        pilot.set(name, 0.75)
        assert pilot.autopilot.store[name] == held, key
    signed(pilot, KEY)
    stolen = m.MAVLink_param_set_message(1, 1, name.encode(), 0.5, 9).pack(pilot.mav)
    pilot.ports[0].put(0, stolen)
    pilot.run(0.01)
    assert pilot.autopilot.store[name] == 0.5
    pilot.set(name, 0.625)
    future = bytearray(stolen)
    future[-12:-6] = b"\xff" * 6  # a forger must not move the clock of the true sender
    pilot.ports[1].put(0, stolen + bytes(future))
    pilot.run(0.01)
    assert pilot.autopilot.store[name] == 0.625
    pilot.set(name, 0.25)
    assert pilot.autopilot.store[name] == 0.25


def test_a_key_is_set_up_and_taken_away() -> None:
    pilot = Pilot()
    for key, mine, value in ((KEY, None, None), (KEY, KEY, 9.0), (bytes(32), KEY, None), (None, None, 8.0)):
        if value is None:
            pilot.say(m.MAVLink_setup_signing_message(1, 1, key, 0))
            pilot.run(0.01)
            signed(pilot, mine)
            continue
        signed(pilot, mine)
        pilot.set("CA_ROTOR0_CT", value)
        assert pilot.autopilot.store["CA_ROTOR0_CT"] == value


def test_keys_are_read_as_ground_stations_write_them(tmp_path: Path) -> None:
    path = tmp_path / "key"
    for data, read in ((KEY, KEY), (KEY.hex().encode() + b"\n", KEY), (b"open sesame", None)):
        path.write_bytes(data)
        assert read_key(path) == read or (read is None and len(read_key(path)) == 32)
    path.write_text("")
    with pytest.raises(SimulationError, match="found nothing"):
        read_key(path)
    with pytest.raises(SimulationError, match="cannot be read"):
        read_key(tmp_path / "none")
