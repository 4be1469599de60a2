"""`coaxlink monitor` from the outside: exit codes and one line each. A look at a vehicle: tests/monitor."""

from __future__ import annotations

import json
import socket
import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.cli import main
from coaxlink.files import example
from coaxlink.studies.simulator import free_port

X8 = str(example("x8_paper.toml"))


def one_line(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, part: str) -> None:
    with pytest.raises(SystemExit) as left:
        main(["monitor", *arguments])
    out, err = capsys.readouterr()
    assert left.value.code == code, err
    assert len(err.splitlines()) == 1 and part in err and out == ""


def test_what_cannot_be_done_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "air.toml").write_text("name = 3\n")
    (tmp_path / "text.tlog").write_text("no log")
    here = f"udpin:127.0.0.1:{free_port()}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        busy = f"udpin:127.0.0.1:{holder.getsockname()[1]}"
        for arguments, code, part in (
            (["--connect", "carrier-pigeon"], 2, "carrier-pigeon"),
            (["--connect", busy], 3, "in use"),
            (["--connect", here], 2, "--once"),  # no terminal
            (["--airframe", str(tmp_path / "air.toml")], 2, "air.toml"),
            (["--rotor", str(tmp_path / "none.toml")], 2, "none.toml"),
            (["--replay", str(tmp_path / "text.tlog"), "--airframe", X8], 2, "text.tlog"),
            (["--replay", str(tmp_path / "text.tlog")], 2, "--airframe is needed"),
        ):
            one_line(capsys, arguments, code, part)


@pytest.mark.slow
def test_nobody_there(capsys: pytest.CaptureFixture[str]) -> None:
    here = f"udpin:127.0.0.1:{free_port()}"
    one_line(capsys, ["--once", "--seconds", "0.5", "--connect", here], 3, "no autopilot heard")


def test_one_look_into_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tlog, target = tmp_path / "flight.tlog", tmp_path / "look.json"
    link = mavlink.MAVLink(None, 1, 1)
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 128, 3 << 16, 4, 3)
    outputs = mavlink.MAVLink_servo_output_raw_message(1000, 0, *[1441] * 4, *[1648] * 4, *[0] * 8)
    frames = [message.pack(link) for message in (beat, outputs)]
    with tlog.open("wb") as file:
        for k in range(20):
            for frame in frames:
                file.write(struct.pack(">Q", 1_700_000_000_000_000 + 100_000 * k) + frame)
    with pytest.raises(SystemExit) as left:
        main(["monitor", "--replay", str(tlog), "--airframe", X8, "--start", "1.5", "--json", str(target)])
    assert left.value.code in (0, None)
    out = capsys.readouterr().out
    assert "ARMED" in out and "flight.tlog 0:01.5 / 0:01.9" in out
    look = json.loads(target.read_text())
    assert look["speeds"]["source"] == "SERVO_OUTPUT_RAW"
    assert look["arms"][0]["upper_share"] == pytest.approx(0.42, abs=0.02)
    assert look["balance"]["of_weight"] == pytest.approx(1.0, abs=0.01)
