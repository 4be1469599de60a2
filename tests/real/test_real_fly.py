"""`coaxlink fly`, as a user types it, on the real PX4 and ArduCopter: PX4_SITL, ARDUCOPTER_SITL name them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("MAVLINK20", "1")
from losing_world import Loss
from pymavlink import mavutil
from real_autopilots import AIRFRAME, ROOT, arducopter, held, px4
from test_real_ardupilot import FACTORY
from test_real_px4 import factory

from coaxlink.data import read_flight_log
from coaxlink.studies.simulator import free_port

BINARIES = {"px4": os.environ.get("PX4_SITL", ""), "ardupilot": os.environ.get("ARDUCOPTER_SITL", "")}
VARIABLE = {"px4": "PX4_SITL", "ardupilot": "ARDUCOPTER_SITL"}
PATIENT = 300.0  # s of wall time for what an idle machine sees within a few
OFFBOARD, AUTO, LOITER = 6, 4, 3  # main and sub modes of PX4
GUIDED, BRAKE, LAND = 4, 17, 9  # of ArduCopter
ENDING = {"px4": "ulg", "ardupilot": "bin"}
OFF_PLAN_M = {"px4": 0.6, "ardupilot": 1.5}  # ArduCopter shapes its own way to a set-point
# empty after some seconds in the air, full again once disarmed; ArduCopter's JSON simulation stays full
EMPTIES = {"SIM_BAT_DRAIN": 20.0, "SIM_BAT_MIN_PCT": 40.0}
CARES = {
    "px4": {"COM_DISARM_PRFLT": -1.0, "COM_OF_LOSS_T": 20.0},  # a busy machine is no lost link
    "ardupilot": {"BATT_MONITOR": 4.0, "BATT_CAPACITY": 20000.0, "DISARM_DELAY": 0.0, "FS_GCS_ENABLE": 0.0},
}
pytestmark = pytest.mark.timeout(1800)
firmwares = pytest.mark.parametrize(
    "firmware",
    [
        pytest.param(name, marks=pytest.mark.skipif(not path, reason=f"{VARIABLE[name]} names no binary"))
        for name, path in BINARIES.items()
    ],
)


@dataclass
class Flier:
    """One vehicle: our line, and the address on which its pilot is heard."""

    firmware: str
    url: str
    pilot: str
    out: Path

    def fly(self, *options: str) -> tuple[int, str, dict[str, Any]]:
        """Exit code, what was said and the JSON of one call of the verb."""
        json_file = self.out / "fly.json"
        json_file.unlink(missing_ok=True)
        command = [sys.executable, "-m", "coaxlink", "fly", "--connect", self.url, "--timeout", "60", "--yes"]
        command += ["--out", str(self.out), "--json", str(json_file), *options]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=900, check=False
        )
        found = json.loads(json_file.read_text()) if json_file.is_file() else {}
        return done.returncode, done.stdout + done.stderr, found

    def ready(self) -> None:
        """Until its own checks pass: its estimator takes its time."""
        for _ in range(20):
            code, determined, _ = self.fly("--dry-run", "--battery", "0")
            if code == 0:
                return
        raise AssertionError(determined)


@contextmanager
def flier(
    firmware: str, folder: Path, *options: str, loss: Loss | None = None, **params: float
) -> Iterator[Flier]:
    """A vehicle whose owner set it up, on the ground and ready; options are its world's."""
    home, out = folder / "board", folder / "flight"
    home.mkdir()
    values = CARES[firmware] | params
    with ExitStack() as stack:
        if firmware == "px4":
            world = ("--airframe", str(AIRFRAME), "--speed", "2", *options)
            board = stack.enter_context(px4(Path(BINARIES[firmware]), home, *world, loss=loss, speed=2.0))
            url = stack.enter_context(board.boot(factory(folder / "standard") | values))
            pilot = f"udpout:127.0.0.1:{18570 + board.instance}"
        else:
            port = free_port()
            pilot = f"udpin:127.0.0.1:{port}"
            world = ("--airframe", str(AIRFRAME), *options)
            url = stack.enter_context(
                arducopter(
                    Path(BINARIES[firmware]),
                    home,
                    FACTORY | values,
                    *world,
                    speed=2.0,
                    second_port=port,
                    loss=loss,
                )
            )
        vehicle = Flier(firmware, url, pilot, out)
        vehicle.ready()
        yield vehicle


class Second:
    """The pilot's own station, on a second link."""

    def __init__(self, vehicle: Flier) -> None:
        self.firmware = vehicle.firmware
        self.link: Any = mavutil.mavlink_connection(vehicle.pilot, source_system=250)
        self.stop = threading.Event()

    def __enter__(self) -> Second:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self.link.close()

    def beat(self) -> Any:
        """The vehicle's next heartbeat; ours goes out before."""
        while not self.stop.is_set():
            self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
            found = self.link.recv_match(type="HEARTBEAT", blocking=True, timeout=1.0)
            if found is not None and found.autopilot in (3, 12):
                return found
        return None

    def follows(self, beat: Any) -> bool:
        """Whether it flies after set-points."""
        if self.firmware == "px4":
            return beat.custom_mode >> 16 & 0xFF == OFFBOARD
        return bool(beat.custom_mode == GUIDED and beat.base_mode & 128)

    def order(self, number: int, *p: float) -> None:
        """One command."""
        system = self.link.target_system or 1
        self.link.mav.command_long_send(system, 1, number, 0, *[*p, *[0.0] * (7 - len(p))])

    def takes_over(self, after: int) -> None:
        """Hold its place, as soon as it has followed set-points for some heartbeats."""
        seen = 0
        while (beat := self.beat()) is not None:
            if not self.follows(beat):
                continue
            seen += 1
            if seen > after:
                self.order(176, 1, *((AUTO, LOITER) if self.firmware == "px4" else (BRAKE,)))

    def armed(self, wanted: bool, number: int, *p: float) -> None:
        """Repeat a command until it is armed, or not."""
        for _ in range(int(PATIENT)):
            beat = self.beat()
            if bool(beat.base_mode & 128) == wanted:
                return
            self.order(number, *p)
        raise AssertionError(f"still {'disarmed' if wanted else 'armed'}")


