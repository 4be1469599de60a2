"""Start `coaxlink sim` as a process of its own: it talks to us over MAVLink and nothing else."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO

from coaxlink import _interrupts
from coaxlink.absent import refuse_windows
from coaxlink.errors import LinkError

READY_S = 60.0  # a first start compiles the plant
PORTS = range(20000, 32000)  # below what Linux, macOS and Windows give to whom asks for any port
_CANDIDATES = (PORTS[(os.getpid() * 97 + i) % len(PORTS)] for i in itertools.count())


@contextmanager
def simulator(arguments: Sequence[str]) -> Iterator[str]:
    """Run `coaxlink sim ARGUMENTS --listen ...` on a free loopback port; yields the address to connect to.

    Raises LinkError when it does not come up. It ends with the block, politely first.
    """
    refuse_windows("coaxlink sim")
    port = free_port()
    command = [sys.executable, "-m", "coaxlink", "sim", *arguments, "--listen", f"udpin:127.0.0.1:{port}"]
    _interrupts.begin()  # a process to end
    with tempfile.TemporaryFile("w+") as talk:
        # a group of its own: Ctrl-C is ours to deal with, and the world must not be gone before we have
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=talk, text=True, start_new_session=True
        )
        try:
            assert process.stdout is not None
            if not process.stdout.readline().startswith("ready"):
                process.wait(READY_S)
                raise LinkError("coaxlink sim", f"did not start: {_last_line(talk)}")
            try:
                yield f"udpout:127.0.0.1:{port}"
            except LinkError as error:
                if process.poll() is None:
                    raise
                raise LinkError("coaxlink sim", f"ended by itself: {_last_line(talk)}") from error
        finally:
            process.terminate()
            try:
                process.communicate(timeout=5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


def _last_line(talk: IO[str]) -> str:
    talk.seek(0)
    return (talk.read().strip().splitlines() or ["without a word"])[-1]


def free_port() -> int:
    """A UDP and TCP port of the loopback interface that nobody holds right now.

    It is one that the system gives nobody who asks for any port: between this call and the time that the
    caller binds it only another caller of this function could take it, and each process starts elsewhere.
    """
    for port in _CANDIDATES:
        try:
            for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return port
    raise AssertionError("the candidates have no end")
