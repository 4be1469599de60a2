"""The Lua bridge, run for real (lupa) in the stand-in ArduPilot: flown, silenced, fed nonsense, disarmed."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from live_flight import CRM, EXAMPLES, X8, Companion, Flight
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.bridge import board_factors
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.motor_test import Seen, turn_motors
from coaxlink.live.onboard.ardupilot import SCRIPT_NAME, bridge_script
from coaxlink.tables.ardupilot import report_ap
from coaxlink.uploading.ardupilot_scripts import ScriptFolder, is_table
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.table import used_factors
from firmware_params.errors import TableError

pytest.importorskip("lupa", reason="the stand-in runs scripts through lupa")
GUIDED = 4
FOLDER = scripts.SCRIPT_FOLDERS[0]
slow = pytest.mark.slow


class Copter(Flight):
    firmware, links = "ardupilot", 2
    scripts: dict[str, str] = {SCRIPT_NAME: bridge_script(8)}  # noqa: RUF012
    params: dict[str, float] = {}  # noqa: RUF012

    def prepare(self) -> None:
        a = self.autopilot
        a.scripts_start_s = 0.0  # no start to wait for
        a.store.write("SCR_ENABLE", 1.0)
        for name, value in self.params.items():
            a.store.write(name, value)
        a.boot()  # the loader's own parameters are not there before its script has run
        a.files.folders.add("scripts")
        a.files.files.update({f"scripts/{name}": text.encode() for name, text in self.scripts.items()})
        a.boot()
        for name, value in self.params.items():
            a.store.write(name, value)
        assert a.scripts.failed == ""

    def depart(self) -> None:
        self.autopilot.set_ap_mode(GUIDED)
        super().depart()

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.bridged)


@pytest.fixture(scope="module")
def in_the_air() -> Copter:
    return Copter()


@pytest.fixture
def copter(in_the_air: Copter) -> Iterator[Copter]:
    in_the_air.rows.clear()
    yield in_the_air
    for companion in list(in_the_air.companions.values()):
        companion.close()
    in_the_air.companions.clear()
    in_the_air.stays_up(4.0)


def command(controls: list[float], system: int = 1, group: int = 0) -> Any:
    return mavlink.MAVLink_set_actuator_control_target_message(1, group, system, 1, controls)


def test_a_script_is_for_one_to_eight_motors() -> None:
    assert "MOTORS, HOLD_MS, PERIOD_MS = 6, 100, 4" in bridge_script(6)
    for motors, hold_ms in ((9, 100), (0, 100), (8, 5000)):
        with pytest.raises(InputError):
            bridge_script(motors, hold_ms=hold_ms)


@slow
def test_the_companion_flies_ardupilot_through_the_bridge_and_silence_gives_it_back(copter: Copter) -> None:
    companion = Companion(copter)
    live = companion.mix()
    companion.until_live(live)
    copter.fly(1.5)
    assert live.error is None and all(row.driven for row in copter.rows)
    assert np.array(copter.autopilot.command) == pytest.approx(np.array(live.core.sent), abs=0.03)
    arrival = live.summary()["arrival"]
    assert arrival["by"] == "bridge" and arrival["sent"] > 350 and arrival["share"] < 0.01
    companion.line.dead = True
    died = copter.clock.now
    copter.fly(0.4)
    handed = copter.own_since(died)
    assert handed is not None and handed < 0.1 + 0.012


@slow
def test_what_is_not_whole_or_not_ours_never_reaches_an_output(copter: Copter) -> None:
    companion, good = Companion(copter), [0.5] * 8
    bad = [
        command([math.nan, *good[1:]]), command([*good[:7], 1.5]), command([*good[:7], -0.1]),
        command([math.inf] * 8), command(good, group=3), command(good, system=9),
    ]  # fmt: skip
    for message in bad:
        companion.session.send(message)
        copter.fly(0.05)
        assert not copter.driven, message
    companion.session.send(command(good))
    copter.fly(0.05)
    assert copter.driven  # the same, whole and ours, does
    copter.fly(0.2)
    copter.autopilot.armed = False
    companion.session.send(command(good))
    copter.fly(0.05)
    assert not copter.driven
    copter.autopilot.armed = True


@slow
def test_what_a_line_loses_the_bridge_did_not_count(copter: Copter) -> None:
    companion, draw, stolen = Companion(copter), random.Random(5), []

    def steal(data: bytes) -> bool:
        lost = data[0] == 0xFD and data[7] == 139 and data[50:51] != b"\xff" and draw.random() < 0.8
        stolen.extend([1] * lost)
        return lost

    live = companion.mix()
    companion.line.steal = steal
    copter.fly(2.0)
    arrival = live.summary()["arrival"]
    assert arrival["by"] == "bridge" and arrival["share"] > 0.7
    assert arrival["never_arrived"] == pytest.approx(len(stolen), abs=5)
    assert live.arrival is not None and live.arrival.noteworthy


@slow
def test_a_second_companion_drives_nothing_and_lets_go_at_once(copter: Copter) -> None:
    first, second = Companion(copter), Companion(copter, component=192)
    live = first.mix()
    first.until_live(live)
    late = second.mix()
    copter.fly(0.5)
    assert isinstance(late.error, SafetyRefusal) and "system 245 component 191" in str(late.error)
    assert late.core.counters.cycles == 0
    assert live.error is None and all(row.driven for row in copter.rows)


@slow
def test_of_two_with_the_same_ids_the_second_knows_that_it_is_not_followed(copter: Copter) -> None:
    first, twin = Companion(copter), Companion(copter, link=1)
    live = first.mix()
    first.until_live(live)
    late = twin.mix()
    copter.fly(1.5)  # its question goes out anew each second
    assert isinstance(late.error, SafetyRefusal) and "our own ids" in str(late.error)
    assert late.core.counters.cycles == 0
    assert live.error is None and all(row.driven for row in copter.rows)
    first.line.dead = True
    copter.fly(0.3)
    heir = Companion(copter, link=1)
    heir.until_live(heir.mix())
    assert copter.driven


@slow
def test_the_demand_goes_where_a_companion_asks_for_it_and_nowhere_else(copter: Copter) -> None:
    station, companion = Companion(copter, component=190), Companion(copter, link=1)
    heard: list[str] = []
    station.session.subscribe(lambda message: heard.append(message.get_type()))
    live = companion.mix()
    companion.until_live(live)
    # nobody answers, a reminder a second is enough to be spoken to
    live.dry_run = True
    copter.fly(4.0)
    before = live.summary()["cycles"]
    copter.fly(0.5)
    assert not copter.driven and live.summary()["cycles"] > before + 100
    assert "HEARTBEAT" in heard and "ACTUATOR_CONTROL_TARGET" not in heard
    companion.session.tap = None
    companion.session.subscribe(lambda message: heard.append(message.get_type()))
    copter.fly(3.5)
    assert "ACTUATOR_CONTROL_TARGET" in heard
    heard.clear()
    copter.fly(0.3)
    assert "ACTUATOR_CONTROL_TARGET" not in heard  # gone, and forgotten


@slow
def test_without_a_bridge_ardupilot_is_refused() -> None:
    class Plain(Copter):
        scripts = {}  # noqa: RUF012

    with pytest.raises(SafetyRefusal, match="Lua bridge"):
        Companion(Plain(airborne=False)).mix()


@slow
def test_each_motor_is_turned_by_its_number_whatever_the_frames_test_order() -> None:
    class Frame(Copter):
        params = {"FRAME_CLASS": 4.0, "FRAME_TYPE": 1.0}  # noqa: RUF012

    ground, turning = Frame(airborne=False), []

    def ask(number: int, where: str) -> Seen:
        ground.fly(0.2)
        turning.append((number, [i + 1 for i, u in enumerate(ground.rows[-1].commands) if u > 0.05]))
        return Seen((number,))

    turn_motors(Companion(ground).session, replace(X8, rotors=X8.rotors[:2]), ask)
    assert turning == [(1, [1]), (2, [1, 2])]  # the first still turns: 1.5 s each


@slow
@pytest.mark.parametrize("frame_class", [15, 17])
def test_the_companion_reads_the_factors_of_a_scripted_frame_from_the_board(frame_class: int) -> None:
    report = report_ap(Vehicle(X8, CRM), "fitted", frame_class=frame_class)

    class Scripted(Copter):
        scripts = {**report.scripts, SCRIPT_NAME: bridge_script(8)}  # noqa: RUF012
        params = {k: v for k, v in report.params.items() if k != "SCR_LD_CHECKSUM"}  # noqa: RUF012

    ground = Scripted(airborne=False)
    ground.fly(0.5)
    found = np.array(board_factors(Companion(ground).session))
    assert found == pytest.approx(np.array(ground.autopilot.mixer.mix.factors), abs=2e-6)
    assert found == pytest.approx(used_factors(report.table), abs=2e-6)


@pytest.mark.slow
def test_half_a_table_or_anothers_is_not_read() -> None:
    report = report_ap(Vehicle(X8, CRM), "fitted")
    (text,) = report.scripts.values()
    factors = pytest.approx(np.array(report.table.factors), abs=1e-6)
    params = scripts.loader_params(report.table.factors)
    assert np.array(scripts.script_factors(text)) == factors
    assert np.array(scripts.params_factors(params)) == factors
    for read, damaged, problem in (
        (scripts.script_factors, text.replace("500000", "400000", 1), "no mixer table"),
        (scripts.script_factors, "return 1", "no mixer table"),
        (scripts.params_factors, {**params, "CXL_R1": 0.1}, "half a table"),
        (scripts.params_factors, {"CXL_N": 8.0}, "missing"),
    ):
        with pytest.raises(TableError, match=problem):
            read(damaged)  # type: ignore[operator]


class Board:
    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files

    def listing(self, folder: str) -> list[str]:
        return [n.rpartition("/")[2] for n in self.files]

    def read(self, path: str) -> bytes | None:
        return self.files.get(path)

    def crc(self, path: str) -> int:
        return scripts.file_crc(self.files[path])


def test_a_bridge_leaves_the_table_on_board_and_counts_it_in_the_checksum() -> None:
    table, bridge = b"-- a table", b"-- a bridge"
    board: Any = Board({f"{FOLDER}/{scripts.MATRIX_NAME}": table})
    folder = ScriptFolder(board)
    bridged = folder.planned({SCRIPT_NAME: bridge}, table=is_table([SCRIPT_NAME]))
    assert bridged == {f"{FOLDER}/{SCRIPT_NAME}": bridge}
    assert folder.checksum(bridged) == scripts.load_checksum([table, bridge])
    other = folder.planned({scripts.LOADER_NAME: b"x"}, table=is_table([scripts.LOADER_NAME]))
    assert other[f"{FOLDER}/{scripts.MATRIX_NAME}"] is None
    assert folder.checksum(other) == scripts.load_checksum([b"x"])


@slow
def test_the_bridge_is_written_as_files_and_uploaded_like_a_table(tmp_path: Any) -> None:
    from pathlib import Path

    from coaxlink.uploading.journal import Journal
    from coaxlink.uploading.plan import load_plan
    from coaxlink.uploading.worker import Uploader

    folder = tmp_path / "bridge"
    assert run(build_app(), ["bridge", str(EXAMPLES / "x8_demo.toml"), "--out", str(folder)]) == 0
    text = (folder / "scripts" / SCRIPT_NAME).read_text()
    assert text == bridge_script(8)

    class Plain(Copter):
        scripts = {}  # noqa: RUF012

    ground = Plain(airborne=False)
    session = Companion(ground).session
    journal = Journal(session.identity, Path(tmp_path))
    outcome = Uploader(session, backup_folder=tmp_path, journal=journal).upload(load_plan(folder))
    assert outcome.result == "verified"
    assert text.encode() in ground.autopilot.files.files.values()


def test_a_mixer_needs_as_many_rotors_as_the_frame_on_board() -> None:
    from live_line import Session

    live = LiveMixer(Session(), Vehicle(X8, CRM))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="8 rotors here, 6 in the frame"):
        live.core.use_matrix([[0.1] * 4] * 6)
