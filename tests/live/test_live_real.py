"""`coaxlink mix` in a process of its own, through real sockets and a serial line: stopped, killed, recorded.

What counts in milliseconds is in test_live_faults.py; here nothing hangs on how busy the machine is.
"""

from __future__ import annotations

import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_flight import EXAMPLES, HEIGHT_M, TICK_S
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.data.logs.live_record import read_record
from sim.simulation import Simulation, build, open_links

AIRFRAME = EXAMPLES / "x8_demo.toml"
PATIENCE_S = 60.0
pytestmark = pytest.mark.slow


class Flight:
    """A stand-in on a UDP port, hovering, ticked by the test in step with the machine's clock."""

    def __init__(self) -> None:
        self.ports = open_links(["udpin:127.0.0.1:0"])
        self.url = "udpout:" + self.ports[0].name.partition(":")[2]
        self.standin = build(Simulation(AIRFRAME, firmware="px4:1.13"), self.ports)
        self.autopilot = self.standin.autopilot
        self.commands: list[list[float]] = []
        self.autopilot.store.write("THR_MDL_FAC", 9, 1.0)
        self.autopilot.arm()
        self.autopilot.take_off(HEIGHT_M)
        self._tick(3000)

    def _tick(self, count: int) -> None:
        for _ in range(count):
            self.standin.tick()
            self.commands.append(self.autopilot.command.tolist())

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Whether `until` came true."""
        due = time.monotonic()
        for _ in range(round(seconds / TICK_S)):
            self._tick(1)
            if until():
                return True
            due = max(due + TICK_S, time.monotonic() - TICK_S)
            time.sleep(max(due - time.monotonic(), 0.0))
        return False

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.live)

    def stays_up(self) -> None:
        self._tick(750)
        u = np.array(self.commands)
        assert np.isfinite(u).all() and (u >= 0.0).all() and (u <= 1.0).all()
        assert self.autopilot.plant.height > 1.0 and not self.autopilot.landed


@pytest.fixture(scope="module")
def flight() -> Iterator[Flight]:
    vehicle = Flight()
    yield vehicle
    for port in vehicle.ports:
        port.close()


@contextmanager
def mixing(flight: Flight, url: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    """The verb driving the vehicle, in a process that does not outlive the test."""
    words = [sys.executable, "-m", "coaxlink", "mix", str(AIRFRAME), "--connect", url, "--no-witness"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([*words, *options], text=True, **quiet)  # type: ignore[call-overload]
    try:
        assert flight.fly(PATIENCE_S, until=lambda: flight.driven)
        yield process
    finally:
        process.kill()
        process.wait()


def test_stopped_and_going_on_and_killed(flight: Flight, tmp_path: Path) -> None:
    with mixing(flight, flight.url, "--record", str(tmp_path), "--lost", "1") as process:
        flight.fly(1.0)
        os.kill(process.pid, signal.SIGSTOP)
        flight.fly(3.0)  # longer than a link may be silent
        assert not flight.driven
        written = (tmp_path / "mix.live").stat().st_size
        os.kill(process.pid, signal.SIGCONT)
        assert flight.fly(PATIENCE_S, until=lambda: flight.driven)
        assert flight.fly(PATIENCE_S, until=lambda: (tmp_path / "mix.live").stat().st_size > written + 20_000)
        assert process.poll() is None  # its own absence is no lost link
        last_us = round(1e6 * flight.autopilot.reading.time_s) + 1_000_000
        os.kill(process.pid, signal.SIGKILL)
        assert flight.fly(PATIENCE_S, until=lambda: not flight.driven)
        flight.stays_up()
    _, rows = read_record(tmp_path / "mix.live")
    assert last_us - int(rows["stamp_us"][-1]) < 1_000_000
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    reported = parser.parse_buffer((tmp_path / "mix.tlog").read_bytes()) or []
    assert last_us - [m.time_usec for m in reported if m.get_type() == "HIGHRES_IMU"][-1] < 1_000_000


def test_told_to_stop_it_hands_the_vehicle_back_and_ends_with_0(flight: Flight) -> None:
    with mixing(flight, flight.url) as process:
        flight.fly(0.5)
        process.send_signal(signal.SIGINT)
        assert flight.fly(PATIENCE_S, until=lambda: process.poll() is not None)
        assert process.returncode == 0
        assert flight.fly(PATIENCE_S, until=lambda: not flight.driven)
    flight.stays_up()


def test_it_mixes_over_a_serial_line(flight: Flight) -> None:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    host, _, port = flight.url.removeprefix("udpout:").rpartition(":")
    link.connect((host, int(port)))
    link.settimeout(0.05)
    stop = threading.Event()

    def to_line() -> None:
        link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 244, 1)))
        while not stop.is_set():
            try:
                os.write(ours, link.recv(65536))
            except OSError:
                continue

    def from_line() -> None:
        while not stop.is_set():
            try:
                link.send(os.read(ours, 4096))
            except OSError:
                return

    threads = [threading.Thread(target=work, daemon=True) for work in (to_line, from_line)]
    for thread in threads:
        thread.start()
    with mixing(flight, f"{os.ttyname(theirs)},921600") as process:
        assert flight.fly(1.0, until=lambda: process.poll() is not None) is False
        assert flight.fly(PATIENCE_S, until=lambda: flight.driven)
    stop.set()
    for end in (theirs, ours):
        os.close(end)
    link.close()
    flight.stays_up()
