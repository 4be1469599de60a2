"""Logs over a restart, and recordings of several vehicles: no row of one stretch or vehicle in another's."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from pymavlink.dialects.v20 import common
from test_data_dataflash_text import as_binary, as_text, rows
from test_data_ulog import COMMON, CONTROLS, MOTORS, TWO, ulog

from coaxlink.data import Samples, read_flight_log, read_flights
from coaxlink.data.logs.board_parameters import read_board_parameters
from coaxlink.data.logs.stretches import ONBOARD_S, Stream, cuts
from coaxlink.data.samples import DAMAGED
from coaxlink.errors import InputError

SHARED = Path(__file__).parents[2] / ".." / "shared"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is not beside this checkout")
TOPICS = {(MOTORS, 0): CONTROLS, **COMMON}


def link(
    out: bytearray,
    boot_s: float,
    wall_s: float,
    *,
    system: int = 1,
    motor: float = 0.5,
    roll: float = 0.1,
    seconds: float = 6.0,
    late: tuple[int, ...] = (),
    begin_s: float = 0.0,
) -> None:
    """A vehicle's telemetry at 20 Hz from `boot_s` of its clock and `wall_s` of the recorder's on."""
    mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
    frames = []
    for k in range(round(begin_s * 20), round(seconds * 20)):
        ms = round(1000 * boot_s) + 50 * k
        messages = [
            common.MAVLink_attitude_message(ms, roll, 0.0, 0.0, 0, 0, 0),
            common.MAVLink_highres_imu_message(1000 * ms, *[0] * 2, -9.8, *[0] * 10, 63, 0),
            common.MAVLink_actuator_output_status_message(
                1000 * ms, 8, [1000 + 1000 * motor] * 8 + [0.0] * 24
            ),
        ]
        if k % 20 == 0:
            messages.append(common.MAVLink_heartbeat_message(2, 12, 128, 0, 4, 3))
        wall = round(1.7e15 + 1e6 * (wall_s + k / 20))
        frames.append(b"".join(struct.pack(">Q", wall) + m.pack(mav) for m in messages))
    for place in late:  # a packet that the link delivers later than the one after it
        frames[place], frames[place + 1] = frames[place + 1], frames[place]
    out += b"".join(frames)


def tlog(folder: Path, *vehicles: dict[str, float]) -> Path:
    """A recording of them one after another."""
    data = bytearray()
    for vehicle in vehicles:
        link(data, **vehicle)
    path = folder / "link.tlog"
    path.write_bytes(data)
    return path


def dataflash(seconds: float, gain: float = 1.0) -> list[tuple]:
    """The messages of `rows`, so much later, all commands times `gain`."""
    found = []
    for name, *fields in rows():
        if name == "RCOU":
            fields = [fields[0], *(round(1000 + gain * (us - 1000)) for us in fields[1:])]
        found.append((name, round(fields[0] + 1e6 * seconds), *fields[1:]))
    return found


def test_each_stretch_is_a_table_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "log"
    later = ulog(TOPICS, TWO, 7_000_000)
    whole, again = ulog(TOPICS, TWO, 9_000_000), ulog(TOPICS, TWO, 2_000_000)
    messages = again[again.index(b"D\x00\x00") - 2 :]  # the second boot's, in the first one's file
    quiet = {"boot_s": 30.0, "wall_s": 0.0, "motor": 0.8}
    with case_table() as case:
        for name, data, first, second in (
            (
                "tlog, the clock begins anew",
                [quiet, {"boot_s": 4.0, "wall_s": 60.0, "motor": 0.2}],
                30.0,
                4.0,
            ),
            ("tlog, by 3 s", [quiet, {"boot_s": 33.0, "wall_s": 40.0, "motor": 0.2}], 30.0, 33.0),
            ("tlog, the clock goes on", [quiet, {"boot_s": 50.0, "wall_s": 90.0, "motor": 0.2}], 30.0, 50.0),
            ("DataFlash, by 2 s", as_binary(dataflash(40) + dataflash(43.9, 0.5)), 40.0, 43.9),
            ("DataFlash, text", as_text(dataflash(40) + dataflash(12, 0.5)).encode(), 40.0, 12.0),
            ("DataFlash, two files", as_binary(dataflash(4)) + as_binary(dataflash(50, 0.5)), 4.0, 50.0),
            ("ULog, messages", whole + messages, 9.0, 2.0),
            ("ULog, two files", again + later, 2.0, 7.0),
        ):
            with case(name):
                if isinstance(data, list):
                    path = tlog(tmp_path, *data)
                else:
                    path.write_bytes(data)
                found = read_flights(path)
                assert [round(log["time_s"][0], 1) for log in found] == [first, second]
                for log in found:
                    assert (np.diff(log["time_s"]) < 0.3).all() and DAMAGED not in log.premises
                    assert "2 stretches" in log.provenance[0] and "stretch" in log.source
                if name.startswith("tlog"):
                    assert [set(log["motor1"]) for log in found] == [{0.8}, {0.2}]
                with pytest.raises(InputError, match=r"2 stretches, and one is expected"):
                    read_flight_log(path)
                path = tmp_path / "log"


def test_recordings_that_were_joined_are_read_one_after_the_other(tmp_path: Path) -> None:
    first = {"boot_s": 30.0, "wall_s": 0.0, "motor": 0.8}
    path = tlog(tmp_path, first, {"boot_s": 27.0, "wall_s": 600.0, "motor": 0.2})
    path.write_bytes(2 * path.read_bytes())
    found = read_flights(path)
    assert [set(log["motor1"]) for log in found] == 2 * [{0.8}, {0.2}]
    assert [round(log["time_s"][0], 1) for log in found] == [30.0, 27.0, 30.0, 27.0]


def test_what_is_no_restart_is_one_flight(tmp_path: Path) -> None:
    path = tmp_path / "log"
    damaged = [
        ("RCOU", 900_000, *fields[2:]) if n in (70, 71) and fields[0] == "RCOU" else fields
        for n, fields in enumerate(dataflash(40))
    ]
    on = {"boot_s": 30.0, "seconds": 12.0, "begin_s": 6.0}
    with case_table() as case:
        for name, data in (
            ("a stamp that makes no sense", as_binary(damaged)),
            ("packets in another order", [{"boot_s": 30.0, "wall_s": 0.0, "late": (20, 50, 51, 80)}]),
            ("the link is lost for a minute", [{"boot_s": 0, "wall_s": 0}, {"boot_s": 66, "wall_s": 66}]),
            ("the recorder gets its time", [{"boot_s": 30.0, "wall_s": 0.0}, {**on, "wall_s": 9e6}]),
        ):
            with case(name):
                if isinstance(data, list):
                    path = tlog(tmp_path, *data)
                else:
                    path.write_bytes(data)
                assert read_flight_log(path).provenance == ()
                path = tmp_path / "log"


def test_a_stretch_without_a_flight_is_said_and_the_other_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    bench = [row for row in dataflash(3) if row[0] != "RCOU"]
    path.write_bytes(as_binary(dataflash(40) + bench))
    log = read_flight_log(path)
    assert "2 stretches, 5.9 s and number 2 is not read (no motor commands" in log.provenance[0]


def mixed(folder: Path, apart_s: float, *systems: int) -> Path:
    """Two vehicles on one line at once, their clocks so far apart."""
    one, two = bytearray(), bytearray()
    link(one, 30.0, 0.0, system=systems[0], motor=0.8)
    link(two, 30.0 + apart_s, 0.0, system=systems[1], motor=0.2, roll=0.3, seconds=4.0)
    path = folder / "two.tlog"
    path.write_bytes(in_order(one, two))
    return path


def in_order(*recordings: bytearray) -> bytes:
    """Recordings of one time as one."""
    frames = []
    for data in recordings:
        at = 0
        while at < len(data):
            size = 8 + 12 + data[at + 9]
            frames.append(bytes(data[at : at + size]))
            at += size
    return b"".join(sorted(frames, key=lambda frame: frame[:8]))


def commands(log: Samples) -> float:
    return round(float(log["motor1"].mean()), 3)


def test_of_several_vehicles_one_is_read_and_all_are_named(tmp_path: Path) -> None:
    path = mixed(tmp_path, 100.0, 3, 7)
    log = read_flight_log(path)
    assert commands(log) == 0.8
    expected = "systems 3 (360 messages of a flight) and 7 (240 messages of a flight): 3 is read, which sent"
    assert expected in log.provenance[0]
    assert commands(read_flight_log(path, 7)) == 0.2 and "7 is read" in read_flight_log(path, 7).provenance[0]
    for system, problem in ((5, "is not in this tlog: found 3 "), (0, "from 1 to 255 is expected, found 0")):
        with pytest.raises(InputError, match=problem):
            read_flights(path, system)
    for apart_s in (100.0, 0.31, 0.0):
        with pytest.raises(InputError, match="two boards under one number"):
            read_flights(mixed(tmp_path, apart_s, 1, 1))


def test_one_board_whose_stamps_do_not_go_on_is_a_damaged_file_and_no_two_boards() -> None:
    clock = np.tile([0.0, 0.3, 0.1], 40) + np.repeat(np.arange(40.0), 3)
    with pytest.raises(InputError, match="the file is damaged"):
        cuts("a.ulg", [Stream(np.arange(120), clock)], ONBOARD_S)


def test_one_vehicle_over_two_links_is_one(tmp_path: Path) -> None:
    once, again = bytearray(), bytearray()
    link(once, 30.0, 0.0)
    link(again, 30.0, 0.2)
    path = tmp_path / "twice.tlog"
    path.write_bytes(in_order(once, again))
    assert read_flight_log(path).rows == read_flight_log(tlog(tmp_path, {"boot_s": 30, "wall_s": 0})).rows


def test_a_log_of_one_vehicle_is_held_against_the_number(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(ulog(TOPICS, TWO | {"MAV_SYS_ID": 3}))
    assert read_flight_log(path, 3).rows
    for data, problem in (
        (path.read_bytes(), "of one vehicle, number 3"),
        (ulog(TOPICS, TWO), "of one vehicle, which does not say its number"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=problem):
            read_flights(path, 4)


def test_parameters_are_those_of_the_vehicle_and_of_its_stretch(tmp_path: Path) -> None:
    data = bytearray()
    for system, boot_s, value in ((3, 30.0, 4.0), (7, 80.0, 5.0), (3, 5.0, 6.0)):
        mav = common.MAVLink(None, srcSystem=system, srcComponent=1)
        message = common.MAVLink_param_value_message(b"CA_AIRFRAME", value, 9, 1, 0)
        link(data, boot_s, boot_s, system=system)
        data += struct.pack(">Q", round(1.7e15 + 1e6 * (boot_s + 5))) + message.pack(mav)
    path = tmp_path / "p.tlog"
    path.write_bytes(data)
    assert [log.parameters for log in read_flights(path, 3)] == [{"CA_AIRFRAME": 4.0}, {"CA_AIRFRAME": 6.0}]
    assert read_board_parameters(path, system=7).params == {"CA_AIRFRAME": 5.0}
    assert "7 is read" in read_board_parameters(path, system=7).notes[0]


@needs_shared
@pytest.mark.shared_data
def test_a_real_tlog_across_a_restart_and_real_logs_one_after_another(tmp_path: Path) -> None:
    first, second = read_flights(
        SHARED / "field" / "25-tlog-across-a-restart" / "sound_then_weak_rebooted.tlog"
    )
    assert first["time_s"][-1] == pytest.approx(60, abs=0.1) and second["time_s"][0] == pytest.approx(
        19, abs=0.1
    )
    for name in ("sample_log_small.ulg", "ardupilot_24.bin"):
        data = (SHARED / "data" / "logs" / name).read_bytes()
        (tmp_path / name).write_bytes(data + data)
        alone = read_flight_log(SHARED / "data" / "logs" / name)
        for log in read_flights(tmp_path / name):
            np.testing.assert_array_equal(log["time_s"], alone["time_s"])
            np.testing.assert_array_equal(log["motor1"], alone["motor1"])
