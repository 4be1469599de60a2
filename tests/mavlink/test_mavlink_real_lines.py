"""What only real sockets, ports, terminals and processes prove: everything else is in memory.

TCP and serial lines in pieces, signed; a line torn while the table is written; ports that are taken or dead;
a signed session killed with SIGKILL, and what was recorded of it.
"""

import contextlib
import json
import os
import pty
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tty

import pytest
from player import player
from px4_board import params_text, x8
from pymavlink.dialects.v20 import common as m
from scripted_autopilot import ScriptedAutopilot

from coaxlink.errors import LinkError, SafetyRefusal
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.port_holder import UNKNOWN, holder_of
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader
from sim.testing import standin

pytestmark = pytest.mark.slow
KEY = bytes(range(32))
PIECE = 11  # bytes at a time: a stream knows no frames
NAME = "CA_ROTOR0_CT"
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="macOS tells root alone")
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


class Wire:
    """A stream of bytes on one side, the scripted autopilot's datagrams on the other."""

    def __init__(self, vehicle):
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.connect(("127.0.0.1", int(vehicle.url.rpartition(":")[2])))
        self._stop = threading.Event()
        self.tear = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5.0)
        self._udp.close()
        self.close()

    def _pass_on(self, read, write, handle):
        """Until torn or stopped."""
        while not self._stop.is_set() and not self.tear.is_set():
            for ready in select.select([handle, self._udp], [], [], 0.02)[0]:
                if ready is handle:
                    data = read()
                    if not data:
                        return
                    self._udp.send(data)
                else:
                    data = self._udp.recv(4096)
                    for start in range(0, len(data), PIECE):
                        write(data[start : start + PIECE])


class TcpWire(Wire):
    def __init__(self, vehicle):
        super().__init__(vehicle)
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.url = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        self.torn = 0

    def _run(self):
        while not self._stop.is_set():
            try:
                line, _ = self._server.accept()
            except TimeoutError:
                continue
            with line, contextlib.suppress(OSError):  # the other side may close first
                self._pass_on(lambda: line.recv(4096), line.sendall, line)  # noqa: B023
            if self.tear.is_set():
                self.torn += 1
                self.tear.clear()

    def close(self):
        self._server.close()


class SerialWire(Wire):
    def __init__(self, vehicle):
        super().__init__(vehicle)
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._ours)
        self.url = f"{os.ttyname(self._theirs)},57600"

    def _run(self):
        def write(data):
            os.write(self._ours, data)

        self._pass_on(lambda: os.read(self._ours, 4096), write, self._ours)

    def close(self):
        os.close(self._ours)
        os.close(self._theirs)


class Tapped:
    """A relay in front of a port that keeps every datagram of both ways."""

    def __init__(self, port):
        self._inside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._inside.connect(("127.0.0.1", port))
        self._outside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outside.bind(("127.0.0.1", 0))
        self.port = self._outside.getsockname()[1]
        self.reported, self.heard = [], []
        self._client, self._stop = None, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._stop.is_set():
            ready, _, _ = select.select([self._inside, self._outside], [], [], 0.05)
            try:
                if self._outside in ready:
                    data, self._client = self._outside.recvfrom(4096)
                    self.reported.append(data)
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


@pytest.fixture
def plan(tmp_path):
    (tmp_path / "x8.params").write_text(params_text())
    return load_plan(tmp_path / "x8.params")


def _bits(params):
    return {n: struct.pack("<f", v) for n, (v, _) in params.items()}


@pytest.mark.parametrize(("kind", "signed"), [(TcpWire, False), (SerialWire, True)])
def test_an_upload_over_a_stream(tmp_path, plan, key_file, kind, signed):
    with ScriptedAutopilot(x8(), key=KEY if signed else None) as vehicle, kind(vehicle) as wire:
        with connect(wire.url, signing_key=key_file if signed else None) as session:
            outcome = Uploader(session, backup_folder=tmp_path / "b").upload(plan)
            assert outcome.result == "verified" and len(outcome.changed) == 18
            assert verify(session, plan).holds
        assert vehicle.params["CA_ROTOR4_CT"][0] == pytest.approx(69.89)
        assert all(bool(message.get_signed()) == signed for message in vehicle.heard)


