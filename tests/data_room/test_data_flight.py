"""Flight logs: CSV and tlog, written here with pymavlink's own packer, and the real logs where they are."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from pymavlink.dialects.v20 import common

from coaxlink.airframe import load_airframe
from coaxlink.data import Samples, is_flight_log, read_flight_log
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.rotor import load_rotor_model

SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the shared real logs are not beside this checkout"
)
CSV = "time_s,motor1,motor2,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,"
CSV += "roll_rad,pitch_rad,yaw_rad,vel_n_m_s,vel_e_m_s,vel_d_m_s,height_m,humidity\n"


def csv_row(time: float, motor: float) -> str:
    return f"{time},{motor},0.5,0,0,-9.8,0,0,0,0,0,0,0,0,0,2,40\n"


def csv(folder: Path, text: str) -> Path:
    path = folder / "flight.csv"
    path.write_text(text)
    return path


def test_csv_in_our_columns(tmp_path: Path) -> None:
    path = csv(
        tmp_path, CSV + csv_row(0, 0.25) + csv_row(0.01, 0.5) + csv_row(0.01, 0.5) + csv_row(0.02, 1.0)
    )
    log = read_flight_log(path)
    assert log["motor1"].tolist() == [0.25, 0.5, 1.0] and log["humidity"].tolist() == [40, 40, 40]
    assert any("repeated stamp" in note for note in log.notes)
    assert is_flight_log(path)


def test_commands_outside_in_part_of_the_rows_stay_and_percent_is_a_unit(tmp_path: Path) -> None:
    part = csv(tmp_path, CSV + "".join(csv_row(0.01 * k, 0.5 if k < 10 else 30.0) for k in range(30)))
    assert read_flight_log(part)["motor1"].max() == 30.0  # for refine to flag
    idles = csv(tmp_path, CSV + "".join(csv_row(0.01 * k, 0.0 if k < 50 else 40.0) for k in range(60)))
    with pytest.raises(InputError, match=r"line 52, column motor1: 0\.\.1 is expected, found 40"):
        read_flight_log(idles)


def test_words_in_a_column_that_is_not_ours_are_left_out(tmp_path: Path) -> None:
    rows = "".join(csv_row(0.01 * k, 0.5).replace(",40\n", ",40,calm\n") for k in range(30))
    log = read_flight_log(csv(tmp_path, CSV.replace("humidity", "humidity,comment") + rows))
    assert not log.has("comment") and log.has("humidity") and "comment" in log.notes[0]


def test_commands_held_over_many_rows_are_taken_at_their_own_rate(tmp_path: Path) -> None:
    rows = "".join(csv_row(round(0.01 * k, 2), (k // 10) % 7 / 10) for k in range(400))
    log = read_flight_log(csv(tmp_path, CSV + rows))
    np.testing.assert_allclose(np.diff(log["time_s"]), 0.1)
    assert any("every 10 rows" in note for note in log.notes)


def test_bad_csv_is_one_line(tmp_path: Path) -> None:
    with case_table() as case:
        for text, expected in {
            CSV + csv_row(0, 1.5): "line 2, column motor1: 0..1 is expected, found 1.5",
            CSV + csv_row(1, 0.5) + csv_row(0, 0.5): "line 3, column time_s: time goes back",
            CSV + csv_row(0, math.nan): "line 2, column 'motor1': a finite number is expected",
            CSV + csv_row(0, 0.5) + csv_row(20, 0.5): "column time_s: rows every 20 s: a flight",
            CSV + csv_row(0, 0.5) + csv_row(0.1, 4e15): "line 3, column 'motor1': no sensor reads 4e15",
            CSV.replace("gyro_y_rad_s", "q") + csv_row(0, 0.5): "column gyro_y_rad_s: missing",
            CSV.replace("motor2", "motor3") + csv_row(0, 0.5): "column motor2: missing",
            "": "empty",
        }.items():
            with case(expected):
                with pytest.raises(InputError) as caught:
                    read_flight_log(csv(tmp_path, text))
                assert expected in str(caught.value) and "\n" not in str(caught.value)


class Recorder:
    """Frames of one autopilot behind a wall clock that has nothing to do with its own."""

    def __init__(self, path: Path) -> None:
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self.path, self.data, self.wall = path, bytearray(), 1_700_000_000_000_000

    def add(self, message: common.MAVLink_message, mav: common.MAVLink | None = None) -> None:
        self.wall += 137
        self.data += struct.pack(">Q", self.wall) + message.pack(mav or self.mav)

    def write(self) -> Path:
        self.path.write_bytes(self.data)
        return self.path


def recorded(
    path: Path,
    *,
    seconds: float = 4.0,
    imu_hz: int = 200,
    vibration_hz: float = 0.0,
    packs: Mapping[int, int] = {0: 25000},
) -> Recorder:
    """Motors at 50 Hz ramping up, a roll rate of 2 rad/s^2 x t, IMU faster than the motors."""
    log = Recorder(path)
    ground = common.MAVLink(None, srcSystem=255, srcComponent=190)
    for ms in range(0, int(seconds * 1000)):
        t = ms / 1000
        if ms % 1000 == 0:
            log.add(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), ground)
            log.add(common.MAVLink_heartbeat_message(2, 12, 128 if t >= 2 else 0, 0, 4, 3))
            for number, full in packs.items():
                volts = [int(full - 100 * t)] + [65535] * 9
                log.add(common.MAVLink_battery_status_message(number, 0, 0, 0, volts, 0, 0, 0, 50))
        if ms % (1000 // imu_hz) == 0:
            shake = 5 * math.sin(2 * math.pi * vibration_hz * t)
            log.add(
                common.MAVLink_highres_imu_message(
                    ms * 1000, 0.1, 0.2, -9.8 + shake, 2 * t, 0, 0, 0, 0, 0, 0, 0, 0, 20, 63, 0
                )
            )
        if ms % 20 == 0:
            outputs = [1000 + 100 * t + n for n in range(8)] + [0.0] * 24
            log.add(common.MAVLink_actuator_output_status_message(ms * 1000, 8, outputs))
            log.add(
                common.MAVLink_attitude_message(ms, t * t, 0.1, math.remainder(3 * t, 2 * math.pi), 0, 0, 0)
            )
        if ms % 50 == 0:
            log.add(common.MAVLink_local_position_ned_message(ms, 0, 0, -t, 1, 2, -1))
    return log


def test_tlog_times_are_the_messages_own(tmp_path: Path) -> None:
    log = read_flight_log(recorded(tmp_path / "flight.tlog").write())
    t = log["time_s"]
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    assert t[0] == pytest.approx(0.0, abs=0.021) and t[-1] > 3.9
    np.testing.assert_allclose(log["motor1"], 0.1 * t, atol=1e-6)
    np.testing.assert_allclose(log["motor8"], 0.1 * t + 0.007, atol=1e-6)
    assert not log.has("motor9")
    inside = slice(1, -1)
    np.testing.assert_allclose(log["gyro_x_rad_s"][inside], 2 * t[inside], atol=1e-5)
    np.testing.assert_allclose(log["accel_z_m_s2"], -9.8, atol=1e-5)
    np.testing.assert_allclose(np.unwrap(log["yaw_rad"]), 3 * t, atol=1e-5)
    np.testing.assert_allclose(log["vel_e_m_s"], 2.0)
    np.testing.assert_allclose(log["height_m"][:-2], t[:-2], atol=1e-5)
    np.testing.assert_allclose(log["voltage_V"][t < 3], (25 - 0.1 * t)[t < 3], atol=0.02)
    assert set(log["armed"][t < 1.95]) == {0.0} and set(log["armed"][t > 2.02]) == {1.0}
    assert any("DISTANCE_SENSOR" in note for note in log.notes)


def test_vibration_above_the_motor_rate_does_not_alias(tmp_path: Path) -> None:
    log = read_flight_log(recorded(tmp_path / "v.tlog", vibration_hz=52.0).write())
    assert np.std(log["accel_z_m_s2"][2:-2]) < 0.5  # plain sampling at 50 Hz would show 3.5 at 2 Hz


def test_a_pause_in_the_log_is_left_out(tmp_path: Path) -> None:
    complete = recorded(tmp_path / "gap.tlog").data
    records, at = [], 0
    while at < len(complete):
        size = 8 + 12 + complete[at + 9]
        records.append(bytes(complete[at : at + size]))
        at += size
    cut = [r for i, r in enumerate(records) if not len(records) * 0.4 < i < len(records) * 0.6]
    path = tmp_path / "cut.tlog"
    path.write_bytes(b"".join(cut) + b"\x00\x01torn")
    log = read_flight_log(path)
    step = np.diff(log["time_s"])
    assert step.max() > 0.5 and any("gaps" in note for note in log.notes)


def test_esc_batches_that_repeat_the_first_four_are_left_out(tmp_path: Path) -> None:
    from firmware_params.px4 import messages

    log = recorded(tmp_path / "esc.tlog")
    for ms in range(0, 4000, 100):
        rpm = [1000 + ms, 2000, 3000, 4000]
        for index in (0, 4):
            log.add(messages.MAVLink_esc_status_message(index, ms * 1000, rpm, [20.0] * 4, [1.0] * 4))
    samples = read_flight_log(log.write())
    assert samples.has("rpm1", "rpm4") and not samples.has("rpm5")
    np.testing.assert_allclose(samples["rpm1"][5:-10], 1000 + 1e3 * samples["time_s"][5:-10], atol=1)


def esc_flight(path: Path, amps: Callable[[np.ndarray], np.ndarray]) -> Samples:
    """Of four ESCs from rest to flight, whose current is this of their speeds (4,)."""
    from firmware_params.px4 import messages

    log = recorded(path)
    for ms in range(0, 4000, 20):
        rpm = np.array([900, 1000, 1100, 1200]) + ms + (300.0 * np.sin(ms / 90.0))
        rpm = np.where(ms < 200, 0.0, np.trunc(rpm))
        log.add(
            messages.MAVLink_esc_status_message(
                0, ms * 1000, rpm.astype(int).tolist(), [20.0] * 4, amps(rpm).tolist()
            )
        )
    return read_flight_log(log.write())


def test_escs_whose_current_is_a_line_over_their_rpm_were_never_read(tmp_path: Path) -> None:
    """As PX4's SITL makes them: rpm 6000 u, cut to whole ones, and 1 A + 15 A u."""
    made = esc_flight(tmp_path / "made.tlog", lambda rpm: np.where(rpm > 0, 1.0 + (rpm + 0.4) / 400.0, 0.0))
    assert not made.has("rpm1") and not made.has("current1_A")
    assert any("simulators" in note for note in made.notes)