@firmwares
def test_plans_are_flown_and_their_logs_come_down(tmp_path: Path, firmware: str) -> None:
    """Three flights of one boot, each with its own log; the last is refined in the same call."""
    with flier(firmware, tmp_path) as vehicle:
        height = held(vehicle.url, ["MIS_TAKEOFF_ALT"])
        lengths = []
        for plan in ("hover", "circle", "identify"):
            vehicle.out = tmp_path / plan
            refine = ("--airframe", str(AIRFRAME)) if plan == "identify" else ()
            code, determined, found = vehicle.fly("--plan", plan, "--height", "4", *refine)
            assert code == 0, determined
            assert found["result"] == "flown" and found["flown_s"] > 0.98 * found["plan_s"]
            assert found["worst_off_plan_m"] < OFF_PLAN_M[firmware]
            assert found["crc"] == "same", determined
            log = read_flight_log(tmp_path / plan / f"flight.{ENDING[firmware]}")
            assert 3.5 < log["height_m"].max() < 6.0
            lengths.append(float(log["time_s"][-1] - log["time_s"][0]))
        assert held(vehicle.url, ["MIS_TAKEOFF_ALT"]) == height
    assert lengths[2] > lengths[0] + 20.0
    refined = json.loads((tmp_path / "identify" / "refine.json").read_text())
    assert refined


@firmwares
def test_its_pilot_ends_it_at_once(tmp_path: Path, firmware: str) -> None:
    with flier(firmware, tmp_path) as vehicle, Second(vehicle) as pilot:
        thread = threading.Thread(target=pilot.takes_over, args=(12,))
        thread.start()
        try:
            code, determined, found = vehicle.fly("--plan", "hover", "--no-log")
        finally:
            pilot.stop.set()
            thread.join()
        assert code == 1, determined
        assert found["result"] == "pilot" and "its pilot or its own failsafe has it" in determined
        pilot.stop.clear()
        for _ in range(4):  # nobody took it back
            beat = pilot.beat()
            assert beat.base_mode & 128 and not pilot.follows(beat)
        pilot.armed(False, *((176, 1, AUTO, 6) if firmware == "px4" else (176, 1, LAND)))


WIND = """
[[effects]]
name = "wind"
size = 6.0
gust_m_s = 3.0
"""


@firmwares
def test_a_breach_of_the_fence_lands_it(tmp_path: Path, firmware: str) -> None:
    """Gusts carry it out of a fence that the plan alone would keep, by a hand's breadth."""
    truth = tmp_path / "truth.toml"
    truth.write_text(WIND)
    with flier(firmware, tmp_path, "--truth", str(truth)) as vehicle, Second(vehicle) as pilot:
        code, determined, found = vehicle.fly("--plan", "circle", "--fence", "2.05")
        assert code == 4, determined
        assert found["result"] == "limit" and "from the take-off point, 2.05 is the limit" in determined
        assert not pilot.beat().base_mode & 128
        assert found["crc"] == "same", determined


@firmwares
def test_it_is_refused_while_armed(tmp_path: Path, firmware: str) -> None:
    with flier(firmware, tmp_path) as vehicle, Second(vehicle) as pilot:
        pilot.armed(True, 400, 1)
        code, determined, found = vehicle.fly("--plan", "hover", "--battery", "0")
        assert code == 4 and "the vehicle is armed" in determined
        assert found["result"] == "not armed"


@pytest.mark.skipif(not BINARIES["px4"], reason="PX4_SITL names no binary")
def test_a_refused_arming_is_in_its_own_words(tmp_path: Path) -> None:
    """PX4 sends its words to whoever beats as a ground station."""
    (tmp_path / "board").mkdir()
    values = factory(tmp_path / "standard") | CARES["px4"] | {"COM_ARM_ODID": 2}
    with (
        px4(Path(BINARIES["px4"]), tmp_path / "board", "--airframe", str(AIRFRAME)) as board,
        board.boot(values) as url,
    ):
        vehicle = Flier("px4", url, "", tmp_path / "flight")
        code, determined, _ = vehicle.fly("--plan", "hover", "--battery", "0")
    sys.stdout.write(f"\n{code}: {determined}")
    assert (
        code == 4
        and "it says: " in determined
        and "Preflight Fail: Open Drone ID system missing" in determined
    )


@pytest.mark.skipif(not BINARIES["px4"], reason="PX4_SITL names no binary")
def test_a_falling_battery_lands_it(tmp_path: Path) -> None:
    with flier("px4", tmp_path, **EMPTIES) as vehicle, Second(vehicle) as pilot:
        code, determined, found = vehicle.fly("--plan", "identify", "--battery", "0.75", "--no-log")
        assert code == 4, determined
        assert found["result"] == "limit" and "75 is the limit" in determined
        assert not pilot.beat().base_mode & 128
