"""A million hostile frames at the live loop: commands that left their range (must be none), and memory.

python research/live_fuzz.py [--frames 1000000] [--law exact] [--compiled]

With --compiled the frames come over a real socket and the compiled loop (exact law) meets them first.
"""

from __future__ import annotations

import argparse
import random
import socket
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "helpers"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "live"))

from pymavlink.dialects.v20 import common as mavlink
from test_live_fuzz import CRM, X8, Sink, hostile  # type: ignore[import-not-found]

from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.mixer import make_law
from coaxlink.vehicle import Vehicle

BURST = 32  # hostile frames between two sane ones; the answer to a sane one is waited for, so none drowns


def resident_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


def drain(sock: socket.socket, parser: mavlink.MAVLink, stamp: int) -> int:
    """Judge the answers up to the one of that stamp, or until none came for a while; how many there were."""
    answers = 0
    while True:
        try:
            received = sock.recv(4096)
        except TimeoutError:
            return answers
        for message in parser.parse_buffer(received) or []:
            if message.get_type() != "SET_ACTUATOR_CONTROL_TARGET":
                continue
            answers += 1
            if not all(0.0 <= u <= 1.0 for u in message.controls):  # also for NaN
                sys.exit(f"out of bounds: {message}")
            if message.time_usec == stamp:
                return answers


def on_a_socket(frames: int, seed: int) -> None:
    """The hostile frames in datagrams to a session, good demands between them to keep the loop flying."""
    from test_live_hot import Rig, demand  # type: ignore[import-not-found]

    from coaxlink.live import compiled

    rig = Rig(compiled.load())
    rig.live.guard.timing = Timing(settle=1, fade_s=0.0, hold_after_s=5.0, ramp_after_s=10.0)
    rig.socket.settimeout(0.02)
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    answers = early = sane = 0
    stamp = 2_000_000
    began = time.monotonic()
    for n, data in zip(range(frames), hostile(random.Random(seed)), strict=False):
        if b"\x8b\x00\x00" in data:  # motor commands of another would end it, rightly
            continue
        rig.say(data)
        if n % BURST == 0:
            # a demand that is just as it should be, of any size in range; its answer says that all is read
            stamp = max(stamp, rig.live.core.last_us or 0) + 1000
            rng = random.Random(n)
            controls = [rng.uniform(-1, 1) for _ in range(3)] + [rng.random()] + [0.0] * 4
            rig.say(demand(stamp, controls))
            sane += 1
            answers += drain(rig.socket, parser, stamp)
        if n == frames // 10:
            early = resident_mb()
    time.sleep(0.5)
    summary = rig.live.summary()
    print(f"{frames} hostile frames and {sane} sane ones on a socket in {time.monotonic() - began:.0f} s:")
    print(
        f"{answers} answers, none out of 0..1; {summary['cycles']} cycles, of them by the compiled loop: ",
        end="",
    )
    print(f"{rig.hot_answers}; unanswered: {summary['unanswered']}")
    print(f"resident {early:.1f} MB after a tenth, {resident_mb():.1f} MB at the end")
    if rig.live.error:
        sys.exit(f"the loop failed: {rig.live.error}")
    rig.close()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--law", default="exact")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--compiled", action="store_true")
    o = parser.parse_args()
    if o.compiled:
        on_a_socket(o.frames, o.seed)
        return
    sink, law = Sink(), make_law(o.law, Vehicle(X8, CRM))
    mixer = LiveMixer(sink, Vehicle(X8, CRM), law, timing=Timing(settle=1, fade_s=0.02), witness=False)
    mixer.start()
    started, early = time.monotonic(), 0.0
    for k, data in zip(range(o.frames), hostile(random.Random(o.seed)), strict=False):
        mixer.take(data)
        if k == o.frames // 10:
            early = resident_mb()
    summary = mixer.summary()
    took = time.monotonic() - started
    print(f"{o.frames} frames at {o.law} in {took:.0f} s: {sink.sent} answers, none out of 0..1")
    print(f"unanswered: {summary['unanswered']}")
    print(f"resident {early:.1f} MB after a tenth, {resident_mb():.1f} MB at the end")
    if summary["unanswered"]["failures"]:
        sys.exit(f"the loop failed: {mixer.error}")


if __name__ == "__main__":
    main()