def test_escs_that_measure_stay(tmp_path: Path) -> None:
    """The cube of their speed, to a hundredth of an ampere; none at all; one that is noise about a line."""
    noise = np.random.default_rng(1)
    real: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "cube": lambda rpm: np.round(1.0 + 20.0 * (rpm / 5000.0) ** 3, 2),
        "none": lambda rpm: 0.0 * rpm,
        "line": lambda rpm: np.round(rpm / 400.0 + 0.3 * noise.standard_normal(4) + 2.0, 1),
    }
    for name, amps in real.items():
        assert esc_flight(tmp_path / f"{name}.tlog", amps).has("rpm1", "rpm4"), name


def test_a_battery_without_a_number_is_the_pack(tmp_path: Path) -> None:
    """PX4's SITL tells its battery with id 255; where 0 is there too, that is the first."""
    for ids, volts in (((255,), 23.0), ((255, 0), 22.0), ((0, 1), 22.0), ((1,), 21.0)):
        log = recorded(tmp_path / "pack.tlog", packs={n: {255: 23000, 0: 22000, 1: 21000}[n] for n in ids})
        read = read_flight_log(log.write())
        np.testing.assert_allclose(read["voltage_V"], volts - 0.1 * read["time_s"], atol=0.11)


def test_an_esc_that_esc_info_has_offline_has_no_speed(tmp_path: Path) -> None:
    """PX4 repeats what it last heard of it."""
    from firmware_params.px4 import messages

    for bits, gone in ((0b1111_1101, True), (0, False)):  # 0: a driver that does not keep them
        log = recorded(tmp_path / f"esc{bits}.tlog")
        for ms in range(0, 4000, 100):
            info = 0xFF if ms < 2000 and bits else bits
            none = [0] * 4
            log.add(messages.MAVLink_esc_info_message(0, ms * 1000, 0, 4, 0, info, none, none, none))
            rpm = [1000 + ms, 2000 + min(ms, 2000), 3000 + ms, 4000 + ms]
            log.add(messages.MAVLink_esc_status_message(0, ms * 1000, rpm, [20.0] * 4, [1.0] * 4))
        samples = read_flight_log(log.write())
        late = (samples["time_s"] > 2.6) & (samples["time_s"] < 3.8)
        assert np.isfinite(samples["rpm1"][late]).all()
        assert np.isnan(samples["rpm2"][late]).all() == gone
        assert any("rpm2: ESC 1 is offline in 50%" in note for note in samples.notes) == gone


