"""Live mixing on a signed line: our own signatures are pymavlink's byte for byte, and it flies."""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_flight import Companion, Flight, demand
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink import codec
from coaxlink.mavlink.signing import Signer

KEY = bytes(range(32))
byte = st.integers(0, 255)
shares = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1, width=32))


@pytest.mark.slow
@given(st.integers(0, 2**64 - 1), st.lists(shares, min_size=8, max_size=8), byte, byte, byte, byte)
def test_a_sealed_answer_is_byte_for_byte_pymavlinks(
    tmp_path_factory: pytest.TempPathFactory,
    stamp: int,
    u: list[float],
    seq: int,
    own: int,
    link: int,
    to: int,
) -> None:
    signer = Signer(KEY, tmp_path_factory.getbasetemp() / "none", link)
    theirs = mavlink.MAVLink(None, own, 191)
    theirs.seq = seq
    theirs.signing.secret_key, theirs.signing.sign_outgoing = KEY, True
    # the far future: the clock does not move on while we look
    theirs.signing.timestamp = signer.state.timestamp = 2**46 + stamp % 1000
    theirs.signing.link_id = link
    answer = codec.SET_ACTUATOR_CONTROL_TARGET
    for _ in range(2):  # the second with the next timestamp
        mine = signer.seal(answer.pack(seq, own, 191, stamp, *u, 0, to, 1), answer.seed)
        message = mavlink.MAVLink_set_actuator_control_target_message(stamp, 0, to, 1, u)
        assert mine == bytes(message.pack(theirs))


def test_timestamps_rise_whoever_signs(tmp_path: Path) -> None:
    signer = Signer(KEY, tmp_path)
    packer = mavlink.MAVLink(None, 245, 191)
    signer.attach(packer)
    answer, stamps = codec.SET_ACTUATOR_CONTROL_TARGET, []
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3)
    for k in range(50):
        signer.tick()
        frame = (
            signer.seal(answer.pack(0, 245, 191, k, *[0.5] * 8, 0, 1, 1), answer.seed)
            if k % 3
            else bytes(beat.pack(packer))
        )
        stamps.append(int.from_bytes(frame[-12:-6], "little"))
        assert frame[-6:] == hashlib.sha256(KEY + frame[:-6]).digest()[:6]
    assert all(b > a for a, b in itertools.pairwise(stamps))


@pytest.mark.slow
def test_it_flies_on_a_signed_line_and_nothing_unsigned_or_replayed_moves_it(
    key_file: Path, tmp_path: Path
) -> None:
    flight, signer = Flight(key_file=key_file), Signer(KEY, tmp_path)
    companion, heard = Companion(flight, signer=signer), []
    send = flight.net.send

    def overheard(data: bytes, source: object, target: object) -> None:
        if target == companion.address:
            heard.append(data)
        send(data, source, target)

    flight.net.send = overheard
    live = companion.mix()
    companion.until_live(live)
    flight.fly(1.0)
    assert signer.refused == 0 and all(row.driven for row in flight.rows)
    before = live.core.counters.cycles
    forged = demand(10**9, [0.0, 0.0, 0.0, 0.9] + [0.0] * 4)
    rival = mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8)
    for k in range(20):
        for message in (forged, rival):
            data = bytes(message.pack(mavlink.MAVLink(None, 1, 1)))
            send(data, flight.addresses[0], companion.address)
        send(heard[k], flight.addresses[0], companion.address)  # what it said a second ago
        flight.fly(0.012)
    assert live.error is None and all(row.driven for row in flight.rows)
    assert live.core.counters.cycles - before == 60
    assert live.core.counters.foreign >= 20
    assert live.core.held[3] < 0.8
    companion.close()
    flight.stays_up()
