"""Wrench in, eight outputs out: `coaxlink mix` on loopback UDP beside a C echo server, in the same run.

    python research/live_latency.py [--law exact] [--way compiled|plain] [--cycles 8000] [--blocks 4]
    python research/live_latency.py --endure 1000000 --rates 1000
    python research/live_latency.py --telemetry [--reallocate]

Blocks of the two alternate, so that a machine with other things to do slows both. The client (C too) paces
the demands and times the answers. Prints p50 and p99 of each, their ratio, the time from start to the first
heartbeat of `mix`, and its resident memory. `--telemetry`: an armed vehicle in the air tells its inertial
readings at 50 Hz, so that the rotors' health is judged beside the loop.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as m

from coaxlink.studies.simulator import free_port

HERE = Path(__file__).parent
AIRFRAME = HERE.parent / "examples" / "x8_paper.toml"


def build(folder: Path) -> Path:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        sys.exit("a C compiler is needed for the echo server")
    binary = folder / "live_latency"
    subprocess.run([compiler, "-O2", "-o", str(binary), str(HERE / "live_latency.c")], check=True)
    return binary


def measure(binary: Path, sock: socket.socket, rate: float, cycles: int, warm: int) -> tuple[np.ndarray, int]:
    command = [str(binary), "client", str(sock.fileno()), str(rate), str(cycles), str(warm)]
    done = subprocess.run(command, pass_fds=[sock.fileno()], stdout=subprocess.PIPE, check=True)
    *times, late = np.frombuffer(done.stdout, "<i8").tolist()
    return np.array(times) / 1e3, late


class Mixing:
    """`coaxlink mix` and as much of an autopilot as it asks for."""

    def __init__(self, law: str, extra: list[str], telemetry: bool = False) -> None:
        port = free_port()
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.connect(("127.0.0.1", port))
        self.sock.settimeout(0.002)
        self._mav = m.MAVLink(None, 1, 1)
        started = time.monotonic()
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "coaxlink",
                "mix",
                str(AIRFRAME),
                "--law",
                law,
                "--no-witness",
                "--connect",
                f"udpin:127.0.0.1:{port}",
                "--rate",
                "1000",
                *extra,
            ],
            stdout=subprocess.DEVNULL,
        )
        self._shake_hands()
        self.ready_s = time.monotonic() - started
        self._stop = threading.Event()
        self._beat = threading.Thread(target=self._beats, daemon=True)
        self._beat.start()
        self._telling = threading.Thread(target=self._tell, daemon=True)
        if telemetry:
            self._telling.start()

    def _tell(self) -> None:
        """Hover as the demand's thrust has it, with an autopilot's noise; stamps are the demands' clock."""
        random, due = np.random.default_rng(0), time.monotonic()
        for k in itertools.count():
            due += 0.02
            if self._stop.wait(max(due - time.monotonic(), 0.0)):
                return
            stamp, (x, y, z, p, q, r) = time.monotonic_ns() // 1000, random.standard_normal(6).tolist()
            force, turn = (0.05 * x, 0.05 * y, 0.05 * z - 7.2), (1e-3 * p, 1e-3 * q, 1e-3 * r)
            self._send(m.MAVLink_highres_imu_message(stamp, *force, *turn, *[0.0] * 7, 0x3F, 0))
            if k % 50 == 0:
                self._send(m.MAVLink_extended_sys_state_message(0, m.MAV_LANDED_STATE_IN_AIR))

    def _send(self, message: m.MAVLink_message) -> None:
        with contextlib.suppress(ConnectionRefusedError):
            self.sock.send(message.pack(self._mav))

    def _heartbeat(self) -> None:
        self._send(m.MAVLink_heartbeat_message(14, 12, 81 | m.MAV_MODE_FLAG_SAFETY_ARMED, 0, 3, 3))

    def _shake_hands(self) -> None:
        """Until it has asked for the demand: version, THR_MDL_FAC, the stream."""
        end = time.monotonic() + 20.0
        beat = 0.0
        while time.monotonic() < end:
            if time.monotonic() > beat:
                beat = time.monotonic() + 0.01
                self._heartbeat()
            try:
                data = self.sock.recv(2048)
            except OSError:
                continue
            for message in self._mav.parse_buffer(data) or []:
                if message.get_type() == "PARAM_REQUEST_READ":
                    self._send(m.MAVLink_param_value_message(b"THR_MDL_FAC", 1.0, 9, 1, 0))
                if message.get_type() != "COMMAND_LONG":
                    continue
                self._send(m.MAVLink_command_ack_message(message.command, 0, 0, 0, 245, 191))
                if message.command == 512:
                    number = 1 << 24 | 13 << 16 | 3 << 8 | 255
                    none = [0] * 8
                    self._send(
                        m.MAVLink_autopilot_version_message(0, number, 0, 0, 0, none, none, none, 0, 0, 0)
                    )
                if message.command == 511 and round(message.param1) == 140:
                    return
        sys.exit("coaxlink mix did not ask for the demand")

    def _beats(self) -> None:
        while not self._stop.wait(1.0):
            self._heartbeat()

    def memory_mb(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024

    def close(self) -> None:
        self._stop.set()
        self.process.terminate()
        self.process.wait()
        self.sock.close()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--law", default="exact")
    parser.add_argument("--way", choices=["compiled", "plain"], help="default: what mix itself takes")
    parser.add_argument("--telemetry", action="store_true", help="inertial readings at 50 Hz, in the air")
    parser.add_argument("--reallocate", action="store_true", help="mix --reallocate")
    parser.add_argument("--endure", type=int, default=0, help="only mix, so many cycles; memory, none lost")
    parser.add_argument("--cycles", type=int, default=4000)
    parser.add_argument("--blocks", type=int, default=3)
    parser.add_argument("--rates", type=float, nargs="+", default=[400.0, 1000.0])
    o = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        binary = build(Path(folder))
        port = free_port()
        server = subprocess.Popen([str(binary), "echo", str(port)])
        echo = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        echo.connect(("127.0.0.1", port))
        extra = [f"--{o.way}"] * bool(o.way) + ["--reallocate"] * o.reallocate
        mixing = Mixing(o.law, extra, o.telemetry)
        try:
            if o.endure:
                endure(binary, mixing, o.rates[-1], o.endure)
            else:
                run(binary, echo, mixing, o)
        finally:
            mixing.close()
            server.kill()
            server.wait()
            echo.close()


def endure(binary: Path, mixing: Mixing, rate: float, cycles: int) -> None:
    """So many cycles in ten pieces: what is lost, and what the memory does."""
    lost = late = done = 0
    for _ in range(10):
        times, behind = measure(binary, mixing.sock, rate, cycles // 10, 0 if done else round(0.6 * rate))
        lost, late, done = lost + int((times < 0).sum()) - behind, late + behind, done + len(times)
        p50, p99 = np.percentile(times[times >= 0], [50, 99])
        print(
            f"{done:8d} cycles at {rate:g} Hz: lost {lost}, later than 20 ms {late}, "
            f"p50 {p50:.1f} us p99 {p99:.1f} us, resident {mixing.memory_mb():.2f} MB",
            flush=True,
        )


def run(binary: Path, echo: socket.socket, mixing: Mixing, o: argparse.Namespace) -> None:
    cycles = o.cycles // o.blocks
    memory = 0.0
    for rate in o.rates:
        times: dict[str, list[np.ndarray]] = {"C echo": [], "coaxlink": []}
        behind = {"C echo": 0, "coaxlink": 0}
        for _ in range(o.blocks):
            for name, sock, warm in (("C echo", echo, 50), ("coaxlink", mixing.sock, round(0.6 * rate))):
                block, late = measure(binary, sock, rate, cycles, warm)
                times[name].append(block)
                behind[name] += late
            memory = memory or mixing.memory_mb()
        rows = {}
        for name, blocks in times.items():
            all_us = np.concatenate(blocks)
            late = behind[name]
            lost = int((all_us < 0).sum()) - late
            p50, p99 = np.percentile(all_us[all_us >= 0], [50, 99])
            rows[name] = (p50, p99)
            shown = (
                f"p50 {p50:6.1f} us  p99 {p99:6.1f} us  later than 20 ms {late}, lost {lost} of {len(all_us)}"
            )
            print(f"{rate:6.0f} Hz  {name:9s} {shown}")
        ratio = [a / b for a, b in zip(rows["coaxlink"], rows["C echo"], strict=True)]
        print(f"{rate:6.0f} Hz  {o.law} / C echo: p50 {ratio[0]:.2f}, p99 {ratio[1]:.2f}")
    print(
        f"ready after {mixing.ready_s:.2f} s, resident {memory:.0f} MB, after all {mixing.memory_mb():.0f} MB"
    )


if __name__ == "__main__":
    main()
