"""The real PX4 on the bridge, flown by bare pymavlink: PX4_SITL names its binary (`etc` is beside `bin`)."""

import math
import os
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil

from sim.bridge.px4_hil import Px4Bridge
from sim.px4.mixer import Px4Mixer
from sim.px4.store import Px4Store
from sim.px4.tuning import tune
from sim.simulation import Simulation, build_bridge

BINARY = os.environ.get("PX4_SITL", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="PX4_SITL names no binary"),
    pytest.mark.timeout(1800),
]
AIRFRAME = Path(__file__).parents[2] / "examples" / "x8_demo.toml"


def instance() -> int:
    """One whose ports nobody has; from 9 on all send to one port."""
    for number in range(8, 0, -1):
        kinds = ((socket.SOCK_STREAM, 4560), (socket.SOCK_DGRAM, 14540), (socket.SOCK_DGRAM, 14580))
        try:
            for kind, base in kinds:
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", base + number))
        except OSError:
            continue
        return number
    pytest.skip("no PX4 instance is free on this machine")


def presets(bridge: Px4Bridge) -> dict[str, str]:
    """What the vehicle's owner would have set: geometry, outputs, hover thrust, rate gains."""
    store = Px4Store((1, 16, 1), bridge.plant.vehicle)
    tuned, rotors = tune(Px4Mixer(store, 8), bridge.plant), range(8)
    names = [f"CA_ROTOR{n}_{k}" for n in rotors for k in ("PX", "PY", "PZ", "KM", "CT")]
    names += [f"PWM_MAIN_FUNC{n + 1}" for n in rotors] + ["CA_ROTOR_COUNT"]
    values: dict[str, float] = {name: store[name] for name in names}
    values |= {"CA_AIRFRAME": 0, "MPC_THR_HOVER": tuned.hover, "COM_RC_IN_MODE": 4, "SIM_BAT_MIN_PCT": 100}
    values["COM_DISARM_PRFLT"] = -1.0  # ten of its seconds are a moment of ours
    for axis, gains in zip(("ROLL", "PITCH", "YAW"), tuned.gains, strict=True):
        values |= {f"MC_{axis}RATE_{k}": g for k, g in zip("PID", gains, strict=True)}
    return {f"PX4_PARAM_{name}": repr(value) for name, value in values.items()}


@pytest.fixture
def flown(tmp_path: Path) -> Iterator[tuple[Px4Bridge, Any, int]]:
    number = instance()
    bridge = build_bridge(Simulation(AIRFRAME), "px4", f"tcpin:127.0.0.1:{4560 + number}")
    stop = threading.Event()
    thread = threading.Thread(target=bridge.run, args=(stop.is_set,))
    thread.start()
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PX4_")}
    etc = Path(BINARY).resolve().parents[1] / "etc"
    with (tmp_path / "talk").open("w") as talk:
        process = subprocess.Popen(
            [BINARY, "-d", "-i", str(number), "-w", str(tmp_path), str(etc)],
            cwd=tmp_path,
            env=clean | presets(bridge) | {"PX4_SYS_AUTOSTART": "10016"},
            stdin=subprocess.DEVNULL,
            stdout=talk,
            stderr=subprocess.STDOUT,
        )
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{14540 + number}", source_system=245)
        try:
            assert link.wait_heartbeat(timeout=600) is not None, (tmp_path / "talk").read_text()[-2000:]
            yield bridge, link, number + 1
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


def command(link: Any, system: int, number: int, *p: float) -> int:
    for _ in range(10):  # at thirty times real time an answer may be lost among the rest
        link.mav.command_long_send(system, 1, number, 0, *[*p, *[0.0] * (7 - len(p))])
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.5)
            if ack is not None and ack.command == number:
                return int(ack.result)
    raise AssertionError(f"no answer to command {number}")


def test_the_real_px4_takes_off_hovers_and_lands(flown: tuple[Px4Bridge, Any, int]) -> None:
    bridge, link, system = flown
    end = time.monotonic() + 600.0
    while command(link, system, 400, 1) != 0:  # its estimator has not settled yet
        assert time.monotonic() < end
        time.sleep(0.5)
    nan = math.nan
    assert command(link, system, 22, 0, 0, 0, nan, nan, nan, nan) == 0
    errors, heights, start = [], [], None
    while start is None or bridge.plant.time_s < start + 20.0:
        estimate = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=600)
        assert estimate is not None and time.monotonic() < end + 60.0, bridge.status()
        truth = bridge.plant.position.copy()
        if start is None and truth[2] < -2.3:
            start = bridge.plant.time_s + 3.0
        elif start is not None and bridge.plant.time_s > start:
            heights.append(-truth[2])
            errors.append(math.dist((estimate.x, estimate.y, estimate.z), truth))
    assert sum(heights) / len(heights) == pytest.approx(2.5, abs=0.2)  # MIS_TAKEOFF_ALT
    assert max(heights) - min(heights) < 0.4 and max(errors) < 0.5
    assert command(link, system, 21) == 0
    while link.wait_heartbeat(timeout=600).base_mode & 128:
        assert time.monotonic() < end + 90.0, bridge.status()
    assert abs(bridge.plant.position[2]) < 0.1
    assert bridge.timeouts <= bridge.steps // 100 and bridge.stale <= 20 + bridge.timeouts, bridge.status()


def test_the_real_px4_saves_its_parameters_and_arms_again_and_again(
    flown: tuple[Px4Bridge, Any, int],
) -> None:
    """While it saves, controls fail to come now and then; that must not stop the two for good."""
    bridge, link, system = flown
    end = time.monotonic() + 600.0
    while command(link, system, 400, 1) != 0:
        assert time.monotonic() < end
        time.sleep(0.3)
    for n in range(60):
        link.mav.param_set_send(system, 1, b"MPC_XY_CRUISE", 3.0 + 0.01 * n, 9)
        if n % 20 == 19:
            command(link, system, 245, 1)
        time.sleep(0.05)
    before = bridge.steps
    for _ in range(5):
        command(link, system, 400, 0, 21196)
        assert command(link, system, 400, 1) == 0
    assert bridge.steps > before and bridge.timeouts < bridge.steps // 100, bridge.status()
