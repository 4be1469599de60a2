"""Wrench demand in, eight motor commands out: how soon, how many lost, how many late.

    python research/live_latency.py [--cycles 24000] [--rate 400] [--memory 100000] [--hostile]

First `coaxlink mix` in a process of its own, through UDP in real time: the round trip that a client sees, in
blocks that alternate with a bare echo in Python. Then the same session and loop in memory, on a virtual clock
as fast as they go: what the processor needs for a demand, books and parsing included; `--hostile` puts a
damaged or nasty frame before each demand. Nothing out of 0..1 may leave, and no good demand stay unanswered.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import multiprocessing
import os
import random
import socket
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as m

from coaxlink.live.guard import timing_for
from coaxlink.live.mixer import LiveMixer
from coaxlink.mavlink import codec
from coaxlink.mavlink.clock import VirtualClock
from coaxlink.mavlink.session import Session
from coaxlink.studies.simulator import free_port
from coaxlink.tables.px4 import px4_table
from coaxlink.vehicle import load_vehicle
from firmware_params import px4

AIRFRAME = Path(__file__).parents[1] / "examples" / "x8_paper.toml"
ON_BOARD = {"THR_MDL_FAC": 1.0, "SYS_CTRL_ALLOC": 1}
ON_BOARD |= px4.table_to_params(px4_table(load_vehicle(AIRFRAME), "standard"))
LATE_S, BLOCKS = 0.02, 4
DEMAND, ANSWER = codec.ACTUATOR_CONTROL_TARGET, codec.SET_ACTUATOR_CONTROL_TARGET
BEAT = m.MAVLink_heartbeat_message(14, 12, 81 | m.MAV_MODE_FLAG_SAFETY_ARMED, 0, 3, 3)


def demand(stamp: int, number: int) -> bytes:
    controls = (0.02 * math.sin(number / 20), -0.01, 0.02, 0.3, 0.0, 0.0, 0.0, 0.0)
    return DEMAND.pack(number % 256, 1, 1, stamp, *controls, 0)


def parameter(name: str) -> m.MAVLink_param_value_message:
    value, kind = ON_BOARD[name], m.MAV_PARAM_TYPE_REAL32
    if isinstance(value, int):  # its bits in a float, as PX4 does
        value, kind = struct.unpack("<f", struct.pack("<i", value))[0], m.MAV_PARAM_TYPE_INT32
    names = list(ON_BOARD)
    return m.MAVLink_param_value_message(name.encode(), value, kind, len(names), names.index(name))


def autopilot(message: Any) -> list[Any]:
    """As much of one as `mix` asks for: version, parameters, the stream."""
    kind, none = message.get_type(), [0] * 8
    if kind == "PARAM_REQUEST_LIST":
        return [parameter(name) for name in ON_BOARD]
    if kind == "PARAM_REQUEST_READ":
        name = list(ON_BOARD)[message.param_index] if message.param_index >= 0 else message.param_id
        return [parameter(name)] if name in ON_BOARD else []
    if kind != "COMMAND_LONG":
        return []
    reported = [m.MAVLink_command_ack_message(message.command, 0, 0, 0, 245, 191)]
    if message.command == m.MAV_CMD_REQUEST_MESSAGE:
        reported.append(
            m.MAVLink_autopilot_version_message(0, 0x010D03FF, 0, 0, 0, none, none, none, 0, 0, 0)
        )
    return reported


# -- in real time --------------------------------------------------------------------------------------------


def echo(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", port))
        while True:
            data, peer = line.recvfrom(2048)
            line.sendto(ANSWER.pack(0, 1, 1, DEMAND.unpack(data[10:-2])[0], *[0.0] * 8, 0, 1, 1), peer)


def meet(line: socket.socket, verb: subprocess.Popen[str]) -> None:
    """Until `mix` has asked for the demand, and a heartbeat a second from then on."""
    mav, asked = m.MAVLink(None, 1, 1), False
    line.settimeout(0.01)
    while not asked:
        if verb.poll() is not None:
            sys.exit(f"mix ended with {verb.returncode}")
        with contextlib.suppress(OSError):
            line.send(BEAT.pack(mav))
            for message in mav.parse_buffer(line.recv(2048)) or []:
                for reported in autopilot(message):
                    line.send(reported.pack(mav))
                asked = asked or (message.get_type() == "COMMAND_LONG" and message.param1 == DEMAND.number)

    def beat() -> None:
        while line.fileno() >= 0:
            with contextlib.suppress(OSError):
                line.send(BEAT.pack(mav))
            time.sleep(1.0)

    threading.Thread(target=beat, daemon=True).start()


def round_trips(line: socket.socket, rate_hz: float, cycles: int) -> np.ndarray:
    """Seconds (cycles,); infinite for no answer within a second, counted late above LATE_S."""
    line.settimeout(LATE_S)
    took, pending = np.full(cycles, np.inf), {}
    due = time.monotonic()
    for k in range(cycles):
        due = max(due + 1.0 / rate_hz, time.monotonic() - 0.01)
        time.sleep(max(due - time.monotonic(), 0.0))
        sent = time.monotonic()
        pending[stamp := round(sent * 1e6)] = (k, sent)
        line.send(demand(stamp, k))
        while stamp in pending:
            try:
                data = line.recv(2048)
            except TimeoutError:
                break
            if data[7] == ANSWER.number and (found := pending.pop(ANSWER.unpack(data[10:-2])[0], None)):
                took[found[0]] = time.monotonic() - found[1]
    return took


def determined(name: str, took: np.ndarray) -> None:
    us = 1e6 * took[np.isfinite(took)]
    figures = zip(("p50", "p99", "p99.9", "largest"), np.percentile(us, [50, 99, 99.9, 100]), strict=True)
    late = f"later than 20 ms {int((us > 1e6 * LATE_S).sum())} of {len(took)}"
    print(f"{name:12s}", ", ".join(f"{what} {value:.0f} us" for what, value in figures), end="; ")
    print(f"lost {len(took) - len(us)}, {late}; load {os.getloadavg()[0]:.1f}", flush=True)


def real_time(cycles: int, rate_hz: float, law: str) -> None:
    port, echo_port = free_port(), free_port()
    lines = {name: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for name in ("echo", "mix")}
    lines["echo"].connect(("127.0.0.1", echo_port))
    lines["mix"].bind(("127.0.0.1", 0))
    lines["mix"].connect(("127.0.0.1", port))
    words = ["mix", str(AIRFRAME), "--law", law, "--no-witness", "--rate", str(rate_hz)]
    command = [sys.executable, "-m", "coaxlink", *words, "--connect", f"udpin:127.0.0.1:{port}"]
    echoing = multiprocessing.Process(target=echo, args=(echo_port,), daemon=True)
    verb = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    meet(lines["mix"], verb)
    echoing.start()
    times: dict[str, list[np.ndarray]] = {"echo": [], "mix": []}
    round_trips(lines["mix"], rate_hz, round(rate_hz))  # until the law has faded in
    for _ in range(BLOCKS):
        for name, blocks in times.items():
            blocks.append(round_trips(lines[name], rate_hz, cycles // BLOCKS))
            round_trips(lines["mix"], rate_hz, 40)  # it settles again after a silence
    status = Path(f"/proc/{verb.pid}/status").read_text()
    verb.terminate()  # a shell that runs this in its background has Ctrl-C ignored
    print(verb.communicate()[0].strip(), status[status.index("VmRSS") :].splitlines()[0], sep="\n")
    echoing.terminate()
    for name, blocks in times.items():
        determined(f"{name} {rate_hz:g} Hz", np.concatenate(blocks))


# -- in memory -----------------------------------------------------------------------------------------------


class Line:
    """A `Driven` transport: the vehicle's end in the same process."""

    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        self.answers: dict[int, tuple[float, ...]] = {}
        self._mav = m.MAVLink(None, 1, 1)

    def drive(self, turn: Any) -> None:
        self.turn = turn
        self.say(BEAT)

    def say(self, *messages: Any) -> None:
        self.waiting += [bytes(message.pack(self._mav)) for message in messages]

    def read(self, timeout_s: float) -> tuple[bytes, Any]:
        return (self.waiting.pop(0) if self.waiting else b""), None

    def write(self, data: bytes, peer: Any = None) -> None:
        if data[7] == ANSWER.number:
            stamp, *commands = ANSWER.unpack(data[10:-2])[:9]
            self.answers[stamp] = tuple(commands)
        else:
            self.say(
                *(
                    reported
                    for message in self._mav.parse_buffer(data) or []
                    for reported in autopilot(message)
                )
            )

    def close(self) -> None:
        pass


