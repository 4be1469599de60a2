"""Noise on the vehicle's own line: what nobody would use is passed over, and no demand is lost in it."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import common as mavlink1
from pymavlink.dialects.v20 import common as mavlink
from test_live_hot import BEAT, HOVER, RIVAL, Rig, demand, frame_of

from coaxlink.mavlink import codec

systems = st.integers(1, 255)


def compiled() -> Any:
    from coaxlink.live import compiled as code

    if not code.available():
        pytest.skip("the compiled loop runs on 64-bit Linux")
    return code.load()


@pytest.fixture(params=["plain", "compiled"])
def rig(request: pytest.FixtureRequest) -> Any:
    one = Rig(None if request.param == "plain" else compiled())
    yield one
    one.close()


@given(st.lists(systems, min_size=1, max_size=5), systems)
def test_whole_frames_of_others_alone_are_told_by_their_headers(whose: list[int], ours: int) -> None:
    data = b"".join(frame_of(BEAT, system=one) for one in whose)
    assert codec.of_others(data, ours) is (ours not in whose)
    mixed = data + bytes(
        mavlink1.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mavlink1.MAVLink(None, whose[0], 1))
    )
    assert codec.of_others(mixed, ours) is (ours not in whose)
    # all of it must be understood, whatever the first frames are
    assert not codec.of_others(data[:-1], ours)
    assert not codec.of_others(data + b"\0", ours)
    assert not codec.of_others(b"", ours)


def test_motor_commands_of_another_are_never_passed_over() -> None:
    beat, rival = frame_of(BEAT, system=7), frame_of(RIVAL, system=7)
    for data in (rival, beat + rival, rival + beat):
        assert not codec.of_others(data, 1)


def test_noise_that_looks_like_the_start_of_a_frame_swallows_no_demand(rig: Any) -> None:
    # an unknown message of 255 bytes by its header: skipped by its length, it would take four demands
    promise = struct.pack("<BBBBBBBHB", 0xFD, 255, 0, 0, 0, 1, 1, 0xABCD, 0xEF)
    for n in range(40):
        rig.say(promise)
        rig.say(demand(1_000_000 + 4000 * n, HOVER, sequence=n))
        assert rig.hear().time_usec == 1_000_000 + 4000 * n


def test_every_demand_between_others_heartbeats_is_answered_and_none_of_them_is_parsed(rig: Any) -> None:
    taken: list[bytes] = []
    take = rig.live.take
    rig.live.take = lambda data: (taken.append(data), take(data))
    for n in range(60):
        for other in range(2, 22):
            rig.say(frame_of(BEAT, n, system=other))
        rig.say(demand(1_000_000 + 4000 * n, HOVER, sequence=n))
        assert rig.hear().time_usec == 1_000_000 + 4000 * n
    of_others = {frame_of(BEAT, 0, system=other)[5] for other in range(2, 22)}
    assert not [data for data in taken if data and data[5] in of_others]
    if rig.hot_answers:
        assert rig.hot_answers > 40


def test_a_frame_in_two_datagrams_is_still_put_together(rig: Any) -> None:
    heard: list[Any] = []
    rig.session.subscribe(lambda m: heard.append(m) if m.get_type() == "ATTITUDE" else None)
    for n in range(10):
        rig.say(demand(1_000_000 + 4000 * n, HOVER, sequence=n))
        rig.hear()
    frame_ = frame_of(mavlink.MAVLink_attitude_message(5, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6), 11)
    rig.say(frame_[:20])
    rig.say(frame_[20:])
    rig.say(demand(1_100_000, HOVER, sequence=12))
    assert rig.hear().time_usec == 1_100_000
    rig.say(demand(1_104_000, HOVER, sequence=13))
    rig.hear()
    assert [round(m.pitch, 3) for m in heard] == [0.2]
