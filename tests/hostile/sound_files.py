"""One sound file of every kind that coaxlink reads, made here, small enough to be spoiled often."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from workbook import workbook

from coaxlink.frames import IMU_COLUMNS
from coaxlink.live.record import LiveRecord
from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.parameters import Snapshot, Value
from coaxlink.uploading.backup import write_backup
from coaxlink.uploading.content import Content
from coaxlink.uploading.journal import Entry, Journal
from firmware_params import ardupilot, px4
from firmware_params.ardupilot import packed
from firmware_params.ardupilot.scripts import matrix_script

EXAMPLES = Path(__file__).parents[2] / "examples"
PX4 = Identity(1, 1, 12, 13, (1, 16, 1), None, "00a1b2c3d4e5f607", "1:2:3", "0123456789abcdef")
COPTER = Identity(1, 1, 3, 13, (4, 5, 7), None, "00a1b2c3d4e5f608", "1:2:3", "fedcba9876543210")
FACTORS = [(-0.5, 0.5, 0.5, 1.0), (0.5, -0.5, 0.5, 0.9), (0.5, 0.5, -0.5, 1.0), (-0.5, -0.5, -0.5, 0.9)]
ROWS = 60


def sound_files(folder: Path) -> dict[str, Path]:
    """{kind: its file}, each in a folder of its own with what belongs beside it."""
    made = {}
    for kind, make in MAKERS.items():
        kind_folder = folder / kind.replace(" ", "-")
        kind_folder.mkdir(parents=True)
        made[kind] = make(kind_folder)
    return made


def file_of(folder: Path, kind: str) -> Path:
    """The file of that kind under `folder`, not what belongs beside it."""
    found = sorted(p for p in (folder / kind.replace(" ", "-")).iterdir() if p.is_file())
    return next(p for p in found if not (kind.startswith("airframe") and p.name == "rotor_paper.toml"))


def _copied(name: str, *beside: str):
    def make(folder: Path) -> Path:
        for other in (name, *beside):
            (folder / other).write_bytes((EXAMPLES / other).read_bytes())
        return folder / name

    return make


def _written(name: str, content: str | bytes):
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
        return folder / name

    return make


def stand_rows() -> str:
    """A short stand log in our own columns."""
    lines = (EXAMPLES / "stand_eq17.csv").read_text().splitlines()
    return "\n".join(lines[: ROWS + 1]) + "\n"


def flight_rows() -> str:
    """A short flight log in our own columns."""
    time = np.arange(ROWS) * 0.02
    columns = {"time_s": time}
    columns |= {f"motor{n}": 0.5 + 0.1 * np.sin(time + n) for n in range(1, 9)}
    for name in IMU_COLUMNS:
        columns[name] = np.cos(time + len(name))
    columns |= {f"{axis}_rad": 0.01 * time for axis in ("roll", "pitch", "yaw")}
    columns |= {f"vel_{axis}_m_s": 0.1 * np.sin(time) for axis in "ned"} | {"height_m": 3.0 + 0.1 * time}
    rows = np.stack(list(columns.values()), axis=1)
    return "\n".join([",".join(columns), *(",".join(f"{v:.6g}" for v in row) for row in rows)]) + "\n"


def sheet_rows(rows: str) -> bytes:
    """The first rows of a CSV text as a workbook."""
    head, *lines = rows.splitlines()[:20]
    numbers = [[float(cell) for cell in line.split(",")] for line in lines]
    return workbook({"Data": [head.split(","), *numbers]})


def tlog() -> bytes:
    """Two seconds of telemetry."""
    sender, data = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), b""
    for k in range(100):
        t = 20 * k
        messages = [
            mavlink.MAVLink_servo_output_raw_message(1000 * t, 0, *[1500 + k] * 8, *[1500] * 8),
            mavlink.MAVLink_highres_imu_message(1000 * t, 0.1, 0.2, -9.8, 0.01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
            mavlink.MAVLink_attitude_message(t, 0.01, 0.02, 0.03, 0, 0, 0),
            mavlink.MAVLink_local_position_ned_message(t, 0, 0, -1, 0, 0, 0),
        ]
        if k % 50 == 0:
            messages.append(mavlink.MAVLink_heartbeat_message(2, 12, 209, 0, 4, 3))
        for message in messages:
            data += struct.pack(">Q", 1_700_000_000_000_000 + 1000 * t) + bytes(message.pack(sender))
    return data


def _flown(kind: str):
    def make(folder: Path) -> Path:
        from sim.simulation import Simulation, build_plant

        plant, truth = build_plant(Simulation(EXAMPLES / "x8_demo.toml"))
        if kind == "ulg":
            from sim.px4.autopilot import Autopilot
            from sim.px4.logger import UlogLogger

            pilot = Autopilot(plant, truth, version=(1, 16, 1), seed=0)
            UlogLogger(pilot)
            pilot.store.preset("SDLOG_MODE", 2)
        else:
            from sim.ardupilot.copter import Copter
            from sim.ardupilot.logger import DataFlashLogger

            pilot = Copter(plant, truth, version=(4, 8, 0), seed=0)
            DataFlashLogger(pilot)
            pilot.store.preset("LOG_DISARMED", 1)
        pilot.boot()
        for _ in range(500):
            pilot.step()
            pilot.logger.record(1_000_000 + round(1e6 * plant.time_s))
        return _written(f"a.{kind}", bytes(pilot.files.files[pilot.logger.logs()[-1]]))(folder)

    return make


def _flown_csv(folder: Path) -> Path:
    """A flight of some seconds at 25 Hz: long enough to be judged."""
    from sim.flights import PLANS, fly, write_flight
    from sim.manoeuvres import read_plan
    from sim.px4.autopilot import Autopilot
    from sim.simulation import Simulation, build_plant

    plan = _written("plan.toml", FLIGHT_PLAN)(folder)
    PLANS["short"] = read_plan(plan)
    plan.unlink()
    flown = fly(Autopilot(*build_plant(Simulation(EXAMPLES / "x8_demo.toml"))), "short")
    write_flight(folder / "flown.csv", {name: column[::5] for name, column in flown.items()})
    return folder / "flown.csv"


def px4_params() -> dict[str, float | int]:
    """A table of four rotors."""
    rotor = [px4.RotorEntry((x, y, 0.0), (0.0, 0.0, -1.0), 20.0, k) for x, y, k in CROSS]
    return px4.table_to_params(px4.Px4Table(tuple(rotor), 0.9))


CROSS = ((0.3, 0.3, 0.05), (-0.3, -0.3, 0.05), (0.3, -0.3, -0.05), (-0.3, 0.3, -0.05))
COPTER_PARAMS = {"FRAME_CLASS": 15.0, "FRAME_TYPE": 0.0, "MOT_THST_EXPO": 0.55, "SCR_ENABLE": 1.0} | {
    f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)
}


def _params(folder: Path) -> Path:
    px4.write_params_file(folder / "t.params", px4_params(), header=["coaxlink: mixer table of X8"])
    return folder / "t.params"


def _param(folder: Path) -> Path:
    ardupilot.write_param_file(folder / "t.param", COPTER_PARAMS, ["coaxlink: mixer table of X8"])
    (folder / "scripts").mkdir()
    (folder / "scripts" / "coaxlink_matrix.lua").write_text(matrix_script(FACTORS, title="X8"))
    return folder / "t.param"


def _values(params: dict[str, float | int]) -> dict[str, Value]:
    return {
        n: Value(n, v, 6, struct.pack("<i", v))
        if isinstance(v, int)
        else Value(n, v, 9, struct.pack("<f", v))
        for n, v in params.items()
    }


def _backup(folder: Path) -> Path:
    return write_backup(folder, ".params", PX4, Snapshot(_values(px4_params()), 0x1234), {})


def _backup_copter(folder: Path) -> Path:
    held = {"/APM/scripts/coaxlink_matrix.lua": matrix_script(FACTORS, title="X8").encode()}
    return write_backup(folder, ".param", COPTER, Snapshot(_values(COPTER_PARAMS)), held)


def _journal(folder: Path) -> Path:
    old = Content(_values(px4_params()), {"/fs/microsd/etc/mixer.csv": b"1,2,3"})
    journal = Journal(PX4, folder)
    journal.begin(Entry(journal.board, old, old, "backups/b.params", ("t.params",), "2026-01-01T00:00:00Z"))
    return journal.path


def _record(folder: Path) -> Path:
    journal = Journal(PX4, folder)
    journal.record(("t.params",), _values(px4_params()), 0x1234, {"/APM/scripts/a.lua": 5})
    return journal.record_path


def _live(folder: Path) -> Path:
    record = LiveRecord(folder / "mix.live", {"law": "exact", "airframe": "X8", "rotors": 8})
    for k in range(20):
        record.add(k, 0.1 * k, (0, 0, 0, 0.5), (0.5,) * 8, (0, 0, 0, 0), 1e-4, "live")
    record.close()
    return record.path


def _memory(folder: Path) -> Path:
    document = {"parameters": px4_params(), "files": {"etc/mixer.csv": "00ff"}, "folders": ["", "etc"]}
    return _written("memory.json", json.dumps(document))(folder)


COLUMN_MAP = """upper_rpm = "upper_rpm"
upper_thrust_N = { column = "upper_thrust_N", scale = 1.0, offset = 0.0 }
"""
FLIGHT_PLAN = """height_m = 3.0
[[pieces]]
seconds = 5.0
north_m = 2.0
cycles = 1
[[pieces]]
seconds = 5.0
yaw_deg = 90.0
"""


def _blades(folder: Path) -> Path:
    pairs = EXAMPLES.parent / "sim" / "pairs"
    return _written("blades.toml", (pairs / "kde5215_bemt.toml").read_bytes())(folder)


LIMITS = {
    "version": 1,
    "parameters": [{"name": "CA_ROTOR0_CT", "min": 0.0, "max": 100.0}, {"name": "A", "longDesc": "b\nc"}],
}
PACKED = {"FRAME_CLASS": (15.0, 2), "MOT_THST_EXPO": (0.55, 9), "SERVO1_FUNCTION": (33.0, 4)}
MAKERS = {
    "airframe": _copied("x8_paper.toml", "rotor_paper.toml"),
    "airframe of the world": _copied("y6.toml", "rotor_paper.toml"),
    "rotor model": _copied("rotor_paper.toml"),
    "rotor of the world": _copied("rotor_paper.toml"),
    "stand CSV": lambda folder: _written("s.csv", stand_rows())(folder),
    "stand sheet": lambda folder: _written("s.xlsx", sheet_rows(stand_rows()))(folder),
    "column map": _written("map.toml", COLUMN_MAP),
    "flight CSV": lambda folder: _written("f.csv", flight_rows())(folder),
    "flown CSV": _flown_csv,
    "ULog": _flown("ulg"),
    "DataFlash": _flown("bin"),
    "tlog": lambda folder: _written("f.tlog", tlog())(folder),
    ".params table": _params,
    ".param table": _param,
    "matrix script": _written("coaxlink_matrix.lua", matrix_script(FACTORS, title="X8")),
    "packed parameters": _written("param.pck", packed.pack(PACKED)),
    "board for init": _params,
    "backup PX4": _backup,
    "backup ArduPilot": _backup_copter,
    "journal": _journal,
    "verified record": _record,
    "signing state": _written("s.json", json.dumps({"timestamp": 5, "streams": [[1, 1, 1, 100]]})),
    "signing key": _written("key", b"0123456789abcdef" * 4),
    "board's limits": _written("parameters.json", json.dumps(LIMITS)),
    "live record": _live,
    "truth": _copied("truth_weak_rotor_cg_offset.toml"),
    "truth of a stand": _copied("truth_stand_spacing.toml"),
    "schedule": _copied("schedule_poor.toml"),
    "flight plan": _written("plan.toml", FLIGHT_PLAN),
    "rotor of blades": _blades,
    "campaign": _copied("campaign_laws.toml", "x8_demo.toml", "rotor_paper.toml"),
    "world's memory": _memory,
}  # fmt: skip
