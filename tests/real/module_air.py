"""A vehicle on the real PX4 with the module, in the air, and a line that a test may spoil to a companion."""

from __future__ import annotations

import heapq
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from losing_world import Loss
from pymavlink.dialects.v20 import common as m
from real_autopilots import AIRFRAME, PAIRS, ROOT, Px4, px4, real_time, take_off
from test_real_px4 import factory

from coaxlink.fly.commands import Commander
from coaxlink.fly.trajectory import FlightPlan, Hold, Segment
from coaxlink.live.onboard.description import board_law
from coaxlink.mavlink import connect
from coaxlink.mavlink.session import Session
from coaxlink.mixer import make_law
from coaxlink.studies.simulator import free_port
from coaxlink.vehicle import load_vehicle

VEHICLE = load_vehicle(AIRFRAME)
LAW = board_law(VEHICLE)
HERE = (0.0, 0.0, -3.0)


class Line(threading.Thread):
    """Datagrams between PX4's link and the companion; the companion's `late_s` and as `fault` spoils them."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.board_port, self.companion_port, self.port = free_port(), free_port(), free_port()
        self.late_s, self.fault, self.over = 0.0, "", False
        self.px4_port = free_port()
        self.packer = m.MAVLink(None, 245, 191)

    def run(self) -> None:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as companion,
        ):
            board.bind(("127.0.0.1", self.board_port))
            companion.bind(("127.0.0.1", self.companion_port))
            waiting: list[tuple[float, int, bytes]] = []
            count = 0
            while not self.over:
                patience = max(waiting[0][0] - time.monotonic(), 0.0) if waiting else 0.1
                for ready in select.select([board, companion], [], [], patience)[0]:
                    data = ready.recv(65536)
                    if ready is board:
                        companion.sendto(data, ("127.0.0.1", self.port))
                    elif self.fault != "line dead":
                        count += 1
                        due = time.monotonic() + self.late_s
                        heapq.heappush(waiting, (due, count, self.spoilt(data)))
                while waiting and waiting[0][0] <= time.monotonic():
                    board.sendto(heapq.heappop(waiting)[2], ("127.0.0.1", self.px4_port))

    def spoilt(self, data: bytes) -> bytes:
        """The datagram, its TUNNEL replaced."""
        if not self.fault or data[0] != 0xFD or data[7:10] != (385).to_bytes(3, "little"):
            return data
        message = m.MAVLink(None).parse_buffer(data)[0]
        body = bytearray(message.payload[: message.payload_length])
        value = {"not a number": float("nan"), "a lie": 1.0}[self.fault]
        body[16:] = struct.pack("<8f", *[value] * 8)
        self.packer.seq = message.get_seq()
        payload = list(body) + [0] * (128 - len(body))
        to = message.target_system, message.target_component
        return bytes(
            m.MAVLink_tunnel_message(*to, message.payload_type, len(body), payload).pack(self.packer)
        )


class Air:
    """A vehicle at 3 m on the module, seen by PX4's own messages, and a line to it for a companion."""

    def __init__(self, board: Px4, session: Session, folder: Path, *, module: bool = True) -> None:
        self.board, self.session, self.folder = board, session, folder
        if module:
            board.start_module(LAW.hover)
        self.line = Line()
        self.line.start()
        self.link(self.line.px4_port, self.line.board_port)
        self.vehicle: Commander = take_off(session)
        self.fly(Hold("settle", HERE, 6.0))

    def link(self, own: int, companion: int) -> None:
        """PX4 speaks from one port of loopback to another."""
        link = ("-u", str(own), "-o", str(companion), "-r", "4000000", "-m", "onboard")
        self.board.shell("mavlink", "start", "-x", *link)

    def fly(self, *plan: Segment, watch: Any = None) -> dict[str, Any]:
        """What was flown, by PX4's clock.

        A row a set-point: `segment`, `time` (s), `off` (rows, 3) from the set-point and `down` (m); `share`
        (rows, 2) of the companion (s, 0..1); `pulses` (rows, 1 + 8) s and us, and their `split`; the module's
        `facts`, the last of each.
        """
        kinds = ("DEBUG_FLOAT_ARRAY", "SERVO_OUTPUT_RAW")
        for kind in (m.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, m.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW):
            assert self.session.request_stream(kind, 250.0 if kind == 350 else 50.0)
        with self.session.listen(kinds) as heard:
            track = self.vehicle.follow(FlightPlan(plan), watch)
            share, pulses, refused = [], [], {}
            while (message := self.session.take(heard, 0.0)) is not None:
                if message.get_type() == "SERVO_OUTPUT_RAW":
                    us = [getattr(message, f"servo{n}_raw") for n in range(1, 9)]
                    pulses.append([message.time_usec / 1e6, *us])
                else:
                    share.append((message.time_usec / 1e6, message.data[10]))
                    refused[int(message.data[11])] = message.data[12]
        return {
            "segment": np.array(track.segment), "time": np.array(track.time_s),
            "off": np.array(track.flown_m) - np.array(track.wanted_m), "down": np.array(track.flown_m)[:, 2],
            "share": np.array(share), "pulses": np.array(pulses), "split": split(np.array(pulses)[:, 1:]),
            "facts": refused,
        }  # fmt: skip

    def start_mix(self, port: int, law: str, name: str) -> subprocess.Popen[str]:
        """`coaxlink mix`, listening; what it says is in `name`.log."""
        command = [sys.executable, "-m", "coaxlink", "mix", str(AIRFRAME), "--law", law]
        command += ["--connect", f"udpin:127.0.0.1:{port}", "--json", str(self.folder / f"{name}.json")]
        with (self.folder / f"{name}.log").open("a") as log:
            return subprocess.Popen(
                command, stdout=log, stderr=log, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}
            )

    @contextmanager
    def mix(self, law: str = "reduced") -> Iterator[subprocess.Popen[str]]:
        """`coaxlink mix` on the line, driving; the reduced law has another split than the module's own."""
        process = self.start_mix(self.line.port, law, "mix")
        try:
            for _ in range(20):
                if self.fly(Hold("until it drives", HERE, 1.0))["share"][-1, 1] == 1.0:
                    break
            else:
                raise AssertionError((self.folder / "mix.log").read_text())
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
            process.wait(30.0)


def tell(what: str) -> None:
    """What was measured."""
    sys.stdout.write(f"\n{what}")


def split(pulses: Any) -> float:
    """Lower over upper pulse above 1000 us, mean of the pairs."""
    on = pulses.mean(axis=0) - 1000.0
    return float(np.mean([on[low] / on[up] for up, low in PAIRS]))


def exact_split() -> float:
    """Of the exact law at the weight."""
    speeds = make_law("exact", VEHICLE).speeds([9.80665 * VEHICLE.airframe.mass_kg, 0.0, 0.0, 0.0])
    return float(np.mean([speeds[low] / speeds[up] for up, low in PAIRS]))


def rms_m(off: Any) -> float:
    """Of rows (rows, 3)."""
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@contextmanager
def flying(
    binary: Path, folder: Path, *, loss: Loss | None = None, module: bool = True, **params: float
) -> Iterator[Air]:
    """The vehicle at 3 m, at real time, by the module or PX4's own allocator."""
    (folder / "px4").mkdir()
    world = ("--airframe", str(AIRFRAME), "--speed", "1")
    with (
        real_time(),
        px4(binary, folder / "px4", *world, loss=loss) as board,
        board.boot(factory(folder / "standard") | params, cut=True) as url,
        connect(url, timeout_s=90.0) as session,
    ):
        air = Air(board, session, folder, module=module)
        yield air
        air.line.over = True
