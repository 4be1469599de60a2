"""The real PX4 (PX4_SITL names its binary): flown over the bridge, given a table, restarted, measured."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from real_autopilots import (
    AIRFRAME,
    Px4,
    coaxlink,
    fly_the_factory_table,
    held_to_mix,
    hover,
    px4,
    take_off,
    upload,
)

from coaxlink.fly.trajectory import paper_flight
from coaxlink.mavlink import connect
from coaxlink.uploading.plan import load_plan
from firmware_params import px4 as firmware

BINARY = os.environ.get("PX4_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="PX4_SITL names no binary"),
    pytest.mark.timeout(1800),
]
# rate loops of a 20 kg X8; the stock ones are a small quadrotor's
GAINS = {"P": 0.2, "I": 0.3, "D": 0.003}
TUNED = {f"MC_{axis}RATE_{k}": v for axis in ("ROLL", "PITCH") for k, v in GAINS.items()}
TUNED |= {"MC_YAWRATE_P": 0.45, "MC_YAWRATE_I": 0.3}
BATTERY = {"SIM_BAT_MIN_PCT": 100.0}  # else its own simulation empties one by the clock


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Px4]:
    (tmp_path / "px4").mkdir()
    with px4(Path(BINARY), tmp_path / "px4", "--airframe", str(AIRFRAME), "--speed", "0") as autopilot:
        yield autopilot


def factory(folder: Path) -> dict[str, float]:
    """What the vehicle left the factory with: the standard table, its outputs, its rate loops."""
    coaxlink("table", str(AIRFRAME), "--firmware", "px4", "--law", "standard", "--out", str(folder))
    outputs = {f"PWM_MAIN_FUNC{n}": 100 + n for n in range(1, 9)}
    return {**load_plan(folder).params, **outputs, **TUNED, **BATTERY}


def test_a_table_is_flown_as_realise_says(board: Px4, tmp_path: Path) -> None:
    tables = tmp_path / "fitted"
    coaxlink("table", str(AIRFRAME), "--firmware", "px4", "--out", str(tables))
    with board.boot(factory(tmp_path / "standard"), cut=True) as url:
        assert fly_the_factory_table(url, tables) < 0.5  # our answers lag when the machine is busy
        assert len(upload(url, tables, tmp_path)["changed"]) >= 17
    with board.boot() as url:
        coaxlink("verify", str(tables), "--connect", url)
        with connect(url, timeout_s=60.0) as session:
            pulses = hover(session, take_off(session))
    held_to_realise(pulses, tables)


TRUTH = """
[[effects]]
name = "rotor_drag"
size = 1.2

[[effects]]
name = "degraded_rotor"
size = 0.2
rotor = 3
"""


def test_refine_finds_what_is_hidden_behind_the_real_one(tmp_path: Path) -> None:
    truth, log, out = tmp_path / "truth.toml", tmp_path / "flight.tlog", tmp_path / "refined.json"
    truth.write_text(TRUTH)
    folder = tmp_path / "px4"
    folder.mkdir()
    options = ("--airframe", str(AIRFRAME), "--speed", "0", "--truth", str(truth))
    with (
        px4(Path(BINARY), folder, *options) as board,
        board.boot(factory(tmp_path / "standard")) as url,
        connect(url, timeout_s=60.0, record=log) as session,
    ):
        for stream in (30, 31, 32, 36, 105):  # attitude twice, position, motors, IMU
            session.request_stream(stream, 50.0)
        vehicle = take_off(session)
        vehicle.follow(paper_flight())
        vehicle.land()
    coaxlink("refine", str(log), "--airframe", str(AIRFRAME), "--json", str(out))
    added = {effect["name"]: effect for effect in json.loads(out.read_text())["effects"]}
    assert set(added) == {"rotor_drag", "degraded_rotor"}
    weak = {p["name"]: p["value"] for p in added["degraded_rotor"]["parameters"]}
    assert weak["rotor"] == 3 and weak["thrust_loss"] == pytest.approx(0.2, abs=0.02)
    before, after = added["rotor_drag"]["rmse"]["force_x"]  # whatever form of drag the flight chose
    assert after < 0.15 * before


def test_a_table_that_changed_within_a_log_is_no_change_of_the_vehicle(board: Px4, tmp_path: Path) -> None:
    """SDLOG_MODE 1 logs from boot: the log begins with the table before the upload."""
    tables, out = tmp_path / "fitted", tmp_path / "refined.json"
    coaxlink("table", str(AIRFRAME), "--firmware", "px4", "--out", str(tables))
    with board.boot(factory(tmp_path / "standard") | {"SDLOG_MODE": 1}) as url:
        upload(url, tables, tmp_path)
        with connect(url, timeout_s=60.0) as session:
            vehicle = take_off(session)
            vehicle.follow(paper_flight())
            vehicle.land()
    (log,) = board.folder.glob("log/*/*.ulg")
    done = coaxlink("refine", str(log), "--airframe", str(AIRFRAME), "--json", str(out), fails=True)
    found = json.loads(out.read_text())
    sys.stdout.write(f"\nexit {done.returncode}: {done.stdout}{done.stderr}")
    assert not found["effects"] and "(THR_MDL_FAC 1 to 0.726118)" in done.stderr


def held_to_realise(pulses: np.ndarray, tables: Path) -> None:
    """Mean setpoints (1000..2000 us) against the mix: each motor, and the split of each pair."""
    mix = firmware.realise(load_plan(tables).params)
    u = (pulses - 1000.0) / 1000.0
    setpoints = (mix.thr_mdl_fac * u * u + (1.0 - mix.thr_mdl_fac) * u).mean(axis=0)
    four = mix.mix[:, [0, 1, 2, 5]]
    thrust = np.linalg.lstsq(four, setpoints, rcond=None)[0][3]
    held_to_mix(setpoints, four, mix.setpoints([0.0, 0.0, 0.0, 0.0, 0.0, thrust]))
