"""Files and flight logs of the PX4 stand-in: by the byte, and as MAVSDK and log readers see them."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.line.ftp import CardFiles, Manners, Server
from sim.px4.autopilot import Autopilot, Mode
from sim.simulation import Simulation, build

PX4 = Manners(one_session=True, counts_written=True, empty_folder_ends=False)
ACK, NAK = 128, 129
EXAMPLES = Path(__file__).parents[2] / "examples"


class Card:
    """A card and a peer that asks."""

    def __init__(self) -> None:
        self.files = CardFiles("fs/microsd", protected=("etc/",))
        self.sent: list[bytes] = []
        self.server = Server(self.files, PX4, self.sent.append)
        self.number = 0

    def ask(
        self, code: int, data: bytes = b"", offset: int = 0, size: int | None = None
    ) -> tuple[int, bytes]:
        """Answer code and body."""
        self.number += 2
        head = struct.pack(
            "<HBBBBBBI", self.number, 0, code, len(data) if size is None else size, 0, 0, 0, offset
        )
        self.server.hear((head + data).ljust(251, b"\0"))
        answer = self.sent[-1]
        assert struct.unpack_from("<H", answer)[0] == self.number + 1 and answer[5] == code
        return answer[3], answer[12 : 12 + answer[4]]


@pytest.fixture
def card() -> Card:
    return Card()


def test_a_file_is_written_checked_moved_and_removed(card: Card) -> None:
    text = bytes(range(256)) * 3
    assert card.ask(6, b"/fs/microsd/etc/mixer.csv") == (NAK, bytes([10]))  # no such folder yet
    assert card.ask(9, b"/fs/microsd/etc") == (ACK, b"") and card.ask(9, b"/fs/microsd/etc") == (NAK, b"\x08")
    assert card.ask(3, b"/fs/microsd/etc") == (ACK, b"")  # an empty folder is a list of nothing
    assert card.ask(6, b"/fs/microsd/etc/mixer.csv")[0] == ACK
    assert card.ask(6, b"/fs/microsd/other") == (NAK, bytes([5]))  # one session at a time
    for at in range(0, len(text), 239):
        part = text[at : at + 239]
        assert card.ask(7, part, at) == (ACK, struct.pack("<I", len(part)))
    assert card.ask(1) == (ACK, b"") and card.ask(1) == (NAK, bytes([4]))
    crc = zlib.crc32(text, 0xFFFFFFFF) ^ 0xFFFFFFFF
    assert card.ask(14, b"/fs/microsd/etc/mixer.csv") == (ACK, struct.pack("<I", crc))
    assert card.ask(13, b"/fs/microsd/etc/mixer.csv\0/fs/microsd/etc/b") == (ACK, b"")
    assert card.ask(3, b"/fs/microsd/etc") == (ACK, b"Fb\t768\0")
    assert card.ask(3, b"/fs/microsd/etc", 1) == (NAK, bytes([6]))
    assert card.ask(4, b"/fs/microsd/etc/b") == (ACK, struct.pack("<I", 768))
    assert card.ask(5, offset=700, size=239) == (ACK, text[700:]) and card.ask(5, offset=768)[0] == NAK
    card.ask(2)
    assert card.ask(12, b"/fs/microsd/etc/b", 10) == (ACK, b"") and card.files.files["etc/b"] == text[:10]
    assert card.ask(10, b"/fs/microsd/etc") == (NAK, bytes([2, 39]))  # not empty
    assert card.ask(8, b"/fs/microsd/etc/b") == (ACK, b"") and card.ask(10, b"/fs/microsd/etc") == (ACK, b"")
    assert card.ask(4, b"/fs/microsd/etc/b") == (NAK, bytes([10]))


def test_what_is_not_the_cards_cannot_be_written(card: Card) -> None:
    assert card.ask(6, b"/etc/init.d/rcS") == (NAK, bytes([9])) and card.ask(8, b"/fs/../x")[1] == bytes([9])
    assert card.ask(4, b"@PARAM/param.pck") == (NAK, bytes([10]))  # ArduPilot's, not PX4's
    assert card.ask(99) == (NAK, bytes([7])) and card.ask(7, b"x") == (NAK, bytes([4]))
    assert card.ask(6, b"/big")[0] == ACK and card.ask(7, b"x", 2**31)[0] == NAK


def flown(firmware: str) -> Autopilot:
    """Up to 2 m, a while there, and down: twice, in one boot."""
    standin_ = build(Simulation(EXAMPLES / "x8_demo.toml", firmware=firmware), [])
    a: Any = standin_.autopilot
    for _ in range(2):
        if firmware == "ardupilot":
            a.set_ap_mode(4)
        a.arm()
        a.take_off(2.0)
        for _ in range(250 * 6):
            standin_.tick()
        if firmware == "ardupilot":
            a.set_ap_mode(9)
        else:
            a.set_mode(Mode.LAND)
        while a.armed:
            standin_.tick()
        standin_.tick()
    return standin_.autopilot


@pytest.mark.slow
def test_ardupilot_keeps_one_log_a_boot(tmp_path: Path) -> None:
    from pymavlink import DFReader

    card = flown("ardupilot").files
    assert sorted(p for p in card.files if p.startswith("logs/")) == ["logs/00000001.BIN", "logs/LASTLOG.TXT"]
    (tmp_path / "1.bin").write_bytes(card.files["logs/00000001.BIN"])
    reader = DFReader.DFReader_binary(str(tmp_path / "1.bin"), zero_time_base=True)
    rows: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        rows.setdefault(message.get_type(), []).append(message)
    reader.close()
    # armed, airborne, landed, disarmed; twice
    assert [e.Id for e in rows["EV"]] == [10, 28, 18, 11] * 2
    assert {"PARM", "IMU", "XKF1", "ATT", "RCOU", "BAT", "RFND", "ESC", "RATE", "MODE", "MSG"} <= set(rows)
    assert max(-r.PD for r in rows["XKF1"]) == pytest.approx(2.0, abs=0.3)
    assert 1100 < rows["RCOU"][len(rows["RCOU"]) // 4].C8 < 1900
    assert {p.Name: p.Value for p in rows["PARM"]}["SERVO8_FUNCTION"] == 40
    gaps = np.diff([i.TimeUS for i in rows["IMU"]])
    assert sorted(gaps)[len(gaps) // 2] == 40000


# Hz by SDLOG_PROFILE, of PX4 v1.16's logged_topics.cpp (intervals in ms; none: every row, 250 Hz here).
# 0: not logged. Bits: 1 default, 4 thermal calibration, 8 system identification, 16 high rate.
RATES = {
    "sensor_combined": {0: 250, 1: 250, 5: 250, 9: 250, 17: 250, 25: 250, 16: 250},
    "vehicle_acceleration": {0: 20, 1: 20, 5: 20, 9: 250, 17: 20, 25: 250, 16: 0},
    "vehicle_angular_velocity": {0: 50, 1: 50, 5: 50, 9: 250, 17: 250, 25: 250, 16: 250},
    "vehicle_attitude": {0: 20, 1: 20, 5: 20, 9: 20, 17: 250, 25: 250, 16: 250},
    "vehicle_local_position": {0: 10, 1: 10, 5: 10, 9: 10, 17: 10, 25: 10, 16: 0},
    "actuator_motors": {0: 10, 1: 10, 5: 10, 9: 250, 17: 250, 25: 250, 16: 250},
    "actuator_outputs": {0: 10, 1: 10, 5: 10, 9: 10, 17: 10, 25: 10, 16: 0},
    "vehicle_thrust_setpoint": {0: 50, 1: 50, 5: 50, 9: 50, 17: 250, 25: 250, 16: 250},
    "vehicle_torque_setpoint": {0: 50, 1: 50, 5: 50, 9: 250, 17: 250, 25: 250, 16: 250},
    "battery_status": {0: 5, 1: 5, 5: 5, 9: 5, 17: 5, 25: 5, 16: 0},
    # 5 ms are no whole number of steps
    "esc_status": {0: 4, 1: 4, 5: 4, 9: 4, 17: 190, 25: 190, 16: 190},
}


@pytest.mark.parametrize("profile", [0, 9, 17, 16])
def test_px4_logs_what_its_profile_says_from_the_next_boot_on(tmp_path: Path, profile: int) -> None:
    from pyulog import ULog

    a: Any = build(Simulation(EXAMPLES / "x8_demo.toml"), []).autopilot
    a.store.preset("COM_DISARM_PRFLT", -1.0)

    def log(seconds: float) -> dict[str, Any]:
        a.arm()
        for _ in range(round(250 * seconds)):
            a.step()
            a.logger.record(round(1e6 * a.plant.time_s))
        a.disarm(force=True)
        a.logger.record(round(1e6 * a.plant.time_s))
        path = tmp_path / "x.ulg"
        path.write_bytes(a.files.files[a.logger.logs()[-1]])
        return {d.name: d.data for d in ULog(str(path)).data_list}

    a.store.write("SDLOG_PROFILE", 6, struct.unpack("<f", struct.pack("<i", profile))[0])
    before = log(2.0)
    assert len(before["actuator_motors"]["timestamp"]) == pytest.approx(20, abs=2)  # not yet
    a.boot()
    after = log(2.0)
    for name, rates in RATES.items():
        rows = len(after[name]["timestamp"]) if name in after else 0
        assert rows == pytest.approx(2 * rates[profile], abs=2 + 0.1 * rates[profile]), name


@pytest.mark.slow
def test_px4_logs_when_its_mode_says_from_the_next_boot_on() -> None:
    # whether a log runs by SDLOG_MODE: after boot, armed, disarmed again, armed again
    for mode, runs in ((-1, "0000"), (0, "0101"), (1, "1101"), (2, "1111"), (3, "0000"), (4, "0111")):
        a: Any = build(Simulation(EXAMPLES / "x8_demo.toml"), []).autopilot
        a.store.preset("SDLOG_MODE", mode)
        a.boot()
        logging = ""
        for act in (lambda: None, a.arm, lambda a=a: a.disarm(force=True), a.arm):
            act()
            a.step()
            logging += str(int(a.logger.wanted()))
        assert logging == runs, mode


@pytest.mark.slow
@pytest.mark.parametrize(("firmware", "suffix"), [("px4", ".ulg"), ("ardupilot", ".BIN")])
def test_a_flight_log_reader_reads_it(tmp_path: Path, firmware: str, suffix: str) -> None:
    from coaxlink.data import read_flight_log

    autopilot = flown(firmware)
    logs = autopilot.logger.logs()
    assert len(logs) == (2 if firmware == "px4" else 1)  # PX4 begins a log at every arming
    (tmp_path / f"x{suffix}").write_bytes(autopilot.files.files[logs[0]])
    samples = read_flight_log(tmp_path / f"x{suffix}")
    flying = samples["height_m"] > 1.9
    assert flying.sum() > 20
    assert np.median(samples["accel_z_m_s2"][flying]) == pytest.approx(-9.8, abs=0.2)
    motors = np.array([samples[f"motor{n}"][flying] for n in range(1, 9)])
    turned = np.array([samples[f"rpm{n}"][flying] for n in range(1, 9)]) / autopilot.plant.pair.speed_max_rpm
    assert motors.mean() == pytest.approx(turned.mean(), abs=0.02) and 0.2 < motors.mean() < 0.8
    assert 28 < samples["voltage_V"][flying].mean() < 33.6