@pytest.mark.slow
@needs_shared
@pytest.mark.shared_data
def test_real_flights_carry_their_weight() -> None:
    """With the plant's own rotors the mean thrust carries 20 kg."""
    with case_table() as case:
        for name, rows in (
            ("px4_null_fitted.ulg", 13000),
            ("px4_rotor_drag.ulg", 15000),
            ("ap_null.bin", 5500),
        ):
            with case(f"{name}, {rows}"):
                log = read_flight_log(SHARED / "flights" / name)
                assert log.rows > rows
                x8 = load_airframe(example("x8_paper.toml"))
                speeds = np.stack([log[f"motor{n}"] for n in range(1, 9)], axis=1)
                thrust = x8.loads(load_rotor_model(example("rotor_paper.toml")), speeds)[0].sum(axis=1)
                flying, force = (log["landed"] == 0) & (log["height_m"] > 1), -20 * log["accel_z_m_s2"]
                assert abs(np.mean((thrust - force)[flying])) < 1.0
                assert np.corrcoef(thrust[flying], force[flying])[0, 1] > 0.9


@pytest.mark.slow
@needs_shared
@pytest.mark.shared_data
def test_other_real_logs_read_too() -> None:
    old_px4 = read_flight_log(SHARED / "logs" / "sample_log_small.ulg")
    assert old_px4.has("motor1", "gyro_x_rad_s", "voltage_V")
    quad = read_flight_log(SHARED / "logs" / "ardupilot_24.bin")
    assert quad.has("motor4", "accel_z_m_s2", "voltage_V") and quad.rows > 1800
    assert -11 < np.median(quad["accel_z_m_s2"]) < -9


