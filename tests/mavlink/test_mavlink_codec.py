"""The hand-written codec against pymavlink: the same bytes out, the same fields in, whatever is in them."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink import codec

FLOATS = st.one_of(
    st.floats(width=32, allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 2.0**-149, 2.0**127]),
)
SIZES = {"Q": 2**64, "I": 2**32, "H": 2**16, "B": 2**8}


def classes() -> dict[int, Any]:
    return {number: mavlink.mavlink_map[number] for number in codec.HOT}


def pymavlink_fields(kind: Any) -> list[tuple[str, str, int]]:
    """(name, struct letter, length) in wire order, from pymavlink's own tables."""
    names = [kind.ordered_fieldnames[i] for i in range(len(kind.ordered_fieldnames))]
    letters = kind.unpacker.format.removeprefix("<")
    out, at = [], 0
    for name, length in zip(names, kind.lengths, strict=True):
        digits = ""
        while letters[at].isdigit():
            digits += letters[at]
            at += 1
        out.append((name, letters[at], length))
        at += 1
    return out


@st.composite
def message(draw: st.DrawFn, number: int) -> tuple[list[Any], dict[str, Any]]:
    flat: list[Any] = []
    named: dict[str, Any] = {}
    for name, letter, length in pymavlink_fields(classes()[number]):
        if letter == "s":
            named[name] = draw(st.binary(min_size=10, max_size=10))
            flat.append(named[name])
            continue
        one = FLOATS if letter == "f" else st.integers(0, SIZES[letter] - 1)
        count = max(length, 1)
        values = draw(st.lists(one, min_size=count, max_size=count))
        if draw(st.booleans()) and letter == "f":
            values = [0.0] * count  # trailing zeros are where truncation is
        flat += [bytes(values)] if name == "payload" else values
        named[name] = values if length > 1 else values[0]
    return flat, named


def same(a: Any, b: Any) -> bool:
    return struct.pack("<d", a) == struct.pack("<d", b) or (math.isnan(a) and math.isnan(b))


@pytest.mark.slow
@pytest.mark.parametrize("number", sorted(codec.HOT))
@settings(max_examples=40, deadline=None)
@given(
    data=st.data(), sequence=st.integers(0, 255), system=st.integers(0, 255), component=st.integers(0, 255)
)
def test_every_field_packs_to_pymavlinks_bytes_and_comes_back(
    number: int, data: st.DataObject, sequence: int, system: int, component: int
) -> None:
    flat, named = data.draw(message(number))
    kind = classes()[number]
    packer = mavlink.MAVLink(None, system, component)
    packer.seq = sequence
    theirs = bytes(kind(**named).pack(packer))
    hot = codec.HOT[number]
    assert hot.pack(sequence, system, component, *flat) == theirs
    (frame,) = codec.Scanner().feed(theirs)
    assert (frame.number, frame.sequence, frame.system, frame.component) == (
        number,
        sequence,
        system,
        component,
    )
    for got, meant in zip(hot.unpack(frame.payload), flat, strict=True):
        assert got == meant if isinstance(meant, bytes) else same(float(got), float(meant))


def test_mavlink_1_frames_are_read_too() -> None:
    packer = mavlink.MAVLink(None, 7, 1)
    sent = mavlink.MAVLink_actuator_control_target_message(123456, 0, [0.1 * k for k in range(8)])
    data = bytes(sent.pack(packer, force_mavlink1=True))
    assert data[0] == codec.V1
    (frame,) = codec.Scanner().feed(data)
    fields = codec.ACTUATOR_CONTROL_TARGET.unpack(frame.payload)
    assert fields[0] == 123456
    assert fields[1:9] == pytest.approx([0.1 * k for k in range(8)])
    assert frame.system == 7


@settings(max_examples=60, deadline=None)
@given(cuts=st.lists(st.integers(1, 40), max_size=30), noise=st.binary(max_size=30))
def test_frames_come_out_whole_however_the_stream_is_cut(cuts: list[int], noise: bytes) -> None:
    packer = mavlink.MAVLink(None, 1, 1)
    stream, meant = b"", []
    for k in range(6):
        stream += bytes(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(packer))
        stream += bytes(mavlink.MAVLink_actuator_control_target_message(k + 1, 0, [0.5] * 8).pack(packer))
        meant.append(k + 1)
    clean = bytes(b for b in noise if b not in (codec.V1, codec.V2))
    stream = clean + stream
    scanner = codec.Scanner({140}, codec.known_seeds())
    got = []
    for cut in cuts:
        got += scanner.feed(stream[:cut])
        stream = stream[cut:]
    got += scanner.feed(stream)
    assert [codec.ACTUATOR_CONTROL_TARGET.unpack(f.payload)[0] for f in got] == meant


def test_damaged_frames_never_come_out_as_other_ones() -> None:
    rng = random.Random(4)
    scanner = codec.Scanner({140}, codec.known_seeds())
    packer = mavlink.MAVLink(None, 1, 1)
    sent: set[bytes] = set()
    passed = 0
    for k in range(4000):
        controls = [rng.uniform(-1, 1) for _ in range(8)]
        data = bytearray(mavlink.MAVLink_actuator_control_target_message(k + 1, 0, controls).pack(packer))
        sent.add(bytes(data[10:-2]))
        if k % 2:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        for frame in scanner.feed(bytes(data)):
            passed += 1
            assert frame.payload in sent or frame.payload.ljust(41, b"\0") in sent
    assert passed >= 1900
    assert scanner.damaged > 500


def test_a_signed_frame_comes_out_whole() -> None:
    packer = mavlink.MAVLink(None, 1, 1)
    packer.signing.secret_key = bytes(range(32))
    packer.signing.link_id, packer.signing.timestamp = 1, 10_000
    packer.signing.sign_outgoing = True
    data = bytes(mavlink.MAVLink_actuator_control_target_message(9, 0, [0.5] * 8).pack(packer))
    follower = bytes(mavlink.MAVLink_actuator_control_target_message(10, 0, [0.5] * 8).pack(packer))
    frames = codec.Scanner().feed(data + follower)
    assert [f.raw for f in frames] == [data, follower]
