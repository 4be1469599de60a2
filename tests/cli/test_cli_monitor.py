"""`coaxlink monitor` from the outside: exit codes, one line each, and the headless look."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "monitor"))
from monitor_vehicle import Vehicle

from coaxlink.studies.simulator import free_port


def coaxlink(*arguments: str, timeout: float = 40.0) -> subprocess.CompletedProcess[str]:
    code = "from coaxlink.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, "monitor", *arguments],
        capture_output=True,
        text=True,
        timeout=timeout,
        stdin=subprocess.DEVNULL,
    )


def one_line(result: subprocess.CompletedProcess[str], code: int, part: str) -> None:
    assert result.returncode == code, result.stderr
    assert len(result.stderr.splitlines()) == 1 and part in result.stderr
    assert result.stdout == ""


def test_one_look_at_a_vehicle(tmp_path: Path) -> None:
    port, target = free_port(), tmp_path / "look.json"
    with Vehicle(port):
        result = coaxlink(
            "--once", "--seconds", "1.5", "--connect", f"udpin:127.0.0.1:{port}", "--json", str(target)
        )
    assert result.returncode == 0, result.stderr
    assert "front right" in result.stdout and "ARMED" in result.stdout
    look = json.loads(target.read_text())
    assert look["link"]["state"] == "live"
    assert look["speeds"]["source"] == "SERVO_OUTPUT_RAW"
    assert look["arms"][0]["upper_share"] == pytest.approx(0.42, abs=0.02)
    assert look["balance"]["of_weight"] == pytest.approx(1.0, abs=0.01)


def test_nobody_there() -> None:
    result = coaxlink("--once", "--seconds", "0.5", "--connect", f"udpin:127.0.0.1:{free_port()}")
    one_line(result, 3, "no autopilot heard")


def test_bad_address() -> None:
    one_line(coaxlink("--connect", "carrier-pigeon"), 2, "carrier-pigeon")


def test_busy_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        one_line(coaxlink("--connect", f"udpin:127.0.0.1:{holder.getsockname()[1]}"), 3, "in use")


def test_no_terminal() -> None:
    one_line(coaxlink("--connect", f"udpin:127.0.0.1:{free_port()}"), 2, "--once")


def test_bad_airframe(tmp_path: Path) -> None:
    path = tmp_path / "air.toml"
    path.write_text("name = 3\n")
    one_line(coaxlink("--airframe", str(path)), 2, "air.toml")
    one_line(coaxlink("--rotor", str(tmp_path / "none.toml")), 2, "none.toml")
