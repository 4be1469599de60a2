"""Signed sessions in memory: pymavlink's own signing on the other side, wrong keys, no keys, replays.

Then the book of timestamps. What a kill leaves is in test_mavlink_real_lines.py.
"""

import hashlib
import json
import time

import pytest
from memory_net import Line, Net, meet, standin
from px4_board import x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink import connect
from coaxlink.mavlink import signing_timestamps as signing_book
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.signing import Signer, load_key

KEY = bytes(range(32))


def test_both_sides_sign_and_timestamps_are_kept(key_file, tmp_path):
    with ScriptedAutopilot(x8(), net=Net(), key=KEY) as vehicle:
        with meet(vehicle, signing_key=key_file) as session:
            assert Parameters(session).write("CA_ROTOR0_CT", 7.0, 9).value == 7.0
            assert session.latest("HEARTBEAT").get_signed()
        assert vehicle.params["CA_ROTOR0_CT"][0] == 7.0
        assert all(message.get_signed() for message in vehicle.heard)
        (book,) = (tmp_path / "state").glob("*.signing.json")
        first = json.loads(book.read_text())
        with meet(vehicle, signing_key=key_file):
            pass
        second = json.loads(book.read_text())
        assert second["timestamp"] > first["timestamp"]
        assert second["streams"][0][:3] == [3, 1, 1] and second["streams"][0][3] > first["streams"][0][3]


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_a_vehicle_that_does_not_sign_with_the_key_is_refused(key_file, key):
    with (
        ScriptedAutopilot(x8(), net=Net(), key=key) as vehicle,
        pytest.raises(SafetyRefusal, match="does not sign"),
    ):
        meet(vehicle, signing_key=key_file, timeout_s=0.8)
    assert vehicle.sets == []


def test_a_recording_is_refused(key_file):
    with (
        ScriptedAutopilot(x8(), net=Net(), key=KEY) as vehicle,
        meet(vehicle, signing_key=key_file) as session,
    ):
        session.wait("HEARTBEAT", 1.0)
        recording = [bytes(frame) for frame in vehicle.sent]
        session.wait("HEARTBEAT", 3.0)  # so that all of it was heard once
    net, false = vehicle.net, vehicle.net.address()

    def play(data, source):
        for frame in recording:
            net.send(frame, false, source)

    net.bind(false, play)
    with pytest.raises(SafetyRefusal, match="does not sign"):
        connect("udpout:10.0.0.9:1", transport=Line(net, false), clock=net.clock, signing_key=key_file)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_without_the_key_it_is_refused_in_seconds_but_for_who_only_listens(key_file, firmware):
    with standin(firmware, signing_key=key_file) as board:
        began = board.net.clock.now
        with pytest.raises(SafetyRefusal, match="signing_key"):
            meet(board)
        assert board.net.clock.now - began < 5.0
        with meet(board, listen_only=True) as session:
            assert session.bound.signs and session.wait("HEARTBEAT", 5.0) is not None


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


def test_the_book_is_ahead_of_every_stamp_and_says_the_truth_at_the_end(tmp_path, monkeypatch):
    path, step = tmp_path / "k.signing.json", signing_book.AHEAD

    def on_disk():
        raw = json.loads(path.read_text())
        return raw["timestamp"], {tuple(stream): last for *stream, last in raw["streams"]}

    book = signing_book.Book(path)
    book.begin(1000)
    assert on_disk() == (1000 + step, {})
    vehicle = (3, 1, 1)
    book.cover(2000, {vehicle: 500})  # a new sender is on disk before it is believed
    assert on_disk() == (2000 + step, {vehicle: 500 + step})
    book.cover(2001, {vehicle: 501})
    assert on_disk() == (2000 + step, {vehicle: 500 + step})
    book.cover(10 * step, {vehicle: 20 * step})  # its clock jumped
    assert on_disk() == (11 * step, {vehicle: 21 * step})
    book.cover(10 * step + step // 2 + 1, {})  # past the half: another thread does it
    end = time.monotonic() + 600.0
    while on_disk()[0] == 11 * step:
        assert time.monotonic() < end
        time.sleep(0.01)
    second = signing_book.Book(path)
    assert second.sent == on_disk()[0] and second.heard == {vehicle: 21 * step}
    book.close(12, {vehicle: 13})  # the other one is still there: nothing is given back
    assert on_disk()[0] > 11 * step
    second.close(30 * step, {vehicle: 29 * step})
    assert on_disk() == (30 * step, {vehicle: 29 * step})


DAMAGED = ("{", "[]", '{"timestamp": 1}', '{"timestamp": -1, "streams": []}')
DAMAGED += ('{"timestamp": 1, "streams": [[1, 1, 1, 281474976710656]]}',)


def test_a_damaged_book_is_one_line(tmp_path):
    path = tmp_path / "k.signing.json"
    for text in DAMAGED:
        path.write_text(text)
        with pytest.raises(InputError, match=r"k\.signing\.json") as caught:
            signing_book.Book(path)
        assert "\n" not in str(caught.value), text


def test_a_disk_that_fills_up_in_flight_does_not_end_the_session(tmp_path, monkeypatch):
    signer = Signer(KEY, tmp_path)

    def full(path, value):
        raise InputError(path, "", "cannot be written (No space left on device)")

    monkeypatch.setattr(signing_book.files, "write_json", full)
    signer.state.timestamp += 3 * signing_book.AHEAD
    packer = m.MAVLink(None, 245, 191)
    signer.attach(packer)
    signer.tick()
    assert m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(packer)
    assert "No space left" in signer.trouble
    monkeypatch.undo()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):  # at the start it does
        Signer(KEY, tmp_path / "file" / "x")


@pytest.mark.parametrize("year", [2104.5, 2110, 9000])
def test_a_clock_beyond_the_timestamps_is_one_line_and_keeps_nothing(tmp_path, monkeypatch, year):
    Signer(KEY, tmp_path).close()
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with monkeypatch.context() as clock:
        clock.setattr(time, "time", lambda: (year - 1970) * 365.2425 * 86400)
        with pytest.raises(InputError, match=r"the clock of this machine.*set it right"):
            Signer(KEY, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    Signer(KEY, tmp_path).close()


def test_stamps_at_the_end_of_time_are_not_believed_and_do_not_break_the_book(tmp_path, monkeypatch):
    """A peer whose clock is wrong, and ours going wrong in flight."""
    signer = Signer(KEY, tmp_path / "ours")
    peer = m.MAVLink(None, 1, 1)
    peer.signing.secret_key, peer.signing.sign_outgoing = KEY, True
    beat = m.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    for stamp, believed in ((signing_book.END - 1, True), (signing_book.END, False), ((1 << 48) - 1, False)):
        peer.signing.timestamp = stamp
        assert signer.genuine(bytes(beat.pack(peer))) is believed
    monkeypatch.setattr(time, "time", lambda: 4.5e9)
    signer.tick()
    signer.close()
    monkeypatch.undo()
    Signer(KEY, tmp_path / "ours").close()
