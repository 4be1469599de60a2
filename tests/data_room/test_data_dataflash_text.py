"""DataFlash logs as text, as Mission Planner hands them round: the same columns as of the binary log."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from coaxlink.data import is_flight_log, read_flight_log
from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.data.logs.dataflash import dataflash_parameters
from coaxlink.errors import InputError

# name: number, letters of the format, struct, fields, scale of the fields with letter c in the binary
KINDS = {
    "FMT": (128, "BBnNZ", "<BB4s16s64s", "Type,Length,Name,Format,Columns"),
    "PARM": (129, "QNf", "<Q16sf", "TimeUS,Name,Value"),
    "MSG": (130, "QZ", "<Q64s", "TimeUS,Message"),
    "RCOU": (131, "QHH", "<QHH", "TimeUS,C1,C2"),
    "IMU": (132, "QBffffff", "<QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (133, "Qccc", "<Qhhh", "TimeUS,Roll,Pitch,Yaw"),
    "ESC": (134, "QBf", "<QBf", "TimeUS,Instance,RPM"),
    "EV": (135, "QB", "<QB", "TimeUS,Id"),
}


def rows(esc_every_s: float = 0.1, events: tuple[int, ...] = (10, 28)) -> list[tuple]:
    """Messages of six seconds: name and fields, angles in degrees."""
    out = [("PARM", 0, "SERVO1_FUNCTION", 33.0), ("PARM", 0, "SERVO2_FUNCTION", 34.0)]
    out += [("PARM", 0, "MOT_PWM_MIN", 1000.0), ("PARM", 0, "MOT_PWM_MAX", 2000.0)]
    out.append(("MSG", 0, "ArduCopter V4.5.7, a text, with commas"))
    out += [("EV", 0, event) for event in events]
    for k in range(60):
        t, us = k * 100_000, 1400 + 5 * k
        out.append(("RCOU", t, us, 3000 - us))
        out.append(("IMU", t, 0, 0.0, 0.5, 0.25, 0.0, 0.0, -9.75))
        out.append(("ATT", t, 0.25 * (k % 8), 1.5, 90.0))
        if round(k % (esc_every_s * 10)) == 0:
            out += [("ESC", t, motor, 1000.0 + 10 * k + motor) for motor in (0, 1)]
    return out


def as_text(messages: list[tuple], gap: str = ", ") -> str:
    lines = [
        gap.join(["FMT", str(n), str(3 + struct.calcsize(form)), name, letters, fields])
        for name, (n, letters, form, fields) in KINDS.items()
    ]
    return "\n".join([*lines, *(gap.join(map(str, row)) for row in messages)]) + "\n"


def as_binary(messages: list[tuple]) -> bytes:
    def one(name: str, fields: tuple) -> bytes:
        number, letters, form, _ = KINDS[name]
        scaled = [
            f.encode() if isinstance(f, str) else round(100 * f) if letter == "c" else f
            for f, letter in zip(fields, letters, strict=True)
        ]
        return b"\xa3\x95" + bytes([number]) + struct.pack(form, *scaled)

    head = [
        one("FMT", (n, 3 + struct.calcsize(form), name, letters, fields))
        for name, (n, letters, form, fields) in KINDS.items()
    ]
    return b"".join([*head, *(one(name, tuple(fields)) for name, *fields in messages)])


def test_text_and_binary_are_one_log(tmp_path: Path) -> None:
    text, binary = tmp_path / "flight.log", tmp_path / "flight.bin"
    binary.write_bytes(as_binary(rows()))
    known = read_flight_log(binary)
    with case_table() as case:
        for name, content in {
            "as Mission Planner": as_text(rows()),
            "without blanks": as_text(rows(), ","),
            "with a mark and a preface": "\ufeffArduCopter\n\n" + as_text(rows()).replace("\n", "\r\n"),
            "as PowerShell writes it": "utf-16" + as_text(rows()),
            "last line cut": as_text(rows()) + "IMU, 6000000, 0, 0.0",
        }.items():
            with case(name):
                wide = content.startswith("utf-16")
                text.write_bytes(content.removeprefix("utf-16").encode("utf-16" if wide else "utf-8"))
                assert is_flight_log(text)
                log = read_flight_log(text)
                assert log.columns.keys() == known.columns.keys() and log.premises == known.premises == ()
                for column, values in log.columns.items():
                    np.testing.assert_allclose(values, known[column], atol=1e-6, err_msg=column)
                assert dataflash_parameters(text) == dataflash_parameters(binary)
                assert log.texts == known.texts


def test_a_torn_line_inside_is_damage_and_a_printout_is_answered(tmp_path: Path) -> None:
    path = tmp_path / "flight.log"
    path.write_text(as_text(rows()).replace("RCOU, 3000000, 1550, 1450", "RCOU, 3000000, 15"))
    assert read_flight_log(path).premises == ("damaged",)
    with pytest.raises(InputError, match="the file is damaged"):  # none of it goes to a board or vehicle file
        read_board_parameters(path)
    path.write_text("2024-05-01 10:00:00.10: ATT {TimeUS : 100, Roll : 0.1}\n")
    with pytest.raises(InputError, match=r"printout of mavlogdump: the \.bin or \.tlog"):
        read_flight_log(path)


def test_a_log_that_begins_in_the_air_is_flown_from_its_first_row(tmp_path: Path) -> None:
    path = tmp_path / "flight.log"
    with case_table() as case:
        for name, events in {"landing alone": (18, 11), "no event": ()}.items():
            with case(name):
                messages = rows(events=())
                messages += [("EV", 5_500_000, event) for event in events]
                path.write_text(as_text(messages))
                log = read_flight_log(path)
                if events:
                    assert log["armed"][0] == 1.0 and log["landed"][0] == 0.0
                    assert log["armed"][-1] == 0.0 and log["landed"][-1] == 1.0
                else:
                    assert not log.has("armed") and not log.has("landed")


def test_speeds_once_a_second_are_speeds_where_they_came_alone(tmp_path: Path) -> None:
    path = tmp_path / "flight.log"
    path.write_text(as_text(rows(esc_every_s=1.0)))
    log = read_flight_log(path)
    known = np.isfinite(log["rpm1"])
    np.testing.assert_allclose(log["time_s"][known], np.arange(6.0))
    np.testing.assert_allclose(log["rpm2"][known], 1001.0 + 100.0 * np.arange(6))
    assert any("rpm come every 1 s" in note for note in log.notes)