def test_a_line_that_is_torn_while_writing_is_opened_again_and_the_board_is_whole(tmp_path, plan):
    with ScriptedAutopilot(x8()) as vehicle, TcpWire(vehicle) as wire:
        before = _bits(vehicle.params)
        vehicle.after_set = {7: wire.tear.set}
        with connect(wire.url) as session:
            quick = Parameters(session, timeout_s=0.15)
            outcome = Uploader(session, backup_folder=tmp_path / "b", parameters=quick).upload(plan)
            assert wire.torn == 1 and outcome.result in ("verified", "rolled_back")
            assert verify(session, plan).holds == (outcome.result == "verified")
            assert Journal(session.identity, address=session.address).open_entry() is None
        assert outcome.result == "verified" or _bits(vehicle.params) == before


def test_the_end_of_a_tcp_stream_is_noticed():
    with socket.create_server(("127.0.0.1", 0)) as server:
        stop = threading.Event()

        def serve():
            stream, _ = server.accept()
            out = m.MAVLink(None, 1, 1)
            while not stop.is_set():
                stream.sendall(m.MAVLink_heartbeat_message(14, 12, 0, 0, 4, 3).pack(out))
                time.sleep(0.05)
            stream.close()

        thread = threading.Thread(target=serve)
        thread.start()
        with connect(f"tcp:127.0.0.1:{server.getsockname()[1]}") as session:
            assert session.identity.version is None  # it answers no request
            stop.set()
            thread.join()
            with pytest.raises(LinkError, match="closed the connection"):
                session.wait("ATTITUDE", 60.0)


def test_lines_that_cannot_be_had():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken, socket.socket() as free:
        taken.bind(("127.0.0.1", 0))
        free.bind(("127.0.0.1", 0))
        port, dead = taken.getsockname()[1], free.getsockname()[1]
        for url, reported in (
            (f"tcp:127.0.0.1:{dead}", "refused"),
            (f"udpin:127.0.0.1:{port}", "in use by"),
            (f"udpout:127.0.0.1:{port}", "no autopilot heard"),
            ("/dev/no-such-line,57600", "cannot be opened"),
        ):
            with pytest.raises(LinkError, match=reported):
                connect(url, timeout_s=0.3)


@LINUX
def test_who_holds_a_port_is_named():
    """A port of another process, of this one, a free one; udp and tcp."""
    code = (
        "import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(('127.0.0.1', 0));"
        "print(s.getsockname()[1], flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, "mix"]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        port = int(other.stdout.readline())
        with pytest.raises(LinkError, match=f"the port is in use by process {other.pid} "):
            connect(f"udpin:127.0.0.1:{port}")
    finally:
        other.communicate()
    for kind in ("udp", "tcp"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as s:
            s.bind(("127.0.0.1", 0))
            port = s.getsockname()[1]
            if kind == "tcp":
                s.listen()
            assert holder_of(port, kind).startswith(f"process {os.getpid()} (")
        assert holder_of(port, kind) == UNKNOWN


def test_nothing_of_a_killed_session_can_be_played_back(key_file, tmp_path):
    with standin("--firmware", "px4", "--signing-key", str(key_file)) as port:
        tap = Tapped(port)
        try:
            command = [sys.executable, "-c", CHILD, f"udpout:127.0.0.1:{tap.port}", str(key_file), NAME]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
                for _ in range(20):
                    assert child.stdout.readline().strip()
                os.kill(child.pid, signal.SIGKILL)
        finally:
            tap.close()
        assert all(frame[2] & 1 for frame in tap.reported)
        (file,) = (tmp_path / "state").glob("*.signing.json")
        book = json.loads(file.read_text())
        limits = {tuple(stream): last for *stream, last in book["streams"]}
        assert max(_stamp(frame) for frame in tap.reported) < book["timestamp"]
        heard = {(f[-13], f[5], f[6]) for f in tap.heard}
        assert heard and all(stream in limits for stream in heard)
        assert all(_stamp(f) < limits[f[-13], f[5], f[6]] for f in tap.heard)
        with player(tap.heard) as false, pytest.raises(SafetyRefusal, match="does not sign"):
            connect(f"udpout:127.0.0.1:{false}", signing_key=key_file, timeout_s=1.5)
        with connect(f"udpout:127.0.0.1:{port}", signing_key=key_file) as session:
            assert Parameters(session).write(NAME, 0.875, 9).value == 0.875
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
                for frame in tap.reported:
                    thief.sendto(frame, ("127.0.0.1", port))
            time.sleep(0.5)
            assert Parameters(session).read(NAME).value == 0.875


def _stamp(frame):
    return int.from_bytes(frame[-12:-6], "little")
