"""MAVProxy, a ground station of its own process, flies both stand-ins by what its user would type."""

import importlib.util
import math
import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sim.testing import standin

# MAVPROXY_PYTHON: an interpreter that has it, when this one has not
PYTHON = os.environ.get("MAVPROXY_PYTHON", sys.executable)
MISSING = "MAVPROXY_PYTHON" not in os.environ and importlib.util.find_spec("MAVProxy") is None
pytestmark = pytest.mark.skipif(MISSING, reason="MAVProxy is not installed: pip install MAVProxy")
LAT, LON, METRE = 47.397742, 8.545594, 1 / 111319.49
PARAMETERS = {"px4": 467, "ardupilot": 433}


class Typist:
    """A MAVProxy to type into, and what it printed."""

    def __init__(self, port: int, folder: Path) -> None:
        command = [PYTHON, "-m", "MAVProxy.mavproxy", f"--master=udpout:127.0.0.1:{port}", "--mav20"]
        command += ["--default-modules=wp,param,arm,mode,misc,cmdlong", f"--state-basedir={folder}"]
        command += ["--streamrate=4"]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
            env={**os.environ, "HOME": str(folder), "PYTHONUNBUFFERED": "1"},
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self.printed: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.rstrip())

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def see(self, pattern: str, seconds: float = 180.0) -> re.Match[str]:
        """Wait for a line. On a machine with other work MAVProxy asks for what it lost, which takes long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            self.printed.append(line)
            if (found := re.search(pattern, line)) is not None:
                return found
        raise AssertionError(f"no '{pattern}' in {self.printed[-25:]}")

    def position(self) -> tuple[float, float, float]:
        """By `status`, the last LOCAL_POSITION_NED."""
        self.type("status LOCAL_POSITION_NED")
        found = self.see(r"LOCAL_POSITION_NED \{.*?x : (\S+), y : (\S+), z : (\S+), vx")
        x, y, z = (float(found[k]) for k in (1, 2, 3))
        return x, y, z

    def until(self, goal: tuple[float, float, float], near: float) -> None:
        end = time.monotonic() + 600.0
        while math.dist(self.position(), goal) > near:
            assert time.monotonic() < end, self.printed[-15:]
            time.sleep(0.2)

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        try:
            self.process.wait(60.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join(5.0)
        self.process.stdout.close()


@contextmanager
def mavproxy(firmware: str, folder: Path) -> Iterator[Typist]:
    with standin("--firmware", firmware, "--speed", "5") as port:
        typist = Typist(port, folder)
        try:
            yield typist
        finally:
            typist.close()


def write_mission(path: Path, home: bool) -> None:
    """Up, to a corner, and down there, as QGC and MAVProxy keep missions."""
    rows = [(16, 0, 0, 0)] if home else []
    rows += [(22, 0, 0, 3), (16, 4, 3, 4), (21, 4, 3, 0)]
    text = "QGC WPL 110\n"
    for seq, (command, north, east, up) in enumerate(rows):
        lon = LON + east * METRE / math.cos(math.radians(LAT))
        frame = 0 if home and seq == 0 else 3
        goal = f"{LAT + north * METRE:.8f}\t{lon:.8f}\t{up:.2f}"
        text += f"{seq}\t{int(seq == 0)}\t{frame}\t{command}\t{15 * (command == 16)}\t0.5\t0\t0\t{goal}\t1\n"
    path.write_text(text)


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_mavproxy_flies_a_mission(firmware: str, tmp_path: Path) -> None:
    px4 = firmware == "px4"
    write_mission(tmp_path / "square.txt", home=not px4)
    with mavproxy(firmware, tmp_path) as user:
        user.see("online system 1")
        assert int(user.see(r"Received (\d+) parameters")[1]) == PARAMETERS[firmware]
        name = "MPC_LAND_SPEED" if px4 else "LAND_SPEED"
        value = 1.0 if px4 else 100
        shown = math.nan
        for _ in range(20):  # until the echo is there; MAVProxy gives up after three seconds
            user.type(f"param set {name} {value}")
            user.type(f"param show {name}")
            shown = float(user.see(rf"{name}\s+([-.\d]+)")[1])
            if shown == value:
                break
            time.sleep(0.2)
        assert shown == value
        user.type("wp load square.txt")
        user.see(rf"Loaded {3 if px4 else 4} waypoints")
        user.see("Flight plan received|Sent all|Got MISSION_ACK.*ACCEPTED")
        if not px4:
            user.type("mode GUIDED")
            user.see("Mode GUIDED")
        user.type("arm throttle")
        user.see("ARMED")
        user.type("takeoff 3")
        user.until((0, 0, -2.5 if px4 else -3), 0.4)  # PX4 reads a height above the sea: its own minimum
        user.type("long MAV_CMD_DO_SET_MODE 1 4 4 0 0 0 0" if px4 else "mode AUTO")
        user.see("Mode (MISSION|AUTO)")
        user.until((4, 3, -4), 0.8)
        user.see("DISARMED")
        assert math.dist(user.position(), (4, 3, 0)) < 0.5
