"""The real ArduCopter (ARDUCOPTER_SITL names its binary): flown over the bridge, given both tables."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from real_autopilots import ROOT, arducopter, coaxlink, hover

from coaxlink.errors import CoaxlinkError
from coaxlink.link import connect
from coaxlink.link.plan import load_plan
from coaxlink.link.session import Session
from coaxlink.link.trajectory import table_4_flight
from coaxlink.link.vehicle import Vehicle

BINARY = os.environ.get("ARDUCOPTER_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="ARDUCOPTER_SITL names no binary"),
    pytest.mark.timeout(500),
]
AIRFRAME = ROOT / "examples" / "x8_demo.toml"
PAIRS = ((0, 5), (1, 4), (2, 7), (3, 6))
FACTORY = {
    "FRAME_CLASS": 4,
    "FRAME_TYPE": 1,
    "MOT_THST_EXPO": 1.0,
    "MOT_SPIN_ARM": 0.03,
    "MOT_SPIN_MIN": 0.05,
    "MOT_SPIN_MAX": 1.0,
    "MOT_PWM_MIN": 1000,
    "MOT_PWM_MAX": 2000,
    "MOT_THST_HOVER": 0.34,
    "ATC_RAT_YAW_P": 0.4,
    "ATC_RAT_YAW_I": 0.04,
    "FS_THR_ENABLE": 0,
    **{f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)},
}


def take_off(session: Session) -> Vehicle:
    vehicle, end = Vehicle(session), time.monotonic() + 90.0
    while True:
        try:
            vehicle.arm()
            break
        except CoaxlinkError:  # its estimator has not settled yet
            assert time.monotonic() < end
            time.sleep(1.0)
    vehicle.take_off(3.0)
    return vehicle


@pytest.mark.parametrize("frame_class", [15, 17])
def test_a_table_is_flown_as_realise_says(tmp_path: Path, frame_class: int) -> None:
    tables, folder, out = tmp_path / "table", tmp_path / "ap", tmp_path / "up.json"
    folder.mkdir()
    options = ("--firmware", "ardupilot", "--frame-class", str(frame_class))
    coaxlink("table", str(AIRFRAME), *options, "--out", str(tables), "--json", str(tmp_path / "table.json"))
    with arducopter(Path(BINARY), folder, FACTORY, "--airframe", str(AIRFRAME)) as url:
        with connect(url, timeout_s=60.0) as session:
            take_off(session)
        refused = coaxlink("upload", str(tables), "--connect", url, "--yes", fails=True)
        assert refused.returncode == 4 and "armed" in refused.stderr
        with connect(url, timeout_s=60.0) as session:
            vehicle = Vehicle(session)
            track = vehicle.follow(table_4_flight())
            vehicle.land()
        far = np.linalg.norm(np.array(track.wanted_m) - np.array(track.flown_m), axis=1)
        assert np.sqrt((far**2).mean()) < 1.0  # ArduCopter shapes its own way to a set-point
        coaxlink("upload", str(tables), "--connect", url, "--yes", "--json", str(out), cwd=tmp_path)
        written = json.loads(out.read_text())
        assert written["result"] == "verified" and written["scripts"]
        coaxlink("verify", str(tables), "--connect", url)
        with connect(url, timeout_s=60.0) as session:
            pulses = hover(session, take_off(session))
    held_to_realise(pulses, tables)


def held_to_realise(pulses: np.ndarray, tables: Path) -> None:
    """Mean thrust of each motor (1000..2000 us) against the factors; lower over upper in each pair."""
    params = load_plan(tables).params
    expo, low, high = (float(params[f"MOT_{k}"]) for k in ("THST_EXPO", "SPIN_MIN", "SPIN_MAX"))
    a = ((pulses - 1000.0) / 1000.0 - low) / (high - low)
    thrust = ((1.0 - expo) * a + expo * a * a).mean(axis=0)
    wanted = json.loads((tables.parent / "table.json").read_text())
    factors = np.array(wanted["factors"]["rows"], float)
    control = np.linalg.lstsq(factors, thrust, rcond=None)[0]
    assert thrust == pytest.approx(factors @ control, rel=0.005)
    for upper, lower in PAIRS:
        assert thrust[lower] / thrust[upper] == pytest.approx(
            factors[lower, 3] / factors[upper, 3], rel=0.005
        )
