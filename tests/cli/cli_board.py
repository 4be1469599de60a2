"""What the tests of exit codes share: a verb run as a user runs it, its one line, the board behind."""

import struct
from pathlib import Path

from verb import run

KEY = bytes(range(32))
VERBS = ("upload", "restore", "verify")


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
