"""Signed sessions: pymavlink's own signing on the other side, wrong keys, no keys, replays."""

import hashlib
import json

import pytest
from player import player
from px4_board import x8
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.signing import load_key

KEY = bytes(range(32))


def test_both_sides_sign_and_timestamps_are_kept(key_file, tmp_path):
    with ScriptedAutopilot(x8(), key=KEY) as vehicle:
        with connect(vehicle.url, signing_key=key_file) as session:
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            assert session.latest("HEARTBEAT").get_signed()
        assert vehicle.params["CA_ROTOR0_CT"][0] == 7.0
        assert all(message.get_signed() for message in vehicle.heard)
        (book,) = (tmp_path / "state").glob("*.signing.json")
        first = json.loads(book.read_text())
        with connect(vehicle.url, signing_key=key_file):
            pass
        second = json.loads(book.read_text())
        assert second["timestamp"] > first["timestamp"]
        assert second["streams"][0][:3] == [3, 1, 1] and second["streams"][0][3] > first["streams"][0][3]


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_a_vehicle_that_does_not_sign_with_the_key_is_refused(key_file, key):
    with ScriptedAutopilot(x8(), key=key) as vehicle, pytest.raises(SafetyRefusal, match="does not sign"):
        connect(vehicle.url, signing_key=key_file, timeout_s=0.8)
    assert vehicle.sets == []


def test_a_recording_is_refused(key_file):
    with ScriptedAutopilot(x8(), key=KEY) as vehicle, connect(vehicle.url, signing_key=key_file) as session:
        session.wait("HEARTBEAT", 1.0)
        recording = [bytes(frame) for frame in vehicle.sent]
        session.wait("HEARTBEAT", 3.0)  # so that all of it was heard once
    with player(recording) as false, pytest.raises(SafetyRefusal, match="does not sign"):
        connect(f"udpout:127.0.0.1:{false}", signing_key=key_file, timeout_s=1.5)


def test_keys(tmp_path):
    path = tmp_path / "k"
    for data, expected in (
        (KEY, KEY),
        (KEY.hex().encode() + b"\n", KEY),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest()),
    ):
        path.write_bytes(data)
        path.chmod(0o600)
        assert load_key(path) == expected
    path.chmod(0o640)
    with pytest.raises(SafetyRefusal, match=r"can be read by others \(mode 640\)"):
        load_key(path)
    path.write_bytes(b"")
    path.chmod(0o600)
    with pytest.raises(InputError, match="an empty signing key"):
        load_key(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_key(tmp_path / "none")
