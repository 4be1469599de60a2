"""Uploads over TCP and serial lines, signed, in pieces, and torn while the table is written."""

import contextlib
import os
import pty
import select
import socket
import struct
import threading
import tty

import pytest
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot

from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.uploading.journal import Journal
from coaxlink.uploading.plan import load_plan
from coaxlink.uploading.verify import verify
from coaxlink.uploading.worker import Uploader

KEY = bytes(range(32))
PIECE = 11  # bytes at a time: a stream knows no frames


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


def _plan(tmp_path):
    folder = tmp_path / "table"
    folder.mkdir()
    (folder / "x8.params").write_text(params_text())
    return load_plan(folder)


def _bits(params):
    return {n: struct.pack("<f", v) for n, (v, _) in params.items()}


@pytest.mark.parametrize("signed", [False, True], ids=["plain", "signed"])
@pytest.mark.parametrize("kind", [TcpWire, SerialWire])
def test_an_upload_over_a_stream(tmp_path, key_file, kind, signed):
    plan, key = _plan(tmp_path), KEY if signed else None
    with ScriptedAutopilot(x8(), key=key) as vehicle, kind(vehicle) as wire:
        with connect(wire.url, signing_key=key_file if signed else None) as session:
            outcome = Uploader(session, backup_folder=tmp_path / "b").upload(plan)
            assert outcome.result == "verified" and len(outcome.changed) == 18
            assert verify(session, plan).holds
        assert vehicle.params["CA_ROTOR4_CT"][0] == pytest.approx(69.89)
        assert all(bool(message.get_signed()) == signed for message in vehicle.heard)


def test_a_line_that_is_torn_while_writing_is_opened_again_and_the_board_is_whole(tmp_path):
    plan = _plan(tmp_path)
    with ScriptedAutopilot(x8()) as vehicle, TcpWire(vehicle) as wire:
        before = _bits(vehicle.params)
        vehicle.after_set = {7: wire.tear.set}
        with connect(wire.url) as session:
            worker = Uploader(
                session, backup_folder=tmp_path / "b", parameters=Parameters(session, timeout_s=0.15)
            )
            outcome = worker.upload(plan)
            assert wire.torn == 1 and outcome.result in ("verified", "rolled_back")
            assert verify(session, plan).holds == (outcome.result == "verified")
            assert Journal(session.identity).open_entry() is None
        assert outcome.result == "verified" or _bits(vehicle.params) == before
