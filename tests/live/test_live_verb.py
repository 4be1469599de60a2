"""`coaxlink mix` as users run it, on a stand-in in flight: dry run, record, plots, sharing, motor test."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import slow_clock
from live_flight import EXAMPLES, Flight, real_time
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.motor_test import mount, turn_motors
from coaxlink.live.record import MAGIC, RECORD, LiveRecord, read_record
from coaxlink.mavlink import connect

AIRFRAME = str(EXAMPLES / "x8_demo.toml")


@pytest.fixture(scope="module")
def flight() -> Iterator[Flight]:
    vehicle = Flight()
    yield vehicle
    vehicle.close()


def mix(flight: Flight, *options: str) -> int:
    """Run the verb beside the ticking vehicle; its exit code."""
    flight.back_to_hover()
    codes: list[int] = []
    arguments = ["mix", AIRFRAME, "--connect", flight.address, *options]
    thread = threading.Thread(target=lambda: codes.append(run(build_app(), arguments)))
    thread.start()
    flight.fly(20.0, until=lambda: not thread.is_alive())
    thread.join(1.0)
    return codes[0]


@real_time
def test_a_dry_run_shows_everything_and_moves_nothing(flight: Flight, tmp_path: Path) -> None:
    result = tmp_path / "mix.json"
    assert mix(flight, "--dry-run", "--seconds", "0.8", "--json", str(result)) == 0
    assert not any(row[1] for row in flight.rows)
    summary = json.loads(result.read_text())
    assert summary["dry_run"]
    assert summary["cycles"] > 50
    assert max(summary["allocation_error"]["max"]) < 1e-4
    assert summary["law"] == "exact"


@real_time
def test_forged_vehicles_at_a_hundred_a_second_take_nothing_away(
    flight: Flight, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stop, heard = threading.Event(), set[str]()
    beat = mavlink.MAVLink_heartbeat_message(14, 12, 0, 0, 4, 3)
    rival = mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8)
    packer, parser = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None)

    def forge() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.bind(("127.0.0.1", 0))
            line.settimeout(0.01)
            while not stop.is_set():
                for peer in list(flight.ports[0].peers):
                    for message in (beat, rival):
                        line.sendto(message.pack(packer), peer.address)
                try:
                    heard.update(m.get_type() for m in parser.parse_buffer(line.recv(2048)) or [])
                except TimeoutError:
                    continue

    thread, result = threading.Thread(target=forge), tmp_path / "mix.json"
    thread.start()
    try:
        assert mix(flight, "--seconds", "2", "--json", str(result)) == 0
    finally:
        stop.set()
        thread.join()
    summary = json.loads(result.read_text())
    assert summary["not_believed"] > 50 and not summary["why"]
    driven = [live for _, live, *_ in flight.rows]
    first = driven.index(True)
    assert sum(driven[first : first + 400]) > 380  # 1.6 s from the first command on: every one arrives
    assert "SET_ACTUATOR_CONTROL_TARGET" not in heard
    assert "not believed: heartbeats of system 1" in capfd.readouterr().err


@real_time
def test_a_live_run_is_recorded_plotted_and_shared(flight: Flight, tmp_path: Path) -> None:
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ground.bind(("127.0.0.1", 0))
    ground.settimeout(0.01)
    where = f"127.0.0.1:{ground.getsockname()[1]}"
    heard: dict[str, Any] = {}
    parser, stop, sent = mavlink.MAVLink(None), threading.Event(), []
    parser.robust_parsing = True

    def listen() -> None:
        packer = mavlink.MAVLink(None, 255, 190)
        while not stop.is_set():
            try:
                data, peer = ground.recvfrom(65536)
            except TimeoutError:
                continue
            for message in parser.parse_buffer(data) or []:
                heard[message.get_type()] = message
            if not sent:
                ask = mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_THR_HOVER", -1)
                ground.sendto(ask.pack(packer), peer)
                rival = mavlink.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8)
                sent.append(ground.sendto(rival.pack(packer), peer))

    thread = threading.Thread(target=listen)
    thread.start()
    code = mix(flight, "--seconds", "1.2", "--record", str(tmp_path), "--plot", "--forward", where)
    stop.set()
    thread.join()
    ground.close()
    assert code == 0
    driven = [row for row in flight.rows if row[1]]
    assert len(driven) > 50
    assert flight.outputs_are_sound()
    assert min(min(row[2]) for row in driven) > 0.1  # the ground station's zeros never reached the motors
    assert {"HEARTBEAT", "ATTITUDE", "PARAM_VALUE", "NAMED_VALUE_FLOAT", "DEBUG_FLOAT_ARRAY"} <= set(heard)
    assert sum(heard["DEBUG_FLOAT_ARRAY"].data[:8]) == pytest.approx(20 * 9.80665, rel=0.2)
    header, rows = read_record(tmp_path / "mix.live")
    assert header["law"] == "exact"
    assert len(rows) > 50
    assert (np.diff(rows["stamp_us"].astype(np.int64)) > 0).all()
    assert ((rows["commands"] >= 0) & (rows["commands"] <= 1)).all()
    assert np.abs(rows["error"]).max() < 1e-3
    assert (tmp_path / "mix.tlog").stat().st_size > 10_000


@real_time
def test_the_record_of_a_killed_process_reaches_up_to_its_last_second(flight: Flight, tmp_path: Path) -> None:
    flight.back_to_hover()
    command = slow_clock.command("mix", AIRFRAME, "--connect", flight.address)
    process = subprocess.Popen(
        [*command, "--record", str(tmp_path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        flight.fly(15.0, until=lambda: flight.driven)
        flight.fly(1.0)
        assert flight.driven
        last_us = round(1e6 * flight.autopilot.reading.time_s) + 1_000_000
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    _, rows = read_record(tmp_path / "mix.live")
    assert last_us - int(rows["stamp_us"][-1]) < 600_000
    data = (tmp_path / "mix.tlog").read_bytes()
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    stamps = [m.time_usec for m in parser.parse_buffer(data) or [] if m.get_type() == "HIGHRES_IMU"]
    assert last_us - stamps[-1] < 600_000


def test_a_cut_record_is_read_to_its_last_whole_row_and_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.live"
    record = LiveRecord(path, {"law": "x"})
    for k in range(3):
        record.add(k, 0.5 * k, [0.1] * 4, [0.2] * 8, [0.3] * 4, 1e-4, "live")
    record.close()
    content = path.read_bytes()
    assert len(content) == len(MAGIC) + len('{"law": "x"}\n') + 3 * RECORD.size
    path.write_bytes(content[:-5])
    header, rows = read_record(path)
    assert header == {"law": "x"}
    assert rows["stamp_us"].tolist() == [0, 1]
    assert rows["commands"][1] == pytest.approx([0.2] * 8)
    path.write_bytes(b"something else\n{}\n")
    with pytest.raises(InputError, match="not a live record"):
        read_record(path)


@real_time
def test_motors_are_turned_one_by_one_on_the_ground_and_never_when_armed(flight: Flight) -> None:
    frame = load_airframe(EXAMPLES / "x8_demo.toml")
    assert mount(frame.rotors[0]) == "front right, upper, counter-clockwise from above"
    assert mount(frame.rotors[7]) == "rear left, lower, clockwise from above"
    ground = Flight(airborne=False)
    turned: list[float] = []
    execute = ground.standin.autopilot
    done = threading.Event()
    answers: list[Any] = []
    motors: list[int] = []

    def work() -> None:
        with connect(ground.address) as session:
            session.subscribe(lambda m: turned.append(m.command) if m.get_type() == "COMMAND_ACK" else None)

            def ask(number: int, where: str) -> bool:
                motors.append(number)
                return number != 3

            answers.extend(turn_motors(session, frame, ask))
            execute.arm()
            session.wait("HEARTBEAT", 3.0, lambda m: m.base_mode & 128)
            with pytest.raises(SafetyRefusal, match="armed"):
                turn_motors(session, frame, ask)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    ground.fly(15.0, until=lambda: not thread.is_alive())
    thread.join(1.0)
    ground.close()
    assert done.is_set()
    assert motors == list(range(1, 9))
    assert [a.number for a in answers if not a.right] == [3]
    assert turned.count(310) == 8


@real_time
def test_it_mixes_over_a_serial_line(flight: Flight) -> None:
    flight.back_to_hover()
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    host, _, port = flight.address.removeprefix("udpout:").rpartition(":")
    link.connect((host, int(port)))
    link.settimeout(0.01)
    stop = threading.Event()

    def to_line() -> None:
        link.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 244, 1)))
        while not stop.is_set():
            try:
                os.write(ours, link.recv(65536))
            except OSError:
                continue

    def from_line() -> None:
        while not stop.is_set():
            try:
                link.send(os.read(ours, 4096))
            except OSError:
                return

    threads = [threading.Thread(target=work, daemon=True) for work in (to_line, from_line)]
    for thread in threads:
        thread.start()
    code: list[int] = []
    arguments = ["mix", AIRFRAME, "--connect", f"{os.ttyname(theirs)},921600", "--seconds", "1.0"]
    verb = threading.Thread(target=lambda: code.append(run(build_app(), arguments)))
    verb.start()
    flight.fly(20.0, until=lambda: not verb.is_alive())
    stop.set()
    time.sleep(0.05)
    os.close(theirs)
    os.close(ours)
    link.close()
    assert code == [0]
    assert sum(row[1] for row in flight.rows) > 50
    assert flight.outputs_are_sound()
