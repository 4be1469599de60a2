"""What the tests of exit codes share: a verb run as a user runs it, its one line, the board behind."""

import contextlib
import os
import struct
from pathlib import Path
from unittest import mock

from memory_net import Net, plugged
from px4_board import params_text, x8
from scripted_autopilot import ScriptedAutopilot
from verb import run

KEY = bytes(range(32))
VERBS = ("upload", "restore", "verify")


def furnish():
    """A table and a key in the folder where one stands."""
    Path("t").mkdir()
    Path("t/x8.params").write_text(params_text())
    Path("key").write_bytes(KEY)
    Path("key").chmod(0o600)


@contextlib.contextmanager
def on_a_line():
    """A board in memory, on a clock of its own: the verbs find it at its address."""
    with plugged(Net()) as net, ScriptedAutopilot(x8(), net=net) as vehicle:
        yield vehicle


@contextlib.contextmanager
def boarded(folder):
    """Such a board, and one's feet in a new folder with a table for it."""
    folder.mkdir()
    state = mock.patch.dict(os.environ, {"COAXLINK_STATE": str(folder / "state")})
    with state, contextlib.chdir(folder), on_a_line() as board:
        furnish()
        yield board


def no(err, text):
    """The one line that says no: the last, and the only one of its kind."""
    lines = err.splitlines()
    assert text in lines[-1], err
    assert [line for line in lines if line.startswith("coaxlink: ")] == [lines[-1]]
    assert "Traceback" not in err


def held(board):
    return {n: struct.pack("<f", v) for n, (v, _) in board.params.items()}


def backup(board, capsys):
    assert run(capsys, "upload", "t", "--connect", board.url, "--yes")[0] == 0
    (path,) = Path("backups").glob("*.params")
    return path


def verbs(board_url):
    return {
        "upload": ["upload", "t", "--connect", board_url, "--yes"],
        "restore": ["restore", "b.params", "--connect", board_url, "--yes"],
        "verify": ["verify", "t", "--connect", board_url],
    }
