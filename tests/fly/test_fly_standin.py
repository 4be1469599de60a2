"""`coaxlink fly` through MAVSDK against the stand-ins: logs down, refusals, the pilot's mode change."""

from __future__ import annotations

import contextlib
import io
import json
import os
import threading

import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil

from coaxlink.cli import main
from coaxlink.data import read_flight_log
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from sim.testing import standin, standins

PATIENT = 60.0  # s of wall time for a condition that comes within a few on an idle machine
OFFBOARD, POSITION = 6, 3  # main modes of PX4
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
    said, told, code = io.StringIO(), io.StringIO(), 0
    arguments = ["fly", "--connect", f"udpout:127.0.0.1:{port}", "--out", out, "--json", out / "fly.json"]
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        try:
            main([str(a) for a in (*arguments, *options)])
        except SystemExit as ended:
            code = int(ended.code or 0)
    found = json.loads((out / "fly.json").read_text()) if (out / "fly.json").is_file() else {}
    return code, said.getvalue(), told.getvalue(), found


@pytest.mark.parametrize(("firmware", "ending"), [("px4", "ulg"), ("ardupilot", "bin")])
def test_a_plan_is_flown_and_its_log_comes_down(tmp_path, firmware, ending):
    plan = tmp_path / "short.toml"
    plan.write_text('height_m = 3.0\n[[pieces]]\nwhat = "north"\nseconds = 4.0\nnorth_m = 2.0\n')
    with standin("--firmware", firmware, *WORLD) as port:
        lenient(port, firmware)
        code, said, told, found = fly(port, tmp_path, "--plan", plan, "--yes")
    assert code == 0, told
    assert said.startswith("flown: ") and "mavsdk" not in said.lower()
    assert found["result"] == "flown" and found["segments"] == ["settle", "north"]
    assert found["crc"] == "same" and found["log"].endswith(f"flight.{ending}")
    log = read_flight_log(tmp_path / f"flight.{ending}")
    assert 2.5 < log["height_m"].max() < 4.0
    assert log.has("motor1", "motor8")
    assert (tmp_path / "flight.tlog").stat().st_size > 10_000


def test_a_second_flight_brings_its_own_log_and_leaves_the_settings(tmp_path):
    """PX4 lists a card's logs by no age, and its take-off height is its owner's."""
    plans = [tmp_path / f"{seconds}.toml" for seconds in (2, 9)]
    for plan in plans:
        plan.write_text(f'height_m = 2.0\n[[pieces]]\nwhat = "wait"\nseconds = {plan.stem}.0\n')
    logs = []
    with standin(*WORLD) as port:
        lenient(port)
        for plan in plans:
            code, _, told, found = fly(port, tmp_path / plan.stem, "--plan", plan, "--yes")
            assert code == 0 and found["crc"] == "same", told
            logs.append(tmp_path / plan.stem / "flight.ulg")
        with connect(f"udpout:127.0.0.1:{port}") as session:
            assert Parameters(session).read("MIS_TAKEOFF_ALT").value == 2.5
    short, long = ((t := read_flight_log(log)["time_s"])[-1] - t[0] for log in logs)
    assert long > short + 5.0


def test_refusals_leave_the_motors_off(tmp_path):
    with standin(*WORLD) as port:
        unasked = fly(port, tmp_path)
        low = fly(port, tmp_path, "--battery", "0.949", "--yes", "--plan", "circle", "--reach", "40")
        checked = fly(port, tmp_path, "--dry-run")
        assert (unasked[0], low[0], checked[0]) == (4, 4, 0)
        assert "--yes" in unasked[2] and unasked[3]["result"] == "not armed"
        assert "distance reaches 40.0 m" in low[2]
        assert "nothing was armed" in checked[1]
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        beat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENT)
        assert beat is not None and not beat.base_mode & 128
        link.close()


def test_the_battery_limit_lands_and_the_log_still_comes(tmp_path):
    with standin(*WORLD) as port:
        lenient(port)
        code, _, told, found = fly(port, tmp_path, "--plan", "hover", "--yes", "--battery", "0.94")
    assert code == 4
    assert "battery at 93 %, 94 is the limit" in told
    assert found["result"] == "limit" and found["flown_s"] < 20.0
    assert found["crc"] == "same"


def test_the_pilots_mode_change_ends_it_at_once(tmp_path):
    with standins("--listen", "udpin:127.0.0.1:0", *WORLD) as ports:
        lenient(ports[-1])
        pilot = mavutil.mavlink_connection(f"udpout:127.0.0.1:{ports[0]}", source_system=255)
        taken = threading.Event()

        def take_over():
            while not taken.is_set():
                pilot.mav.heartbeat_send(6, 8, 0, 0, 4)
                beat = pilot.recv_match(type="HEARTBEAT", blocking=True, timeout=1.0)
                if beat is not None and beat.custom_mode >> 16 & 0xFF == OFFBOARD:
                    pilot.mav.command_long_send(1, 1, 176, 0, 1, POSITION, 0, 0, 0, 0, 0)

        thread = threading.Thread(target=take_over)
        thread.start()
        try:
            code, _, told, found = fly(ports[-1], tmp_path, "--plan", "hover", "--yes", "--no-log")
        finally:
            taken.set()
            thread.join()
        assert code == 1, told
        assert "its pilot or its own failsafe has it" in told and found["result"] == "pilot"
        # nobody took it back: still armed, in the pilot's mode
        beat = pilot.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENT)
        while beat is not None and beat.custom_mode >> 16 & 0xFF == OFFBOARD:
            beat = pilot.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENT)
        assert beat is not None and beat.base_mode & 128
        assert beat.custom_mode >> 16 & 0xFF == POSITION
        pilot.close()
