"""Files of other programs, and logs of other vehicles: named for what they are, by every reader alike."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from test_data_dataflash_text import KINDS, as_binary, rows
from test_data_ulog import framed

from coaxlink.data import is_flight_log, read_flight_log, read_flights, read_stand_log
from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.data.samples import RANGE
from coaxlink.errors import InputError

BLACKBOX = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
BSON = struct.pack("<i", 33) + b"\x01time_s\0" + struct.pack("<d", 1.0) + b"\x10n\0" + bytes(10)
FILES = {
    "blackbox of INAV": (
        BLACKBOX + b"H Firmware revision:INAV 7.1.0 (abc) X\n",
        "a blackbox log of INAV 7.1.0",
    ),
    "blackbox of Betaflight": (
        BLACKBOX + b"H Firmware revision:Betaflight 4.4\n",
        "blackbox log of Betaflight",
    ),
    "its explorer's table": (b'"Product","Blackbox flight data recorder by N S"\n"a",1\n', "a blackbox log"),
    "its decoder's table": (b"loopIteration, time (us), axisP[0]\n0, 1, 2\n", "a blackbox log"),
    "JSON": (b'{"time_s": [0, 1]}', "a JSON file"),
    "a list": (b'[\n  {"a": 1}]', "a JSON file"),
    "a plan": (b'{\n "fileType": "Plan", "geoFence": {}}', "a mission plan of QGroundControl"),
    "BSON": (BSON, "BSON"),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(40), "an HDF5 file"),
    "a bag": (b"#ROSBAG V2.0\n" + bytes(40), "a ROS bag"),
    "packed": (b"\x1f\x8b\x08" + bytes(40), "a gzip archive"),
    "PX4 1.13": (
        b"#!/bin/sh\n. ${R}etc/init.d/rc.mc_defaults\nset MIXER octo_cox\n",
        "mixer octo_cox; start from",
    ),
    "PX4 1.10": (b"#!nsh\nsh /etc/init.d/rc.mc_defaults\nset MIXER hexa_cox\n", "start from `template` y6"),
    "a mixer": (b"# octo\n\nR: 8c 10000 10000 10000 0\n", "a mixer file of PX4 1.13 or older"),
}


def test_each_is_named_whoever_reads_it(tmp_path: Path) -> None:
    with case_table() as case:
        for name, (data, expected) in FILES.items():
            for suffix in ("bin", "csv", "params", "tlog"):
                path = tmp_path / f"file.{suffix}"
                path.write_bytes(data)
                for read in (read_flights, is_flight_log, read_board_parameters, read_stand_log):
                    with case(f"{name} {suffix}"), pytest.raises(InputError, match=expected):
                        read(path)


def test_what_only_resembles_them_is_read(tmp_path: Path) -> None:
    path = tmp_path / "airframe"
    path.write_text(". ${R}etc/init.d/rc.mc_defaults\nset MIXER octo_cox\nparam set CA_ROTOR_COUNT 8\n")
    assert read_board_parameters(path).params == {"CA_ROTOR_COUNT": 8}
    path.write_text("time_s,motor1,loopIteration\n0,0.5,1\n")
    assert is_flight_log(path)


def in_milliseconds(messages: list[tuple]) -> bytes:
    """The messages as ArduCopter 3.2 wrote them: TimeMS, and no time where none was."""
    old = {
        "PARM": (129, "Nf", "<16sf", "Name,Value"),
        "MSG": (130, "Z", "<64s", "Message"),
        "RCOU": (131, "IHH", "<IHH", "TimeMS,Ch1,Ch2"),
        "IMU": (132, "Iffffff", "<Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ATT": (133, "Iccc", "<Ihhh", "TimeMS,Roll,Pitch,Yaw"),
        "EV": (135, "B", "<B", "Id"),
    }
    found = []
    for name, *fields in messages:
        if name == "ESC":
            continue
        us, rest = fields[0], fields[1:]
        rest = rest[1:] if name == "IMU" else rest
        found.append((name, *([us // 1000] if name in ("RCOU", "IMU", "ATT") else []), *rest))
    kinds = dict(KINDS)
    try:
        KINDS.update(old)
        KINDS.pop("ESC")
        return as_binary(found)
    finally:
        KINDS.clear()
        KINDS.update(kinds)


def test_dataflash_in_milliseconds_is_read(tmp_path: Path) -> None:
    new, old = tmp_path / "new.bin", tmp_path / "old.bin"
    new.write_bytes(as_binary(rows()))
    old.write_bytes(in_milliseconds(rows()))
    now, then = read_flight_log(new), read_flight_log(old)
    for name in ("time_s", "motor1", "accel_z_m_s2", "roll_rad"):
        np.testing.assert_allclose(then[name], now[name], atol=1e-6, err_msg=name)
    assert then.parameters == now.parameters and then.premises == ()
    assert [text for *_, text in then.texts] == [text for *_, text in now.texts]
    assert read_board_parameters(old).params["SERVO1_FUNCTION"] == 33.0


def test_outputs_that_drive_surfaces_are_no_motors(tmp_path: Path) -> None:
    path = tmp_path / "plane.bin"
    functions = {"SERVO1_FUNCTION": 4.0, "SERVO2_FUNCTION": 19.0}
    path.write_bytes(
        as_binary([(*m[:3], functions.get(m[2], m[3])) if m[0] == "PARM" else m for m in rows()])
    )
    with pytest.raises(
        InputError, match=r"no output of this log drives a motor \(SERVO1_FUNCTION 4 \(aileron\)"
    ):
        read_flight_log(path)


def test_the_log_of_a_rover_whose_outputs_are_called_motors_is_none_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "rover.bin"
    first = next(m for m in rows() if m[0] == "PARM")
    path.write_bytes(as_binary([(*first[:2], "CRUISE_SPEED", 2.0), *rows()]))
    with pytest.raises(InputError, match=r"the log of a rover or boat .*: a multirotor's is expected"):
        read_flight_log(path)


def test_motors_without_a_range_run_as_the_radio_s_throttle(tmp_path: Path) -> None:
    path = tmp_path / "f.bin"
    with case_table() as case:
        for given, low, high, premises in (
            ({"MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0, "RC3_MIN": 1100.0, "RC3_MAX": 1900.0}, 1100, 1900, ()),
            ({"RC3_MIN": 1100.0, "RC3_MAX": 1900.0}, 1100, 1900, ()),
            ({"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1050.0, "RC1_MAX": 1950.0}, 1050, 1950, ()),
            ({"MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0}, 1000, 2000, (RANGE,)),
            ({"MOT_PWM_MIN": 1200.0, "MOT_PWM_MAX": 1800.0, "RC3_MIN": 1100.0}, 1200, 1800, ()),
        ):
            with case(str(given)):
                kept = [m for m in rows() if not (m[0] == "PARM" and m[2].startswith("MOT"))]
                path.write_bytes(as_binary([("PARM", 0, n, v) for n, v in given.items()] + kept))
                log = read_flight_log(path)
                assert log["motor1"][0] == pytest.approx((1400 - low) / (high - low))
                assert log.premises == premises


def test_formats_that_hold_one_another_beyond_a_message_end_in_a_line(tmp_path: Path) -> None:
    def log(*formats: str, ids: int = 1) -> bytes:
        head = b"ULog\x01\x12\x35\x01" + bytes(8) + framed("B", bytes(40))
        determined = [framed("F", text.encode()) for text in formats]
        determined += [framed("A", struct.pack("<BH", k % 250, k) + b"vehicle_attitude") for k in range(ids)]
        return head + b"".join(determined) + framed("D", struct.pack("<HQ", 0, 1))

    chain = [f"f{k}:f{k + 1}[1000] a;f{k + 1}[1000] b;" for k in range(12)] + ["f12:float x;"]
    deep = [f"f{k}:f{k + 1} a;" for k in range(3000)] + ["f3000:float x;"]
    began = time.monotonic()
    path = tmp_path / "n.ulg"
    with case_table() as case:
        for name, data, expected in (
            ("doubled", log("vehicle_attitude:uint64_t timestamp;f0 a;", *chain), "65535 bytes"),
            ("deep", log("vehicle_attitude:uint64_t timestamp;f0 a;", *deep), "within itself"),
            ("itself", log("vehicle_attitude:vehicle_attitude a;"), "within itself"),
            (
                "often",
                log("vehicle_attitude:uint64_t timestamp;uint8_t[60000] a;", ids=2000),
                "120002000 fields",
            ),
        ):
            with case(name):
                path.write_bytes(data)
                with pytest.raises(InputError, match=expected):
                    read_flights(path)
    assert time.monotonic() - began < 10.0