def hostile(stamp: int, number: int, rng: random.Random) -> bytes:
    """A demand damaged on its way, or whole with what is no number in it."""
    if rng.random() < 0.5:
        data = bytearray(demand(stamp, number))
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data[: rng.choice([len(data), rng.randrange(len(data))])])
    nasty = [math.nan, math.inf, -math.inf, 3e38, 1.6, -1.6]
    return DEMAND.pack(0, 1, 1, stamp, *rng.choices(nasty, k=8), rng.choice([0, 0, 1, 255]))


def in_memory(cycles: int, rate_hz: float, law: str, nasty: bool) -> None:
    clock, line, rng = VirtualClock(), Line(), random.Random(1)

    def look_about() -> None:
        if line.turn(0.0):
            clock.later(0.05, look_about)

    clock.later(0.0, look_about)
    session = Session(line, "memory", clock=clock)
    session.start(3.0)
    vehicle = load_vehicle(AIRFRAME, None)
    timing = replace(timing_for(rate_hz), sync_s=0.0)  # no autopilot here that would answer TIMESYNC
    live = LiveMixer(session, vehicle, law, rate_hz=rate_hz, witness=False, timing=timing)
    live.start()
    took, lost, outside = np.empty(cycles), 0, 0
    settling = round(rate_hz)
    for k in range(-settling, cycles):
        clock.sleep(1.0 / rate_hz)
        stamp = round(clock.now * 1e6)
        if k % round(rate_hz) == 0:
            line.say(BEAT)
        # each in a turn of its own: of several that wait only the newest counts
        if nasty:
            line.waiting.append(hostile(stamp - 1000, k, rng))
            line.turn(0.0)
        line.waiting.append(demand(stamp, k))
        began = time.perf_counter()
        line.turn(0.0)
        if k >= 0:
            took[k] = time.perf_counter() - began
            lost += stamp not in line.answers
        outside += sum(not 0.0 <= u <= 1.0 for u in line.answers.pop(stamp, ()))
        line.answers.clear()
    determined("in memory", took)
    summary = live.summary()
    print(f"lost {lost}, out of 0..1 {outside}, unanswered {summary['unanswered']}")
    if outside or live.error or (lost and not nasty):
        sys.exit(f"the loop failed: {live.error}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--cycles", type=int, default=24_000, help="in real time, of each")
    parser.add_argument("--memory", type=int, default=100_000, help="cycles in memory")
    parser.add_argument("--rate", type=float, default=400.0)
    parser.add_argument("--law", default="exact")
    parser.add_argument("--hostile", action="store_true")
    parser.add_argument("--small", action="store_true", help="a second of each")
    o = parser.parse_args()
    o.cycles, o.memory = (400, 2000) if o.small else (o.cycles, o.memory)
    if o.cycles:
        real_time(o.cycles, o.rate, o.law)
    if o.memory:
        in_memory(o.memory, o.rate, o.law, o.hostile)


if __name__ == "__main__":
    main()