def test_what_only_begins_like_a_log_is_one_line(tmp_path: Path) -> None:
    with case_table() as case:
        for name, data, expected in (
            ("u.ulg", b"ULog\x01\x12\x35\x01" + b"x" * 40, "not a readable ULog"),
            ("d.bin", b"\xa3\x95\x80" + b"x" * 40, "d.bin"),
            ("x.tlog", bytes(recorded(tmp_path).data[:200]) + b"garbage" * 60, "a MAVLink frame is expected"),
            ("e.tlog", b"", "an empty file"),
            ("t.bin", b"time_s,motor1\n", "a DataFlash file is expected, found something else"),
        ):
            with case(name):
                (tmp_path / name).write_bytes(data)
                with pytest.raises(InputError, match=expected) as caught:
                    read_flight_log(tmp_path / name)
                assert "\n" not in str(caught.value)


def test_garbled_frames_are_counted_and_left_out(tmp_path: Path) -> None:
    log = recorded(tmp_path / "noise.tlog")
    clean = read_flight_log(log.write())
    for part in range(1, 40):
        log.data[part * len(log.data) // 40] ^= 0xFF
    log.data[len(log.data) // 3 : len(log.data) // 3 + 70] = b"noise"
    garbled = read_flight_log(log.write())
    assert abs(garbled.rows - clean.rows) <= 5
    assert any("frames left out" in note for note in garbled.notes)


def test_damaged_stamps_do_not_fill_the_memory(tmp_path: Path) -> None:
    log = recorded(tmp_path / "late.tlog")
    for late in (10**12, 10**12 + 20_000):
        log.add(common.MAVLink_actuator_output_status_message(late, 8, [1500.0] * 32))
        log.add(common.MAVLink_highres_imu_message(late, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 20, 63, 0))
        log.add(common.MAVLink_attitude_message(2**32 - 1, 0, 0, 0, 0, 0, 0))
    with pytest.raises(InputError, match="time stamps are damaged"):
        read_flight_log(log.write())


def test_a_battery_told_cell_by_cell_is_the_pack(tmp_path: Path) -> None:
    log = recorded(tmp_path / "cells.tlog")
    for second in range(4):
        cells = [4100, 4100, 4000, 4000, 4100, 4100] + [65535] * 4
        log.add(common.MAVLink_battery_status_message(0, 0, 0, 0, cells, 0, 0, 0, 50 - second))
    early = recorded(tmp_path / "one.tlog")
    assert read_flight_log(early.write())["voltage_V"].max() == pytest.approx(25.0)
    assert read_flight_log(log.write())["voltage_V"][-1] == pytest.approx(24.4, abs=0.02)


def test_a_tlog_is_known_whatever_its_stamp_and_first_bytes(tmp_path: Path) -> None:
    path = recorded(tmp_path / "flight.tlog", seconds=0.5).write()
    data = bytearray(path.read_bytes())
    data[10] = ord(",")  # a flag or a count: any byte may look like text
    for k in range(0, 256, 5):
        data[:8] = (1_795_000_000_000_000 + k).to_bytes(8, "big")
        path.write_bytes(data)
        assert is_flight_log(path), k
