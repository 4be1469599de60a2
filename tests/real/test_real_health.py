"""`coaxlink health` on logs that the real PX4 and ArduCopter kept: PX4_SITL, ARDUCOPTER_SITL name them.

Every test prints what it measured: `pytest -s`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from losing_world import Loss
from real_autopilots import AIRFRAME, ROOT, coaxlink, take_off
from test_real_fly import ENDING, Flier, firmwares, flier

from coaxlink.fly.trajectory import FlightPlan, Hold
from coaxlink.mavlink import connect

pytestmark = pytest.mark.timeout(1800)
WEAK, AFTER_S = 3, 15.0


def judged(vehicle: Flier, plan: str, folder: Path) -> dict[str, Any]:
    """What `health` says of a flight of this plan, and how far it was off the plan."""
    vehicle.out = folder / plan
    code, determined, flown = vehicle.fly("--plan", plan, "--height", "4")
    assert code == 0, determined
    log, answer = vehicle.out / f"flight.{ENDING[vehicle.firmware]}", vehicle.out / "health.json"
    done = coaxlink("health", str(log), "--airframe", str(AIRFRAME), "--json", str(answer), fails=True)
    assert answer.is_file(), done.stderr
    found: dict[str, Any] = json.loads(answer.read_text())
    rotors = found["flights"][-1]["rotors"] if found["flights"] else []
    outside = [r["rotor"] for r in rotors if not r["thrust"][1] <= 1.0 <= r["thrust"][2]]
    sys.stdout.write(
        f"\n{vehicle.firmware}, {plan}: {found['verdict']}, {found['cannot_judge']}, loss of 5 % "
        f"{found['probability']:.4f}, load moved {found['payload_moved']:.3f}, outside {outside}, "
        f"off the plan {flown['worst_off_plan_m']:.2f} m, worst {found['suspects'][:1]}"
    )
    return found | {"outside": outside, "said": done.stdout}


@firmwares
def test_sound_rotors_are_sound_and_inside_their_intervals(tmp_path: Path, firmware: str) -> None:
    with flier(firmware, tmp_path) as vehicle:
        for plan in ("hover", "circle", "steps", "identify"):
            found = judged(vehicle, plan, tmp_path)
            assert found["verdict"] in ("sound", "cannot judge") and not found["outside"]
            assert found["payload_moved"] < 0.5 and "centre of mass" not in found["said"]


@firmwares
@pytest.mark.parametrize("plan", ["circle", "identify"])
def test_a_rotor_that_loses_a_tenth_in_the_air_is_named(tmp_path: Path, firmware: str, plan: str) -> None:
    with flier(firmware, tmp_path, loss=Loss(WEAK, 0.1, after_s=AFTER_S)) as vehicle:
        found = judged(vehicle, plan, tmp_path)
    worst = found["suspects"][0]
    assert found["verdict"] == "ground it" and worst["rotor"] == WEAK
    assert worst["loss"][1] < 0.1 < worst["loss"][2]


@firmwares
def test_monitor_names_it_while_it_hovers(tmp_path: Path, firmware: str) -> None:
    loss, since = Loss.by_word(WEAK, 0.1), []

    def lose(_: str, t: float) -> None:
        if t > 30.0 and not since:
            since.append(session.latest("LOCAL_POSITION_NED").time_boot_ms / 1e3)
            loss.determined.set()

    with flier(firmware, tmp_path, loss=loss) as vehicle, connect(vehicle.url, timeout_s=60.0) as session:
        command = [sys.executable, "-m", "coaxlink", "monitor", "--connect", vehicle.pilot]
        command += ["--airframe", str(AIRFRAME), "--once", "--seconds", "40"]
        flown = take_off(session)
        watch = subprocess.Popen(
            [*command, "--json", str(tmp_path / "m.json")], cwd=tmp_path, text=True, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        flown.follow(FlightPlan((Hold("hover", (0.0, 0.0, -3.0), 80.0),)), lose)
        reported, _ = watch.communicate(timeout=120.0)
        flown.land()
    (call,) = json.loads((tmp_path / "m.json").read_text())["health"]["calls"]
    sys.stdout.write(f"\n{firmware}, monitor, after {call['time_s'] - since[0]:.1f} s: {call}")
    assert call["rotor"] == WEAK and abs(call["loss"] - 0.1) < 3 * call["loss_sd"]
    assert f"rotor {WEAK} (x) lost" in reported
