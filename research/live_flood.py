"""What a flood on its port does to the answers of `coaxlink mix`.

    python research/live_flood.py [--way compiled|plain] [--rate 20000] [--cycles 1000]

Demands at 250 Hz as in live_latency.py, alone and under each flood; prints the share answered, how many of
them within 20 ms, and p50 and p99 of those.
"""

from __future__ import annotations

import argparse
import random
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from live_latency import Mixing, build, measure
from pymavlink.dialects.v20 import common as m

DEMANDS_HZ = 250.0
BEFORE_S = 1.0  # of flood before the first demand


def junk() -> list[bytes]:
    draw = random.Random(7)
    return [draw.randbytes(draw.randint(8, 60)) for _ in range(500)]


def heartbeats(system: int | None) -> list[bytes]:
    """Of that system, or of many others."""
    frames = []
    for n in range(200):
        packer = m.MAVLink(None, 2 + n if system is None else system, 1)
        packer.seq = n
        frames.append(bytes(m.MAVLink_heartbeat_message(14, 12, 81, 0, 3, 3).pack(packer)))
    return frames


def demands() -> list[bytes]:
    """Forged: full thrust."""
    full = m.MAVLink_actuator_control_target_message(2**40, 0, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    return [bytes(full.pack(m.MAVLink(None, 1, 1)))]


FLOODS = {
    "nothing": ("", []),
    "junk": ("stranger", junk()),
    "heartbeats of other ids": ("stranger", heartbeats(None)),
    "heartbeats of the vehicle's ids": ("stranger", heartbeats(1)),
    "demands of the vehicle's ids": ("stranger", demands()),
    "junk by the vehicle's own address": ("vehicle", junk()),
    "heartbeats of other ids by its address": ("vehicle", heartbeats(None)),
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--way", choices=["compiled", "plain"], default="compiled")
    parser.add_argument("--rate", type=float, default=20000.0)
    parser.add_argument("--cycles", type=int, default=1000)
    parser.add_argument("--only", default="", help="floods whose name has this in it")
    o = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        binary = build(Path(folder))
        mixing = Mixing("exact", [f"--{o.way}"])
        try:
            print(f"{o.way}, {o.rate:g} datagrams a second:")
            for name, (who, datagrams) in FLOODS.items():
                if o.only in name:
                    once(binary, mixing, name, who, datagrams, o)
        finally:
            mixing.close()


def once(
    binary: Path, mixing: Mixing, name: str, who: str, datagrams: list[bytes], o: argparse.Namespace
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(mixing.sock.getpeername())
        source = mixing.sock if who == "vehicle" else stranger
        flood = None
        if datagrams:
            command = [str(binary), "flood", str(source.fileno()), str(o.rate)]
            flood = subprocess.Popen(
                command, pass_fds=[source.fileno()], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            assert flood.stdin is not None
            flood.stdin.write(b"".join(len(d).to_bytes(2, "little") + d for d in datagrams))
            flood.stdin.close()
            time.sleep(BEFORE_S)
        times, late = measure(binary, mixing.sock, DEMANDS_HZ, o.cycles, 0 if flood else 150)
        sent = ""
        if flood is not None:
            flood.terminate()
            assert flood.stdout is not None
            sent = f"({flood.stdout.read().decode().strip()} a second sent)"
            flood.wait()
        time.sleep(BEFORE_S)  # its heartbeat comes through again
        answered = times[times >= 0]
        p50, p99 = np.percentile(answered, [50, 99]) if len(answered) else (float("nan"),) * 2
        shares = [100 * n / len(times) for n in (len(answered) + late, len(answered))]
        print(
            f"{name:40s} answered {shares[0]:5.1f} %, within 20 ms {shares[1]:5.1f} %, "
            f"p50 {p50:6.0f} us, p99 {p99:6.0f} us   {sent}",
            flush=True,
        )
        if mixing.process.poll() is not None:
            sys.exit(f"coaxlink mix ended with code {mixing.process.returncode}")


if __name__ == "__main__":
    main()
