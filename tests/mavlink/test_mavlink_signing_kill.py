"""Signing on the stand-ins: kill -9 and what was recorded, no key, a full disk."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest
from player import player
from pymavlink.dialects.v20 import common as m

from coaxlink.cli import main
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.mavlink import connect
from coaxlink.mavlink import signing_timestamps as signing_book
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.signing import Signer
from sim.testing import standin

KEY = bytes(range(32))
NAMES = {"px4": "CA_ROTOR0_CT", "ardupilot": "MOT_THST_EXPO"}
CHILD = """
import sys, time
from pathlib import Path
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
session = connect(sys.argv[1], signing_key=Path(sys.argv[2]))
parameters, n = Parameters(session), 0
while True:
    n += 1
    parameters.write(sys.argv[3], 0.25 + 0.125 * (n % 4), 9)
    print(n, flush=True)
"""


class Tapped:
    """A relay in front of a port that keeps every datagram of both ways."""

    def __init__(self, port):
        self._inside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._inside.connect(("127.0.0.1", port))
        self._outside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outside.bind(("127.0.0.1", 0))
        self.port = self._outside.getsockname()[1]
        self.said, self.heard = [], []
        self._client, self._stop = None, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._stop.is_set():
            ready, _, _ = select.select([self._inside, self._outside], [], [], 0.05)
            try:
                if self._outside in ready:
                    data, self._client = self._outside.recvfrom(4096)
                    self.said.append(data)
                    self._inside.send(data)
                if self._inside in ready:
                    data = self._inside.recv(4096)
                    self.heard.append(data)
                    self._outside.sendto(data, self._client)
            except OSError:
                continue

    def close(self):
        self._stop.set()
        self._thread.join()
        self._inside.close()
        self._outside.close()


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_nothing_of_a_killed_session_can_be_played_back(key_file, tmp_path, firmware):
    name = NAMES[firmware]
    with standin("--firmware", firmware, "--signing-key", str(key_file)) as port:
        tap = Tapped(port)
        try:
            command = [sys.executable, "-c", CHILD, f"udpout:127.0.0.1:{tap.port}", str(key_file), name]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
                for _ in range(20):
                    assert child.stdout.readline().strip()
                os.kill(child.pid, signal.SIGKILL)
        finally:
            tap.close()
        assert all(frame[2] & 1 for frame in tap.said)
        (file,) = (tmp_path / "state").glob("*.signing.json")
        book = json.loads(file.read_text())
        limits = {tuple(stream): last for *stream, last in book["streams"]}
        assert max(_stamp(frame) for frame in tap.said) < book["timestamp"]
        heard = {(f[-13], f[5], f[6]) for f in tap.heard}
        assert heard and all(stream in limits for stream in heard)
        assert all(_stamp(f) < limits[f[-13], f[5], f[6]] for f in tap.heard)
        with player(tap.heard) as false, pytest.raises(SafetyRefusal, match="does not sign"):
            connect(f"udpout:127.0.0.1:{false}", signing_key=key_file, timeout_s=1.5)
        began = time.monotonic()
        with connect(f"udpout:127.0.0.1:{port}", signing_key=key_file) as session:
            assert time.monotonic() - began < 8.0
            assert Parameters(session).write(name, 0.875, 9).value == 0.875
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
                for frame in tap.said:
                    thief.sendto(frame, ("127.0.0.1", port))
            time.sleep(0.5)
            assert Parameters(session).read(name).value == 0.875


def _stamp(frame):
    return int.from_bytes(frame[-12:-6], "little")


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_without_the_key_it_is_said_in_seconds(key_file, capsys, firmware):
    with standin("--firmware", firmware, "--signing-key", str(key_file)) as port:
        began = time.monotonic()
        with pytest.raises(SystemExit) as ended:
            main(["verify", "--connect", f"udpout:127.0.0.1:{port}"])
        assert ended.value.code == 4
        assert "--signing-key" in capsys.readouterr().err
        assert time.monotonic() - began < 15.0
        # who only listens may
        with connect(f"udpout:127.0.0.1:{port}", listen_only=True) as session:
            assert session.bound.signs and session.wait("HEARTBEAT", 5.0) is not None


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


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"timestamp": 1}', '{"timestamp": -1, "streams": []}',
             '{"timestamp": 1, "streams": [[1, 1, 1, 281474976710656]]}'],
)  # fmt: skip
def test_a_damaged_book_is_one_line(tmp_path, text):
    path = tmp_path / "k.signing.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"k\.signing\.json") as caught:
        signing_book.Book(path)
    assert "\n" not in str(caught.value)


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
