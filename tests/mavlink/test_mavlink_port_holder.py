"""A port that is taken: the one line that names who has it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.mavlink.port_holder import UNKNOWN, holder_of

EXAMPLES = Path(__file__).parents[2] / "examples"
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc is Linux's")


@LINUX
def test_a_second_mix_on_a_port_says_who_holds_it(capfd: pytest.CaptureFixture[str]) -> None:
    code = (
        "import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(('127.0.0.1', 0));"
        "print(s.getsockname()[1], flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, "mix"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )  # fmt: skip
    try:
        assert other.stdout is not None
        port = int(other.stdout.readline())
        arguments = ["mix", str(EXAMPLES / "x8_demo.toml"), "--connect", f"udpin:127.0.0.1:{port}"]
        assert run(build_app(), [*arguments, "--plain", "--law", "standard"]) == 3
        said = capfd.readouterr().err.splitlines()[-1]
        assert said.startswith(
            f"coaxlink: udpin:127.0.0.1:{port}: the port is in use by process {other.pid} ("
        )
    finally:
        other.communicate()


@LINUX
@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_our_own_port_is_found_and_a_free_one_is_nobodys(kind: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
        if kind == "tcp":
            s.listen()
        assert holder_of(port, kind).startswith(f"process {os.getpid()} (")
    assert holder_of(port, kind) == UNKNOWN


def _fake(proc: Path, command: bytes, fds: dict[str, str]) -> None:
    (proc / "net").mkdir(parents=True)
    row = (
        "  12: 0100007F:4E20 00000000:0000 07 00000000:00000000 00:00000000 00000000  1000        0 777 2 0 0"
    )
    (proc / "net" / "udp").write_text(f"  sl  local_address ...\n{row}\nshort\n")
    (proc / "41" / "fd").mkdir(parents=True)
    (proc / "41" / "cmdline").write_bytes(command)
    for name, target in fds.items():
        (proc / "41" / "fd" / name).symlink_to(target)


def test_a_process_that_names_itself_with_control_characters_stays_on_its_line(tmp_path: Path) -> None:
    _fake(tmp_path, b"evil\x1b[2J\0a\nb\r\0" + b"x" * 500, {"3": "/dev/null", "4": "socket:[777]"})
    found = holder_of(20000, "udp", tmp_path)
    assert found == "process 41 (evil?[2J a?b? " + "x" * 106 + "...)"
    assert found.isprintable()


def test_where_nothing_can_be_read_it_is_another_program(tmp_path: Path) -> None:
    assert holder_of(20000, "udp", tmp_path / "none") == UNKNOWN
    _fake(tmp_path, b"", {"4": "socket:[778]"})
    assert holder_of(20000, "udp", tmp_path) == UNKNOWN
