"""The monitor against the stand-in autopilots in processes of their own, flying."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from test_monitor_board import table

import coaxlink as cx
from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.fly.commands import Commander
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.monitor.feed import Feed
from coaxlink.monitor.state import View
from coaxlink.monitor.watch import Watch
from coaxlink.rotor import load_rotor_model
from sim.testing import standin


def until(look: Callable[[], View], met: Callable[[View], bool], timeout_s: float = 120.0) -> View:
    end = time.monotonic() + timeout_s
    while not met(view := look()):
        assert time.monotonic() < end, f"not seen in time: {view}"
        time.sleep(0.1)
    return view


def test_a_hover_and_an_upload_are_seen() -> None:
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(files.example("rotor_paper.toml"))
    with standin("--speed", "4") as port:
        address = f"udpout:127.0.0.1:{port}"
        watch = Watch(address, cx.Vehicle(airframe, model))
        feed = Feed(watch)
        feed.start()

        def look() -> View:
            return watch.look(time.monotonic())

        try:
            ground = until(look, lambda v: v.board.state == "read" and v.balance.thrust_N is not None)
            assert ground.vehicle is not None and not ground.vehicle.armed
            assert ground.balance.thrust_N == 0.0 and ground.board.kind == "standard"
            with connect(address) as session:
                parameters = Parameters(session)
                for name, value in table(73.06, 73.06, km=1.9 / 73.06).items():
                    parameters.write(name, value, 6 if name.endswith(("COUNT", "AIRFRAME", "METHOD")) else 9)
                vehicle = Commander(session)
                vehicle.arm()
                vehicle.take_off(3.0)
            hover = until(
                look, lambda v: v.board.digest != ground.board.digest and v.balance.error is not None
            )
            time.sleep(0.5)
            hover = look()
        finally:
            feed.stop()
    assert feed.failure is None
    assert hover.speeds.source == "ESC_STATUS rpm" and hover.speeds.basis == "measured"
    assert hover.vehicle is not None and hover.vehicle.armed and hover.link.state == "live"
    # it hovers, so the thrust is its weight; equal speeds leave the lower rotors the smaller part
    assert hover.balance.of_weight == pytest.approx(1.0, abs=0.06)
    assert hover.balance.upper_share == pytest.approx(0.66, abs=0.03)
    assert hover.board.upper_ct == pytest.approx(73.06)


@contextmanager
def watched(address: str) -> Iterator[Callable[[], View]]:
    airframe = load_airframe(files.example("x8_paper.toml"))
    watch = Watch(address, cx.Vehicle(airframe, load_rotor_model(files.example("rotor_paper.toml"))))
    feed = Feed(watch)
    feed.start()
    try:
        yield lambda: watch.look(time.monotonic())
    finally:
        feed.stop()
    assert feed.failure is None


def coaxlink(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", "coaxlink", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_what_px4_s_simulation_says_of_its_escs_is_passed_over_in_hover() -> None:
    with standin("--esc", "sitl", "--airframe", str(files.example("x8_paper.toml"))) as port:
        address = f"udpout:127.0.0.1:{port}"
        with watched(address) as look, connect(address) as session:
            ground = until(look, lambda v: v.balance.thrust_N is not None)
            assert ground.speeds.source == "ESC_STATUS rpm"
            vehicle = Commander(session)
            vehicle.arm()
            vehicle.take_off(3.0)
            hover = until(look, lambda v: "passed over" in " ".join(v.notes), 40.0)
            until(look, lambda v: abs((v.balance.of_weight or 0.0) - 1.0) < 0.04)
    assert hover.speeds.source == "SERVO_OUTPUT_RAW" and "the weight is 196 N" in hover.notes[0]


@pytest.mark.parametrize("frame", ["15", "17"])
def test_an_ardupilot_is_read_like_a_px4(tmp_path: Path, frame: str) -> None:
    """Battery, table (script or loader), ESCs, of a vehicle that streams nothing by itself."""
    table, airframe = tmp_path / "table", str(files.example("x8_paper.toml"))
    made = ["--firmware", "ardupilot", "--law", "reduced", "--frame-class", frame, "--out", str(table)]
    coaxlink("table", airframe, *made)
    with standin("--firmware", "ardupilot", "--airframe", airframe) as port:
        address = f"udpout:127.0.0.1:{port}"
        with watched(address) as look:
            before = until(look, lambda v: v.board.state == "read")
            assert (before.board.kind, before.board.frame_class) == ("standard", 4)
            coaxlink("upload", str(table), "--connect", address, "--yes", "--backup-dir", str(tmp_path))
            until(look, lambda v: v.board.kind == "reduced" and v.board.of_model, 60.0)
            with connect(address) as session:
                vehicle = Commander(session)
                vehicle.arm()
                vehicle.take_off(3.0)
                hover = until(
                    look,
                    lambda v: (
                        v.balance.error is not None
                        and abs((v.balance.of_weight or 0.0) - 1.0) < 0.04
                        and v.speeds.basis == "measured"
                        and v.vehicle is not None
                        and v.vehicle.voltage_V is not None
                    ),
                    40.0,
                )
    assert hover.speeds.source == "ESC_TELEMETRY rpm" and hover.board.frame_class == int(frame)
    assert hover.vehicle is not None and hover.vehicle.armed and hover.vehicle.firmware == "ArduPilot"
    assert hover.board.digest != before.board.digest and not any("mavlink id" in n for n in hover.notes)


def test_an_ardupilot_s_simulated_escs_read_nothing_and_streams_come_back_after_a_restart() -> None:
    with standin("--firmware", "ardupilot", "--esc", "sitl") as port:
        address = f"udpout:127.0.0.1:{port}"
        with watched(address) as look:
            until(look, lambda v: v.balance.thrust_N is not None and v.vehicle is not None)
            with connect(address) as session:
                assert session.command(246, 1.0) == 0  # it restarts and forgets what was asked of it
            time.sleep(2.0)
            again = until(look, lambda v: v.speeds_age_s is not None and v.speeds_age_s < 1.0, 40.0)
    assert again.vehicle is not None and again.vehicle.text.find("No ap_message") < 0
