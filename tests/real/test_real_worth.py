"""research/table_worth_real.py without a PX4: it says what it lacks; its figures are those of its rows."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as m
from real_autopilots import ROOT

sys.path.insert(0, str(ROOT / "research"))
import table_worth_real as worth


@pytest.mark.slow
def test_without_a_binary_it_says_so() -> None:
    command = [sys.executable, str(ROOT / "research" / "table_worth_real.py")]
    environment = {k: v for k, v in os.environ.items() if k != "PX4_SITL"} | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=100)
    assert done.returncode == 2
    assert (
        done.stderr.startswith("no PX4 to fly standard: PX4_SITL or --px4 names")
        and done.stderr.count("\n") == 1
    )


def test_figures_are_of_their_segments() -> None:
    """Power is the segment's number, a drop of 0.2 m from where it was, 3 degrees of roll off all the way."""
    rows, t, starts = [], 0.0, {}
    for n, segment in enumerate(worth.FLIGHT):
        starts[segment.name] = t
        down = -2.6 - 0.2 * (segment.name == "drop")  # 0.4 m of the estimator's own
        yaw = worth.HEADING - math.radians(2.0) if segment.name == "yaw" else 2 * math.pi + math.radians(2.0)
        for k in range(int(segment.duration_s / 0.1)):
            north, east = segment.at(0.1 * k).position_m[:2]
            mine = (float(n), 100.0 + t + 0.1 * k, down, yaw, 10.0 * n, north, east, -2.0, 98.0665, 11.0 * n)
            rows.append((*mine, 1000.0 * n, 2000.0, 58.8399))
        t += segment.duration_s
    rolled = (math.cos(math.radians(1.5)), math.sin(math.radians(1.5)), 0.0, 0.0)
    heard = []
    for k in range(int(t / 0.1)):
        heard.append(m.MAVLink_attitude_quaternion_message(100 * k, *rolled, 0.0, 0.0, 0.0))
        thrust = 0.4 if starts["hover"] <= 0.1 * k < starts["to the circle"] else 0.9
        heard.append(
            m.MAVLink_attitude_target_message(100 * k, 0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, thrust)
        )
    found = worth.figures(np.array(rows), heard, starts)
    assert set(found) == set(worth.FIGURES)
    assert found["battery power in hover"] == 22.0 and found["upper rotors in hover"] == 2000.0
    assert found["lower rotors in hover"] == 2000.0
    assert found["share from above"] == pytest.approx(0.6)
    assert found["power in hover"] == 20.0 and found["power in the circle"] == 40.0
    assert found["thrust demand in hover"] == pytest.approx(0.4)
    assert found["height after the drop, most"] == pytest.approx(0.2)
    assert found["height in the circle, rms"] == pytest.approx(0.0, abs=1e-12)
    for name in ("hover", "the circle", "yaw steps"):
        assert found[f"attitude in {name}, rms"] == pytest.approx(3.0, abs=1e-6)
    assert found["yaw in yaw steps, rms"] == pytest.approx(2.0)
    assert found["ceiling"] == pytest.approx(10.0)
    assert found["yaw acceleration in yaw steps, most of 0.1 s"] == pytest.approx(2.0)
    assert found["place in the circle, rms"] == pytest.approx(0.0, abs=1e-3)
