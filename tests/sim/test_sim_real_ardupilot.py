"""The real ArduCopter on the bridge, flown by bare pymavlink: ARDUCOPTER_SITL names its binary."""

import math
import os
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil

from coaxlink.studies.simulator import free_port
from sim.ardupilot.mixer import ArduPilotMixer
from sim.ardupilot.store import ArduPilotStore
from sim.bridge.ardupilot_json import ArduPilotBridge
from sim.px4.tuning import tune
from sim.simulation import Simulation, build_bridge

BINARY = os.environ.get("ARDUCOPTER_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="ARDUCOPTER_SITL names no binary"),
    pytest.mark.timeout(1800),
]
AIRFRAME = Path(__file__).parents[2] / "examples" / "x8_demo.toml"
GUIDED = 4


def defaults(bridge: ArduPilotBridge) -> str:
    """What the vehicle's owner would have set: frame, outputs, hover thrust, rate gains; no radio."""
    store = ArduPilotStore(bridge.plant.vehicle)
    tuned = tune(ArduPilotMixer(store, 8), bridge.plant)
    values: dict[str, float] = {"FRAME_CLASS": 4, "FRAME_TYPE": 1, "ARMING_CHECK": 0, "FS_THR_ENABLE": 0}
    values |= {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 9)}
    values |= {"MOT_THST_HOVER": min(max(tuned.hover, 0.125), 0.6875), "SIM_RATE_HZ": 800, "DISARM_DELAY": 0}
    values |= {"MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000, "LOG_BACKEND_TYPE": 0}
    for axis, gains in zip(("RLL", "PIT", "YAW"), tuned.gains, strict=True):
        values |= {f"ATC_RAT_{axis}_{k}": g for k, g in zip("PID", gains, strict=True)}
    return "".join(f"{name} {value:.9g}\n" for name, value in values.items())


@pytest.fixture
def flown(tmp_path: Path) -> Iterator[tuple[ArduPilotBridge, Any]]:
    bridge = build_bridge(Simulation(AIRFRAME), "ardupilot", "udpin:127.0.0.1:0")
    stop = threading.Event()
    thread = threading.Thread(target=bridge.run, args=(stop.is_set,))
    thread.start()
    (tmp_path / "defaults.parm").write_text(defaults(bridge))
    port = free_port()
    command = [BINARY, "--model", "JSON:127.0.0.1", "--sim-port-out", bridge.name.rpartition(":")[2]]
    command += ["--speedup", "4", "--rate", "800", "--defaults", str(tmp_path / "defaults.parm"), "--wipe"]
    command += ["--home", "47.397742,8.545594,488,0", "--serial0", f"udpclient:127.0.0.1:{port}"]
    with (tmp_path / "talk").open("w") as talk:
        process = subprocess.Popen(
            command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=talk, stderr=subprocess.STDOUT
        )
        link = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{port}", source_system=255, dialect="ardupilotmega"
        )
        try:
            assert link.wait_heartbeat(timeout=600) is not None, (tmp_path / "talk").read_text()[-2000:]
            yield bridge, link
        finally:
            link.close()
            process.terminate()
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            stop.set()
            thread.join(10.0)
            bridge.close()


def command(link: Any, number: int, *p: float) -> int:
    end = time.monotonic() + 600.0
    link.mav.command_long_send(1, 1, number, 0, *[*p, *[0.0] * (7 - len(p))])
    while time.monotonic() < end:
        ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0)
        if ack is not None and ack.command == number:
            return int(ack.result)
    raise AssertionError(f"no answer to command {number}")


def test_the_real_arducopter_takes_off_hovers_and_lands(flown: tuple[ArduPilotBridge, Any]) -> None:
    bridge, link = flown
    end = time.monotonic() + 600.0
    assert command(link, 511, 32, 50000) == 0
    while command(link, 176, 1, GUIDED) != 0 or command(link, 400, 1) != 0:  # its estimator settles
        assert time.monotonic() < end
        time.sleep(0.5)
    assert command(link, 22, 0, 0, 0, 0, 0, 0, 3.0) == 0
    errors, heights, start = [], [], None
    while start is None or bridge.time_s < start + 15.0:
        estimate = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=600)
        assert estimate is not None and time.monotonic() < end + 60.0
        truth = bridge.plant.position.copy()
        if start is None and truth[2] < -2.8:
            start = bridge.time_s + 3.0
        elif start is not None and bridge.time_s > start:
            heights.append(-truth[2])
            errors.append(math.dist((estimate.x, estimate.y, estimate.z), truth))
    assert sum(heights) / len(heights) == pytest.approx(3.0, abs=0.3)
    assert max(heights) - min(heights) < 0.5 and max(errors) < 1.5
    assert command(link, 21) == 0
    while link.recv_match(type="HEARTBEAT", blocking=True, timeout=600).base_mode & 128:
        assert time.monotonic() < end + 90.0
    assert abs(bridge.plant.position[2]) < 0.1
    assert bridge.lost == 0
