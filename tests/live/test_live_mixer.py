"""The live loop: every demand gets one bounded answer or none, and only from an autopilot that takes it."""

from __future__ import annotations

import itertools
import math
import random
import struct
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live_line import CRM, HOVER, RIVAL, X8, Session, mixer_on
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.mixer_core import MixCore
from coaxlink.live.paths import require_path
from coaxlink.vehicle import Vehicle

SIGNATURE = b"signed"


def test_each_demand_is_answered_once_and_with_its_stamp() -> None:
    session = Session()
    with mixer_on(session) as mixer:
        assert session.requests[0] == (140, 250.0)
        for k in range(20):
            session.demand(4000 * (k + 1))
        session.demand(4000 * 20)
    answered = len(session.sent)
    session.demand(999_999)  # after stop: silence
    assert len(session.sent) == answered
    assert [m.time_usec for m in session.sent[:20]] == [4000 * (k + 1) for k in range(20)]
    assert all(m.get_type() == "SET_ACTUATOR_CONTROL_TARGET" and m.group_mlx == 0 for m in session.sent)
    assert all((m.target_system, m.target_component) == (1, 1) for m in session.sent)
    summary = mixer.summary()
    assert summary["cycles"] == 20 and summary["unanswered"]["late"] == 1
    assert max(summary["allocation_error"]["max"]) < 1e-6


def test_what_goes_out_is_what_the_law_says() -> None:
    session, c = Session(), MixCore(Vehicle(X8, CRM), "coaxial")
    mixer_on(session)
    for stamp, controls in ((1000, HOVER), (2000, [0.02, -0.03, 0.05, 0.35, 0, 0, 0, 0])):
        (message,) = session.demand(stamp, controls)
        float32 = np.array(controls, np.float32).astype(float).tolist()
        assert list(message.controls) == pytest.approx(c.step(stamp, 0, float32), abs=1e-6)


def test_a_dry_run_computes_and_sends_nothing() -> None:
    session = Session()
    with mixer_on(session, dry_run=True) as mixer:
        for k in range(20):
            session.demand(4000 * (k + 1))
    assert session.sent == []
    assert mixer.summary()["cycles"] == 20 and max(mixer.core.sent) > 0.3


def test_it_takes_over_from_the_autopilots_own_mixer_without_a_step() -> None:
    session = Session()
    mixer_on(session, timing=Timing(settle=4, fade_s=1e9, sync_s=0.0))
    for k in range(8):
        session.demand(4000 * (k + 1), [0.05, 0.0, 0.1, 0.4, 0, 0, 0, 0])
    assert [m.time_usec for m in session.sent] == [4000 * k for k in range(4, 9)]
    # setpoints of the geometry mixer: thrust 0.4 on all, roll +-, yaw by spin, each entry +-1 of the axis
    first = np.array(session.sent[0].controls)
    assert first.mean() == pytest.approx(0.4, abs=1e-6)
    assert np.unique(np.abs(first - 0.4).round(4)).size == 2  # |0.05 e + 0.1| and |0.05 e - 0.1|


def test_of_demands_that_wait_only_the_newest_is_answered() -> None:
    session = Session()
    mixer = mixer_on(session)
    frames = [
        session.frame(mavlink.MAVLink_actuator_control_target_message(1000 * k, 0, HOVER))
        for k in range(1, 30)
    ]
    session.tap.take([b"".join(frames[:20]), *frames[20:]])
    assert [m.time_usec for m in session.sent] == [29_000]
    assert mixer.summary()["unanswered"]["superseded"] == 28


def test_a_frame_that_only_begins_does_not_hold_up_the_demand_behind_it() -> None:
    session = Session()
    mixer_on(session)
    session.tap.take([b"\xfd\xff\x00"])
    assert session.demand(1000)


def test_a_demand_of_someone_else_is_not_answered() -> None:
    session = Session()
    mixer = mixer_on(session)
    assert not session.demand(1000, component=50) and not session.demand(1000, system=9)
    assert mixer.summary()["unanswered"]["foreign"] == 2


def test_on_a_signed_line_only_what_is_signed_is_believed() -> None:
    session = Session()
    mixer, session.signed_with = mixer_on(session), SIGNATURE
    assert not session.demand(1000)
    session.hear(RIVAL, 246, 191)
    assert mixer.summary()["unanswered"]["foreign"] == 1 and not mixer.failed.is_set()
    session.signed_with = b""
    assert session.demand(1000)


