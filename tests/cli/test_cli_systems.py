"""A recording of two vehicles, given to every verb that reads one: all are named, `--system` says which."""

from __future__ import annotations

import struct

import pytest
from case_table import case_table
from cli_runs import coaxlink
from pymavlink.dialects.v20 import common

from coaxlink.files import example


@pytest.fixture
def recording(tmp_path):
    """Ten seconds of systems 3 and 7, without a flight that anything could be judged by."""
    path = tmp_path / "two.tlog"
    with path.open("wb") as file:
        for k in range(200):
            for system in (3, 7) if k < 190 else (3,):
                sender = common.MAVLink(None, srcSystem=system, srcComponent=1)
                messages = [
                    common.MAVLink_heartbeat_message(2, 3, 128, 0, 4, 3),
                    common.MAVLink_attitude_message(50 * k + 1000 * system, 0.01 * system, 0, 0, 0, 0, 0),
                    common.MAVLink_servo_output_raw_message(50_000 * k, 0, *[1500] * 8),
                    common.MAVLink_param_value_message(b"FRAME_CLASS", 4.0, 9, 2, 0),
                    common.MAVLink_param_value_message(b"FRAME_TYPE", 1.0, 9, 2, 1),
                ]
                for message in messages:
                    file.write(struct.pack(">Q", round(1.7e15 + 50_000 * k)) + message.pack(sender))
    return path


def test_every_verb_that_reads_a_recording_takes_its_vehicle(recording, tmp_path):
    x8, rotor = example("x8_paper.toml"), example("rotor_paper.toml")
    verbs = {
        "health": [recording, "--airframe", x8],
        "refine": [recording, "--airframe", x8],
        "report": [recording, "--out", tmp_path / "r.html"],
        "identify": [recording, "--airframe", x8, "--rotor", rotor],
        "init": [tmp_path / "v.toml", "--from", recording, "--mass", 20],
        "monitor": ["--replay", recording, "--airframe", x8, "--once"],
    }
    with case_table() as case:
        for verb, arguments in verbs.items():
            with case(verb):
                run = coaxlink(verb, *arguments, "--system", 9)
                assert run.code == 2 and "--system 9: is not in this tlog: found 3 (" in run.err
                assert ") and 7 (" in run.err and run.err.count("\n") == 1
                run = coaxlink(verb, *arguments, "--system", 300)
                assert run.code == 2 and "a system id from 1 to 255 is expected, found 300" in run.err
    shown = coaxlink("monitor", *verbs["monitor"])
    assert shown.code == 0 and "3 is read, which sent the most; --system takes another" in " ".join(
        (shown.out + shown.err).split()
    )
    made = coaxlink("init", *verbs["init"], "--arm", 0.3, "--spacing", 0.1, "--system", 7)
    assert made.code == 0 and "7 is read" in made.err
