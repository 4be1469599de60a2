"""Start a stand-in as a process of its own, for tests: on a free port, gone when the block ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from sim.errors import SimError

END_S = 120.0  # a guard against hanging: a stand-in on a busy machine took more than ten seconds to end


@contextmanager
def standin(*arguments: str, kind: str = "udpin") -> Iterator[int]:
    """Run `coaxlink sim ARGUMENTS` listening on loopback; yields the (last) port. Raises SimError."""
    with standins(*arguments, kind=kind) as ports:
        yield ports[-1]


@contextmanager
def standins(*arguments: str, kind: str = "udpin") -> Iterator[list[int]]:
    """The same, for all its ports."""
    command = [sys.executable, "-m", "coaxlink", "sim", "--listen", f"{kind}:127.0.0.1:0", *arguments]
    with tempfile.TemporaryFile("w+") as talk:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=talk, text=True)
        try:
            assert process.stdout is not None
            ready = process.stdout.readline().strip()
            if not ready.startswith("ready"):
                process.wait(END_S)
                talk.seek(0)
                raise SimError(talk.read().strip() or "the stand-in ended without a word")
            yield [int(name.rpartition(":")[2]) for name in ready.split() if name.count(":") == 2]
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                code = process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                code = process.wait()
            if process.stdout is not None:
                process.stdout.close()
            talk.seek(0)
            last = talk.read()
    if code != 0:
        raise SimError(f"the stand-in ended with {code}: {last}")
