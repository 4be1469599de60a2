"""The real ArduCopter (ARDUCOPTER_SITL names its binary): flown over the bridge, given both tables."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from real_autopilots import (
    AIRFRAME,
    arducopter,
    coaxlink,
    fly_the_factory_table,
    held_to_mix,
    hover,
    take_off,
    upload,
)

from coaxlink.mavlink import connect
from coaxlink.uploading.plan import load_plan

BINARY = os.environ.get("ARDUCOPTER_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="ARDUCOPTER_SITL names no binary"),
    pytest.mark.timeout(1800),
]
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


@pytest.mark.parametrize("frame_class", [15, 17])
def test_a_table_is_flown_as_realise_says(tmp_path: Path, frame_class: int) -> None:
    tables, folder = tmp_path / "table", tmp_path / "ap"
    folder.mkdir()
    options = ("--firmware", "ardupilot", "--frame-class", str(frame_class))
    coaxlink("table", str(AIRFRAME), *options, "--out", str(tables), "--json", str(tmp_path / "table.json"))
    with arducopter(Path(BINARY), folder, FACTORY, "--airframe", str(AIRFRAME)) as url:
        # ArduCopter shapes its own way to a set-point
        assert fly_the_factory_table(url, tables) < 1.0
        assert upload(url, tables, tmp_path)["scripts"]
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
    held_to_mix(thrust, factors, factors[:, 3])
