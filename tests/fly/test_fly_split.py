"""The split plan: its order, its law, and a hover of it on the stand-in PX4 1.13, ended in every way."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from live_flight import CRM, EXAMPLES, X8, Flight, LiveLine
from memory_net import plugged
from pymavlink.dialects.v20 import common as m
from verb import run

from coaxlink.errors import InputError
from coaxlink.fly.split_flight import split_on_board
from coaxlink.fly.split_plan import DWELL_S, RAMP_S, PowerRecord, SplitPlan
from coaxlink.live.onboard.ardupilot import SCRIPT_NAME, bridge_script
from coaxlink.mavlink import connect
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mixer.split import SplitLaw, equal_share, split_levels, table_of, upper_share
from coaxlink.tables.ardupilot import report_ap
from coaxlink.vehicle import Vehicle

LEVELS = (0.4, 0.45, 0.5, 0.55, 0.6)
POSITION, GUIDED = 3, 4  # main mode of PX4, mode of ArduCopter
VEHICLE = Vehicle(X8, CRM)
HOVER = [X8.mass_kg * 9.80665, 0.0, 0.0, 0.0]


def test_a_steady_drift_is_no_part_of_the_order() -> None:
    plan = SplitPlan(LEVELS, 0.5, 40)
    flown = np.array([plan.level(DWELL_S * (k + 0.5)) for k in range(40)])
    assert abs(np.corrcoef(flown, np.arange(40))[0, 1]) < 0.2
    assert np.abs(np.diff(flown)).max() < 0.06
    assert {float(v) for v in flown} == set(LEVELS)
    assert all(np.count_nonzero(flown == level) == 8 for level in LEVELS)


def test_the_share_begins_and_ends_on_board_without_a_jump() -> None:
    plan = SplitPlan(LEVELS, 0.5, 13)
    t = np.arange(0.0, plan.duration_s + 1.0, 0.01)
    share = np.array([plan.share(x) for x in t])
    assert share[0] == share[-1] == 0.5
    assert np.abs(np.diff(share)).max() <= 0.2 * 0.011 / RAMP_S


def test_nothing_is_kept_before_and_after_the_hover_nor_a_current_that_is_not_measured() -> None:
    record = PowerRecord(Telemetry(lambda: 0.0), SplitPlan(LEVELS, 0.5, 14))

    def battery(amps: int) -> None:
        for reported in (
            m.MAVLink_attitude_message(0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0),
            m.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25),
            m.MAVLink_battery_status_message(0, 0, 0, 0, [4000] * 6 + [65535] * 4, amps, 0, 0, 90),
        ):
            record.telemetry.hear(reported)
            record.hear(reported)

    battery(5000)
    record.now_s = 19.0
    battery(5000)
    battery(-1)
    record.now_s = float("nan")
    battery(5000)
    assert record.rows == [(1, 19.0, pytest.approx(24.0 * 50.0), 0.55, 0.25, pytest.approx(0.01))]


@pytest.fixture(scope="module")
def levels():
    return split_levels(VEHICLE, equal_share(VEHICLE), 0.08, 5)


def test_the_law_delivers_the_wrench_at_every_split_and_between(levels) -> None:
    law = SplitLaw(levels, levels[0].share)
    for share in np.linspace(levels[0].share, levels[-1].share, 9):
        law.share = float(share)
        u = law.speeds([HOVER[0] * 1.05, 2.0, -1.5, 0.5])
        wrench = X8.wrench(*X8.loads(CRM, u))
        assert wrench == pytest.approx([HOVER[0] * 1.05, 2.0, -1.5, 0.5], abs=0.02 * HOVER[0])
        assert upper_share(VEHICLE, law.speeds(HOVER)) == pytest.approx(share, abs=0.01)


def test_a_table_of_a_split_flies_it() -> None:
    from coaxlink.mixer.fitted import FittedLaw

    law = FittedLaw(VEHICLE, table_of(VEHICLE, 0.6))
    assert upper_share(VEHICLE, law.speeds(HOVER)) == pytest.approx(0.6, abs=0.01)
    with pytest.raises(InputError, match="can be had"):
        table_of(VEHICLE, 0.99)


def fly(flight: Flight, capsys, tmp_path: Path, *options: str):
    """Exit code, stdout, stderr and the JSON of one call."""
    path = tmp_path / "fly.json"
    words = ("fly", "--plan", "split", "--connect", flight.url(), "--out", str(tmp_path), "--json", str(path))
    frame = ("--airframe", str(EXAMPLES / "x8_demo.toml"), "--no-log", "--yes")
    with plugged(flight.net):
        code, out, err = run(capsys, *words, *frame, *options)
    return code, out, err, json.loads(path.read_text()) if path.is_file() else {}


@pytest.mark.slow
def test_refusals_come_before_arming(capsys, tmp_path) -> None:
    flight = Flight(airborne=False)
    flight.autopilot.store.write("THR_MDL_FAC", 9, 0.0)
    code, _, err, _ = fly(flight, capsys, tmp_path)
    assert code == 4 and "THR_MDL_FAC" in err and "--tables" in err
    flight.autopilot.store.write("THR_MDL_FAC", 9, 1.0)
    code, _, err, _ = fly(flight, capsys, tmp_path, "--minutes", "1")
    assert code == 2 and "4.2 at least" in err
    assert not flight.autopilot.armed


@pytest.mark.slow
def test_the_split_of_a_table_on_board_is_where_the_next_flight_begins() -> None:
    report = report_ap(VEHICLE, "fitted", fit=table_of(VEHICLE, 0.62))

    class Tabled(Flight):
        firmware = "ardupilot"

        def prepare(self) -> None:
            a = self.autopilot
            a.scripts_start_s = 0.0
            a.store.write("SCR_ENABLE", 1.0)
            for name, value in report.params.items():
                if name != "SCR_LD_CHECKSUM":
                    a.store.write(name, value)
            a.files.folders.add("scripts")
            texts = {**report.scripts, SCRIPT_NAME: bridge_script(8)}
            a.files.files.update({f"scripts/{name}": text.encode() for name, text in texts.items()})
            a.boot()

    flight = Tabled(airborne=False)
    line = LiveLine(flight.net, flight.addresses[0])
    with connect(flight.url(), transport=line, clock=flight.clock) as session:
        found, trial = split_on_board(session, VEHICLE)
    assert trial is None
    assert found == pytest.approx(0.62, abs=0.01)
    flight.autopilot.set_ap_mode(GUIDED)
    flight.autopilot.arm()
    flight.autopilot.take_off(4.0)
    flight.clock.sleep(12.0)
    level = np.array([rotor.level for rotor in X8.rotors])
    thrust = flight.autopilot.plant.thrust
    assert thrust[level == "upper"].sum() / thrust.sum() == pytest.approx(found, abs=0.01)  # as it flies
