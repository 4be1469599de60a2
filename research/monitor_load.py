"""What share of a core the monitor takes with eight vehicles on its line, each sending 50 times a second.

    python research/monitor_load.py [--vehicles 8] [--rate 50] [--seconds 20] [--size 80x24]

The monitor is a process of its own on a pseudo-terminal of that size, listening on one UDP port as a ground
station does; vehicles are bare pymavlink in this process. CPU time is the monitor's own, user and system,
from /proc. It ends with 1 when the monitor does not show its vehicle armed.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import pty
import select
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.studies.simulator import free_port


class Fleet(threading.Thread):
    """Vehicles of system ids from 1, each on a socket of its own, sending what a hover sends."""

    def __init__(self, port: int, vehicles: int, rate_hz: float) -> None:
        super().__init__(daemon=True)
        self.port, self.period = port, 1.0 / rate_hz
        self.links = [mavlink.MAVLink(None, n, 1) for n in range(1, vehicles + 1)]
        self.lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in self.links]
        self.sent = 0
        self.stopping = threading.Event()

    def run(self) -> None:
        start, tick = time.monotonic(), 0
        while not self.stopping.wait(max(start + tick * self.period - time.monotonic(), 0.0)):
            boot = round(1e3 * (time.monotonic() - start))
            for link, line in zip(self.links, self.lines, strict=True):
                messages = [
                    mavlink.MAVLink_attitude_message(boot, 0.01, 0.0, 1.0, 0.0, 0.0, 0.0),
                    mavlink.MAVLink_local_position_ned_message(boot, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0),
                    mavlink.MAVLink_servo_output_raw_message(
                        boot, 0, *[1441 + tick % 9] * 4, *[1648 - tick % 9] * 4
                    ),
                ]
                if tick % 50 == 0:
                    messages.append(mavlink.MAVLink_heartbeat_message(14, 12, 128, 3 << 16, 4, 3))
                for message in messages:
                    line.sendto(message.pack(link), ("127.0.0.1", self.port))
                    link.seq = (link.seq + 1) % 256
                    self.sent += 1
            tick += 1


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Print messages a second and the share of a core."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--size", default="80x24")
    given = parser.parse_args()
    columns, rows = map(int, given.size.split("x"))
    port = free_port()
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    command = [sys.executable, "-m", "coaxlink", "monitor", "--connect", f"udpin:127.0.0.1:{port}"]
    process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
    fleet = Fleet(port, given.vehicles, given.rate)
    fleet.start()
    written, shown = 0, b""

    def drain(seconds: float) -> None:
        nonlocal written, shown
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if select.select([master], [], [], left)[0]:
                data = os.read(master, 65536)
                written, shown = written + len(data), (shown + data)[-(1 << 20) :]

    drain(12.0)  # it starts, chooses its vehicle, asks for a table that never comes
    written, sent, before, began = 0, fleet.sent, cpu_s(process.pid), time.monotonic()
    drain(given.seconds)
    span, used = time.monotonic() - began, cpu_s(process.pid) - before
    print(
        f"{given.vehicles} vehicles, {(fleet.sent - sent) / span:.0f} messages/s, {given.size}: "
        f"{100 * used / span:.1f} % of a core, {written / span / 1000:.0f} kB/s to the terminal"
    )
    fleet.stopping.set()
    process.terminate()
    process.wait(10)
    if b"ARMED" not in shown:
        sys.exit("the monitor did not show its vehicle")


if __name__ == "__main__":
    main()
