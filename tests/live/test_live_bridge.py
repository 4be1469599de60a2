"""The Lua bridge, run for real (lupa) in the stand-in ArduPilot: flown, silenced, fed nonsense, disarmed."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from live_flight import EXAMPLES, Companion, Flight, real_time
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.motor_test import turn_motors
from coaxlink.live.scripts.bridge import SCRIPT_NAME, bridge_script
from coaxlink.mavlink import connect
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

pytest.importorskip("lupa", reason="the stand-in runs scripts through lupa")
X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
GUIDED = 4


class Copter(Flight):
    firmware = "ardupilot"
    links = 2

    def prepare(self) -> None:
        a = self.autopilot
        a.scripts_start_s = 0.0  # no start to wait for
        a.store.write("SCR_ENABLE", 1.0)
        a.files.folders.add("scripts")
        a.files.files[f"scripts/{SCRIPT_NAME}"] = bridge_script(8).encode()
        a.boot()
        assert a.scripts.failed == ""

    def depart(self) -> None:
        self.autopilot.set_ap_mode(GUIDED)
        super().depart()

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.bridged)


@pytest.fixture(scope="module")
def copter() -> Any:
    vehicle = Copter()
    yield vehicle
    vehicle.close()


def test_a_script_is_for_one_to_eight_motors() -> None:
    assert "MOTORS, HOLD_MS, PERIOD_MS = 6, 100, 4" in bridge_script(6)
    with pytest.raises(InputError):
        bridge_script(9)
    with pytest.raises(InputError):
        bridge_script(8, hold_ms=5000)


@real_time
def test_the_companion_flies_ardupilot_through_the_bridge_and_silence_gives_it_back(copter: Any) -> None:
    copter.rows.clear()
    companion = Companion(copter)
    live = LiveMixer(companion.session, Vehicle(X8, CRM), "exact")
    starting = threading.Thread(target=live.start)
    starting.start()
    copter.fly(5.0, until=lambda: not starting.is_alive())
    copter.fly(3.0, until=lambda: copter.driven)
    copter.fly(1.5)
    assert live.error is None
    assert live.state in ("live", "fading")
    assert np.mean([row[1] for row in copter.rows[-300:]]) > 0.8
    sent = np.array(live.core.sent)
    assert np.array(copter.autopilot.command) == pytest.approx(sent, abs=0.03)
    assert copter.outputs_are_sound()
    companion.line.dead = True
    died = time.monotonic()
    copter.fly(0.4)
    handed = copter.own_since(died)
    assert handed is not None
    assert handed < 0.1 + 0.06
    live.session.tap = None
    companion.close()
    copter.rush(3.0)
    assert copter.lowest_m > 1.0
    assert copter.steepest_deg < 25.0
    assert not copter.autopilot.landed


@real_time
def test_what_is_not_whole_or_not_ours_never_reaches_an_output(copter: Any) -> None:
    companion = Companion(copter)
    good = [0.5] * 8
    for system, group, controls in (
        (1, 0, [math.nan, *good[1:]]),
        (1, 0, [*good[:7], 1.5]),
        (1, 0, [*good[:7], -0.1]),
        (1, 0, [math.inf] * 8),
        (1, 3, good),
        (9, 0, good),
    ):
        companion.session.send(
            mavlink.MAVLink_set_actuator_control_target_message(1, group, system, 1, controls)
        )
        copter.fly(0.05)
        assert not copter.driven
    companion.session.send(mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, good))
    copter.fly(0.05)
    assert copter.driven  # the same, whole and ours, does
    copter.fly(0.2)
    copter.autopilot.armed = False
    companion.session.send(mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, good))
    copter.fly(0.05)
    assert not copter.driven
    copter.autopilot.armed = True
    companion.close()
    copter.rush(4.0)


class Thief:
    """Four of five motor commands of a companion never reach the vehicle."""

    def __init__(self) -> None:
        self.passed = self.taken = 0

    def carry(self, data: bytes) -> list[bytes]:
        if data[0] == 0xFD and data[7] == 139 and data[50:51] != b"\xff":
            self.passed += 1
            if self.passed % 5:
                self.taken += 1
                return []
        return [data]

    def due(self) -> list[bytes]:
        return []


@pytest.mark.parametrize("stolen", [False, True])
@real_time
def test_the_bridge_counts_what_it_took_and_the_rest_never_arrived(copter: Any, stolen: bool) -> None:
    companion, thief = Companion(copter), Thief()
    live = LiveMixer(companion.session, Vehicle(X8, CRM), "exact")
    starting = threading.Thread(target=live.start)
    starting.start()
    copter.fly(5.0, until=lambda: not starting.is_alive())
    if stolen:
        copter.ports[0].peers[-1].back = thief
    copter.fly(2.0)
    summary = live.summary()
    live.session.tap = None
    companion.close()
    copter.rush(4.0)
    arrival = summary["arrival"]
    assert arrival["by"] == "bridge"
    assert arrival["sent"] > 50
    # a machine that stalls sends more than the script's queue of four holds
    if stolen:
        assert arrival["never_arrived"] == pytest.approx(thief.taken, rel=0.2)
        assert arrival["share"] > 0.6
    else:
        assert arrival["share"] < 0.1


@pytest.mark.parametrize("native", [False, True], ids=["plain", "compiled"])
@real_time
def test_a_second_companion_drives_nothing_and_lets_go_at_once(copter: Any, native: bool) -> None:
    from coaxlink.live import compiled

    if native and not compiled.available():
        pytest.skip("the compiled loop runs on 64-bit Linux")
    kernel = compiled.load() if native else None
    copter.autopilot.armed = True
    first, second = Companion(copter), Companion(copter, component=192)
    mixers = [LiveMixer(c.session, Vehicle(X8, CRM), "exact", native=kernel) for c in (first, second)]
    for mixer in mixers:
        starting = threading.Thread(target=mixer.start)
        starting.start()
        copter.fly(5.0, until=lambda started=starting: not started.is_alive())
        copter.fly(3.0, until=lambda m=mixer: m.failed.is_set() or copter.driven)
    copter.fly(0.5)
    assert mixers[1].failed.is_set()
    assert "another companion commands the motors (system 245 component 191)" in str(mixers[1].error)
    assert not mixers[0].failed.is_set()
    # whoever speaks on the second's behalf is not listened to while the first is there
    before = list(copter.autopilot.command)
    second.session.send(mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [1.0] * 8))
    copter.fly(0.05)
    assert copter.autopilot.command == pytest.approx(before, abs=0.1)
    # and is when the first has fallen silent
    first.line.dead = True
    copter.fly(0.3)
    assert not copter.driven
    second.session.send(mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, before))
    copter.fly(0.03)
    assert copter.driven
    for mixer, companion in zip(mixers, (first, second), strict=True):
        mixer.session.tap = None
        companion.close()
    copter.rush(5.0)
    assert not copter.autopilot.landed


@real_time
def test_the_demand_goes_where_a_companion_asks_for_it_and_nowhere_else(copter: Any) -> None:
    station, companion = Companion(copter, component=190), Companion(copter, link=1)
    heard: list[str] = []
    station.session.subscribe(lambda message: heard.append(message.get_type()))
    live = LiveMixer(companion.session, Vehicle(X8, CRM), "exact")
    starting = threading.Thread(target=live.start)
    starting.start()
    copter.fly(5.0, until=lambda: not starting.is_alive())
    assert copter.fly(3.0, until=lambda: copter.driven) < 3.0
    # nobody answers, a reminder a second is enough to be spoken to
    live.dry_run = True
    copter.fly(4.0)
    before = live.summary()["cycles"]
    copter.fly(0.5)
    assert not copter.driven
    assert live.summary()["cycles"] > before + 50
    assert "HEARTBEAT" in heard
    assert "ACTUATOR_CONTROL_TARGET" not in heard
    live.session.tap = None
    companion.session.subscribe(lambda message: heard.append(message.get_type()))
    copter.fly(3.5)
    assert "ACTUATOR_CONTROL_TARGET" in heard
    heard.clear()
    copter.fly(0.3)
    assert "ACTUATOR_CONTROL_TARGET" not in heard  # gone, and forgotten
    station.close()
    companion.close()
    copter.rush(3.0)


def test_without_a_bridge_ardupilot_is_refused() -> None:
    class Plain(Copter):
        def prepare(self) -> None:
            return

    plain = Plain(airborne=False)
    companion = Companion(plain)
    live = LiveMixer(companion.session, Vehicle(X8, CRM), "reduced")
    problem: list[Exception] = []

    def start() -> None:
        try:
            live.start()
        except SafetyRefusal as error:
            problem.append(error)

    starting = threading.Thread(target=start)
    starting.start()
    plain.fly(5.0, until=lambda: not starting.is_alive())
    companion.close()
    plain.close()
    assert "Lua bridge" in str(problem[0])


@real_time
def test_the_verb_mixes_on_ardupilot_where_the_bridge_is_heard(copter: Any) -> None:
    copter.rows.clear()
    codes: list[int] = []
    arguments = ["mix", str(EXAMPLES / "x8_demo.toml"), "--connect", copter.address, "--seconds", "1.0"]
    verb = threading.Thread(target=lambda: codes.append(run(build_app(), arguments)))
    verb.start()
    copter.fly(20.0, until=lambda: not verb.is_alive())
    assert codes == [0]
    assert sum(row[1] for row in copter.rows) > 50
    assert copter.outputs_are_sound()


def test_the_bridge_is_written_as_files_and_uploaded_like_a_table(tmp_path: Any) -> None:
    folder = tmp_path / "bridge"
    assert run(build_app(), ["bridge", str(EXAMPLES / "x8_demo.toml"), "--out", str(folder)]) == 0
    text = (folder / "scripts" / SCRIPT_NAME).read_text()
    assert text == bridge_script(8)

    class Plain(Copter):
        def prepare(self) -> None:
            self.autopilot.store.write("SCR_ENABLE", 1.0)
            self.autopilot.boot()

    plain = Plain(airborne=False)
    codes: list[int] = []
    arguments = ["upload", str(folder), "--connect", plain.address, "--yes", "--backup-dir", str(tmp_path)]
    verb = threading.Thread(target=lambda: codes.append(run(build_app(), arguments)))
    verb.start()
    plain.fly(40.0, until=lambda: not verb.is_alive())
    on_board = dict(plain.autopilot.files.files)
    plain.close()
    assert codes == [0]
    assert text.encode() in on_board.values()


@real_time
def test_each_motor_is_turned_by_its_number_whatever_the_frames_test_order() -> None:
    ground = Copter(airborne=False)
    ground.autopilot.store.write("FRAME_CLASS", 4.0)
    ground.autopilot.store.write("FRAME_TYPE", 1.0)
    ground.autopilot.boot()
    turning: list[tuple[int, list[int]]] = []

    def ask(number: int, where: str) -> bool:
        time.sleep(0.2)
        turning.append((number, [i + 1 for i, u in enumerate(ground.rows[-1][2]) if u > 0.05]))
        return True

    def work() -> None:
        with connect(ground.address) as session:
            turn_motors(session, replace(X8, rotors=X8.rotors[:2]), ask)

    thread = threading.Thread(target=work)
    thread.start()
    ground.fly(20.0, until=lambda: not thread.is_alive())
    thread.join(1.0)
    ground.close()
    assert turning == [(1, [1]), (2, [1, 2])]  # the first still turns: 1.5 s each
