"""`coaxlink fly` as a process against the stand-ins on ports: their logs come down through MAVSDK.

What needs no MAVSDK is flown in memory, in test_fly_commands.py.
"""

from __future__ import annotations

import contextlib
import io
import json

import pytest

from coaxlink.cli import main
from coaxlink.data import read_flight_log
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from sim.testing import standin

pytestmark = pytest.mark.slow
WORLD = ("--speed", "4")
# what a world four times as fast would take for a lost link, or for a vehicle forgotten on the ground,
# whenever this machine is busy for a moment
REAL, SHORT = 9, 2  # MAVLink's types of parameters
LENIENT = {
    "px4": {"COM_OF_LOSS_T": (60.0, REAL), "COM_DISARM_PRFLT": (-1.0, REAL)},
    "ardupilot": {"GUID_TIMEOUT": (60.0, REAL), "DISARM_DELAY": (0, SHORT)},
}


def lenient(port, firmware="px4"):
    """A stand-in that bears a busy machine."""
    with connect(f"udpout:127.0.0.1:{port}") as session:
        for name, (value, kind) in LENIENT[firmware].items():
            Parameters(session).write(name, value, kind)


def fly(port, out, *options):
    """Exit code, stdout, stderr and the JSON of one call."""
    reported, determined, code = io.StringIO(), io.StringIO(), 0
    arguments = ["fly", "--connect", f"udpout:127.0.0.1:{port}", "--out", out, "--json", out / "fly.json"]
    with contextlib.redirect_stdout(reported), contextlib.redirect_stderr(determined):
        try:
            main([str(a) for a in (*arguments, *options)])
        except SystemExit as ended:
            code = int(ended.code or 0)
    found = json.loads((out / "fly.json").read_text()) if (out / "fly.json").is_file() else {}
    return code, reported.getvalue(), determined.getvalue(), found


def test_a_plan_is_flown_and_its_log_comes_down(tmp_path):
    plan = tmp_path / "short.toml"
    plan.write_text('height_m = 3.0\n[[pieces]]\nwhat = "north"\nseconds = 4.0\nnorth_m = 2.0\n')
    with standin("--firmware", "ardupilot", *WORLD) as port:
        lenient(port, "ardupilot")
        code, reported, determined, found = fly(port, tmp_path, "--plan", plan, "--yes")
    assert code == 0, determined
    assert reported.startswith("flown: ") and "mavsdk" not in reported.lower()
    assert found["result"] == "flown" and found["segments"] == ["settle", "north"]
    assert found["crc"] == "same" and found["log"].endswith("flight.bin")
    log = read_flight_log(tmp_path / "flight.bin")
    assert 2.5 < log["height_m"].max() < 4.0
    assert log.has("motor1", "motor8")


def test_a_second_flight_brings_its_own_log_and_leaves_the_settings(tmp_path):
    """PX4 lists a card's logs by no age, and its take-off height is its owner's."""
    plans = [tmp_path / f"{seconds}.toml" for seconds in (2, 9)]
    for plan in plans:
        plan.write_text(f'height_m = 2.0\n[[pieces]]\nwhat = "wait"\nseconds = {plan.stem}.0\n')
    logs = []
    with standin(*WORLD) as port:
        lenient(port)
        for plan in plans:
            code, _, determined, found = fly(port, tmp_path / plan.stem, "--plan", plan, "--yes")
            assert code == 0 and found["crc"] == "same", determined
            logs.append(tmp_path / plan.stem / "flight.ulg")
            assert found["log"] == str(logs[-1]) and read_flight_log(logs[-1]).has("motor1", "motor8")
        with connect(f"udpout:127.0.0.1:{port}") as session:
            assert Parameters(session).read("MIS_TAKEOFF_ALT").value == 2.5
    short, long = ((t := read_flight_log(log)["time_s"])[-1] - t[0] for log in logs)
    assert long > short + 5.0
