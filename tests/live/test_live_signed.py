"""Live mixing on a signed line: our own signatures are pymavlink's byte for byte, and it flies."""

from __future__ import annotations

import hashlib
import itertools
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_flight import EXAMPLES, Companion, Flight, real_time
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.live.attitude_loop import AttitudeLoop
from coaxlink.live.mixer import LiveMixer
from coaxlink.mavlink import codec
from coaxlink.mavlink.signing import Signer
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
KEY = bytes(range(32))
byte = st.integers(0, 255)
shares = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0, 1, width=32))


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
        digest = hashlib.sha256(KEY + frame[:-6]).digest()
        assert frame[-6:] == digest[:6]
    assert all(b > a for a, b in itertools.pairwise(stamps))


def test_fields_of_a_message_are_those_of_its_bytes() -> None:
    four = [0.25, -0.5, 1.0, 0.125]
    messages: list[Any] = [
        mavlink.MAVLink_actuator_control_target_message(7, 3, [0.5] * 8),
        mavlink.MAVLink_attitude_quaternion_message(9, *four, 0.5, 1.5, 2.5, four),
        mavlink.MAVLink_attitude_target_message(11, 7, four, 0.5, 1.5, 2.5, 0.75),
        mavlink.MAVLink_actuator_output_status_message(13, 8, [1500.0] * 32),
    ]
    for message in messages:
        frame = bytes(message.pack(mavlink.MAVLink(None, 1, 1)))
        kind = codec.HOT[message.get_msgId()]
        assert codec.fields_of(message) == kind.unpack(frame[10:-2])


@real_time
@pytest.mark.parametrize("own_loop", [False, True])
def test_it_flies_on_a_signed_line(tmp_path: Path, own_loop: bool) -> None:
    key_file = tmp_path / "key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o600)
    flight = Flight(key_file=key_file)
    signer = Signer(KEY, tmp_path)
    companion = Companion(flight, signer=signer)
    live = LiveMixer(
        companion.session, Vehicle(X8, CRM), "exact", own_curve=1.0,
        loop=AttitudeLoop(X8.inertia_kg_m2) if own_loop else None,
    )  # fmt: skip
    starting = threading.Thread(target=live.start)
    starting.start()
    flight.fly(5.0, until=lambda: not starting.is_alive())
    flight.fly(3.0, until=lambda: live.state == "live")
    flight.rows.clear()
    flight.fly(1.5)
    driven = sum(row[1] for row in flight.rows) / len(flight.rows)
    live.session.tap = None
    companion.close()
    flight.close()
    assert live.error is None
    assert driven > 0.9
    assert flight.outputs_are_sound()
    assert abs(flight.rows[-1][3] - 4.0) < 0.7
    assert signer.refused == 0
    assert live.core.counters.cycles > 200


@real_time
def test_an_unsigned_demand_drives_nothing(tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_bytes(KEY)
    key_file.chmod(0o600)
    flight = Flight(key_file=key_file)
    companion = Companion(flight, signer=Signer(KEY, tmp_path))
    live = LiveMixer(companion.session, Vehicle(X8, CRM), "reduced", own_curve=1.0)
    live.session.tap = live
    live._target = (1, 1)
    live._unsubscribe = companion.session.subscribe(live._on_message)
    packer = mavlink.MAVLink(None, 1, 1)
    for k in range(20):
        forged = mavlink.MAVLink_actuator_control_target_message(
            10**9 + 4000 * k, 0, [0.0, 0, 0, 0.9] + [0.0] * 4
        )
        live.take(bytes(forged.pack(packer)))
    assert live.core.counters.cycles == 0
    assert live.core.counters.foreign == 20
    live.session.tap = None
    companion.close()
    flight.close()
