"""Hostile bytes at the live loop: whatever comes, what goes out is eight finite commands in 0..1, or nothing.

research/live_fuzz.py runs the same generator for a million frames.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
NASTY = [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -0.0, 0.0, 1.0, -1.0, 1.5, -1.5, 1.50001, 2.0]


def hostile(rng: random.Random) -> Iterator[bytes]:
    """Frames without end: good ones, nasty ones, damaged ones, noise, pieces and heaps of them."""
    packer = mavlink.MAVLink(None, 1, 1)
    stamp = 1_000_000
    left = b""
    while True:
        kind = rng.random()
        stamp += rng.choice([4000, 4000, 4000, 1, 0, -8000])
        controls = [rng.uniform(-0.3, 0.3) for _ in range(3)] + [rng.uniform(0, 1)] + [0.0] * 4
        group, when = 0, stamp
        if kind < 0.35:
            for _ in range(rng.randint(1, 8)):
                controls[rng.randrange(8)] = rng.choice([*NASTY, rng.uniform(-2, 2)])
        if 0.35 <= kind < 0.40:
            when = rng.choice([0, 1, 2**63, 2**64 - 1, rng.getrandbits(64)])
        if 0.40 <= kind < 0.43:
            group = rng.randrange(256)
        if 0.43 <= kind < 0.46:  # any bits at all in the float fields
            controls = list(struct.unpack("<8f", rng.randbytes(32)))
        message = mavlink.MAVLink_actuator_control_target_message(max(when, 0), group, controls)
        packer.srcSystem, packer.srcComponent = rng.choice([(1, 1)] * 9 + [(1, 2), (0, 0), (255, 190)])
        packer.seq = rng.randrange(256)
        data = bytes(message.pack(packer, force_mavlink1=rng.random() < 0.05))
        if 0.46 <= kind < 0.56:
            corrupted = bytearray(data)
            for _ in range(rng.randint(1, 4)):
                corrupted[rng.randrange(len(corrupted))] = rng.randrange(256)
            data = bytes(corrupted)
        elif 0.56 <= kind < 0.60:
            data = rng.randbytes(rng.randint(0, 120))
        elif 0.60 <= kind < 0.64:
            cut = rng.randrange(len(data))
            data, left = left + data[:cut], data[cut:]
        elif 0.64 <= kind < 0.67:
            outputs = [rng.choice([*NASTY, 1500.0]) for _ in range(32)]
            other = mavlink.MAVLink_actuator_output_status_message(max(stamp, 0), 8, outputs)
            data = bytes(other.pack(packer)) + data
        elif 0.67 <= kind < 0.70:
            data = data * rng.randint(2, 6)
        yield data


class Sink:
    """A session that judges every byte it is given to send."""

    fileno = -1
    signed = False
    armed = True
    bound = SimpleNamespace(strangers=SimpleNamespace(datagrams=0))

    def __init__(self) -> None:
        self.identity = SimpleNamespace(
            system=1, component=1, autopilot=mavlink.MAV_AUTOPILOT_PX4, version=(1, 13, 3)
        )
        self.tap: Any = None
        self.sent = 0
        self._parser = mavlink.MAVLink(None)

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        return True

    def subscribe(self, callback: Any) -> Any:
        return lambda: None

    def send(self, message: Any) -> None:
        assert message.get_type() == "TIMESYNC"

    def latest(self, name: str) -> Any:
        return SimpleNamespace(landed_state=2)

    def send_frame(self, pack: Any, seed: bytes) -> None:
        frame = pack(self.sent % 256, 245, 191)
        (message,) = self._parser.parse_buffer(frame)
        assert message.get_type() == "SET_ACTUATOR_CONTROL_TARGET"
        assert len(message.controls) == 8
        assert all(0.0 <= u <= 1.0 for u in message.controls), message  # false for NaN too
        self.sent += 1


def run(law: str, frames: int, seed: int) -> tuple[LiveMixer, Sink]:
    """Throw `frames` at a live mixer of its own (without its witness, which would rightly give up soon)."""
    sink = Sink()
    timing = Timing(settle=1, fade_s=0.02)
    mixer = LiveMixer(sink, Vehicle(X8, CRM), law, timing=timing, witness=False)  # type: ignore[arg-type]
    mixer.start()
    for _, data in zip(range(frames), hostile(random.Random(seed)), strict=False):
        mixer.take(data)
    return mixer, sink


def test_nothing_out_of_bounds_leaves_whatever_comes_in() -> None:
    for law, frames in (("exact", 1000), ("reduced", 2000), ("coaxial", 200)):
        mixer, sink = run(law, frames, seed=7)
        unanswered = mixer.summary()["unanswered"]
        assert sink.sent > frames / 10
        assert unanswered["failures"] == 0
        for reason in ("not_finite", "absurd", "late", "foreign", "other_group", "superseded"):
            assert unanswered[reason] > 0, reason


def test_the_memory_of_the_loop_does_not_grow() -> None:
    mixer, _ = run("reduced", 200, seed=3)
    bins = len(mixer.core.counters.latency.bins)
    for k in range(5000):
        mixer.core.counters.latency.add(1e-5 * (1 + k % 997))
    assert len(mixer.core.counters.latency.bins) == bins
    assert len(mixer._echoes) <= 64


def test_the_histogram_tells_percentiles_within_its_bins() -> None:
    from coaxlink.live.counts import Histogram

    h = Histogram()
    times = [1e-6 * (50 + k) for k in range(1000)]
    for t in random.Random(1).sample(times, len(times)):
        h.add(t)
    assert abs(h.percentile(50) / 549.5e-6 - 1) < 0.05
    assert abs(h.percentile(99) / 1039e-6 - 1) < 0.05
    assert h.percentile(100) <= h.largest_s == max(times)