def test_another_companions_commands_on_the_line_end_it() -> None:
    session = Session()
    mixer = mixer_on(session)
    (ours,) = session.demand(1000)
    session.hear(ours, 245, 191)  # our own words, handed back by a router
    asking = mavlink.MAVLink_set_actuator_control_target_message(0, 255, 1, 1, [0.0] * 8)
    session.hear(asking, 246, 191)  # asks ArduPilot's bridge for the demand, commands nothing
    assert not mixer.failed.is_set()
    session.hear(RIVAL, 246, 191)
    assert not session.demand(2000)
    assert isinstance(mixer.error, SafetyRefusal) and "another companion" in str(mixer.error)


def test_a_failing_law_falls_silent_instead_of_failing_at_every_demand() -> None:
    def broken(wrench: object) -> None:
        raise RuntimeError("no")

    session = Session()
    mixer = mixer_on(session, SimpleNamespace(name="broken", speeds=broken, dropped=()))
    assert not session.demand(1000) and not session.demand(2000)
    assert mixer.failed.is_set() and str(mixer.error) == "no"
    assert mixer.summary()["unanswered"]["failures"] == 1


@pytest.mark.parametrize(
    ("autopilot", "version", "says"),
    [
        (mavlink.MAV_AUTOPILOT_PX4, (1, 16, 1), r"PX4 1\.16\.1 ignores"),
        (mavlink.MAV_AUTOPILOT_PX4, (1, 14, 0), r"PX4 1\.14\.0 ignores"),
        (mavlink.MAV_AUTOPILOT_PX4, None, "unknown version"),
        (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, (4, 5, 0), "Lua"),
        (mavlink.MAV_AUTOPILOT_GENERIC, (1, 0, 0), "no way is known"),
    ],
)
def test_an_autopilot_that_ignores_the_stream_is_refused_with_the_reason(
    autopilot: int, version: tuple[int, ...] | None, says: str
) -> None:
    session = Session(version, autopilot)
    with pytest.raises(SafetyRefusal, match=says):
        mixer_on(session)
    assert session.tap is None and 140 not in [number for number, _ in session.requests]


def test_an_autopilot_that_will_not_send_its_demand_is_refused_and_left_alone() -> None:
    session = Session(takes_requests=False)
    with pytest.raises(SafetyRefusal, match="will not send"):
        mixer_on(session)
    assert session.tap is None and session.listeners == []


def test_older_px4_is_accepted() -> None:
    for version in ((1, 13, 3), (1, 13), (1, 12, 3)):
        require_path(mavlink.MAV_AUTOPILOT_PX4, version)


# -- hostile bytes -------------------------------------------------------------------------------------------

NASTY = [math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, -0.0, 0.0, 1.0, -1.0, 1.5, -1.5, 1.50001, 2.0]


def hostile(rng: random.Random) -> Iterator[bytes]:
    """Frames without end: good ones, nasty ones, damaged ones, noise, pieces and heaps of them."""
    packer = mavlink.MAVLink(None, 1, 1)
    left = b""
    for now in itertools.count(1_001_000, 1000):
        kind = rng.random()
        stamp = now - rng.choice([0, 0, 0, 1000, 1001, 8000])
        controls = [rng.uniform(-0.3, 0.3) for _ in range(3)] + [rng.uniform(0, 1)] + [0.0] * 4
        group, when = 0, stamp
        if kind < 0.35:
            for _ in range(rng.randint(1, 8)):
                controls[rng.randrange(8)] = rng.choice([*NASTY, rng.uniform(-2, 2)])
        elif kind < 0.40:
            when = rng.choice([0, 1, 2**63, 2**64 - 1, rng.getrandbits(64)])
        elif kind < 0.43:
            group = rng.randrange(256)
        elif kind < 0.46:  # any bits at all in the float fields
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


class Judge(Session):
    """Looks at every byte it is given to send."""

    def send_frame(self, pack: Any, seed: bytes) -> None:
        super().send_frame(pack, seed)
        message = self.sent[-1]
        assert message.get_type() == "SET_ACTUATOR_CONTROL_TARGET" and len(message.controls) == 8
        assert all(0.0 <= u <= 1.0 for u in message.controls), message  # false for NaN too


@pytest.mark.slow
def test_nothing_out_of_bounds_leaves_whatever_comes_in() -> None:
    for law, frames in (("exact", 1000), ("reduced", 1000)):
        session = Judge()
        session.booted_s = session.clock.now - 1.0
        # without its witness, which would rightly give up soon
        mixer = LiveMixer(session, Vehicle(X8, CRM), law, witness=False, timing=Timing(settle=1, fade_s=0.02))  # type: ignore[arg-type]
        mixer.start()
        for _, data in zip(range(frames), hostile(random.Random(7)), strict=False):
            session.clock.sleep(0.001)
            mixer.take([data])
        unanswered = mixer.summary()["unanswered"]
        assert len(session.sent) > frames / 10 and unanswered["failures"] == 0
        for reason in ("not_finite", "absurd", "late", "foreign", "other_group", "superseded"):
            assert unanswered[reason] > 0, reason
