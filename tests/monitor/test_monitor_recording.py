"""Recordings on the screen's clock: a tlog frame by frame, logs of samples as messages, leaps and speed."""

from __future__ import annotations

import asyncio
import struct
from pathlib import Path

import numpy as np
import pytest
from monitor_messages import INTEGERS, X8, attitude, battery, heartbeat, position, px4_table, servo
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.mavlink.clock import VirtualClock
from coaxlink.monitor.incoming.recording import FASTEST, Player, SampleLog, Tlog, load_recording
from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.watch import Watch

SECONDS = 120


@pytest.fixture(scope="module")
def tlog(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes at 10 Hz: parameters at the start, armed from 30 s on, a text at 40 s, a camera beside it,
    and a message that nobody here can read between any two."""
    path = tmp_path_factory.mktemp("tlog") / "flight.tlog"
    link, other = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 1, 100)
    with path.open("wb") as file:

        def record(message: object, at_s: float, by: object = link) -> None:
            file.write(struct.pack(">Q", round(1.7e15 + 1e6 * at_s)) + message.pack(by))
            by.seq = (by.seq + 1) % 256

        record(mavlink.MAVLink_heartbeat_message(30, 8, 0, 0, 0, 3), 0.0, other)
        record(heartbeat(armed=False), 0.0)
        for name, value in px4_table(73.06, 73.06).items():
            integer = name in INTEGERS
            bits = struct.pack("<i", int(value)) if integer else struct.pack("<f", value)
            number = struct.unpack("<f", bits)[0]
            record(mavlink.MAVLink_param_value_message(name.encode(), number, 6 if integer else 9, 9, 1), 0.1)
        for tick in range(10 * SECONDS):
            at = 0.5 + tick / 10
            pulse = 1400 + tick // 10
            if tick % 10 == 0:
                record(heartbeat(armed=at >= 30.0), at)
                record(battery(), at)
            if tick == 400:
                record(mavlink.MAVLink_statustext_message(6, b"Takeoff detected"), at)
            record(servo((pulse,) * 8), at)
            record(attitude(boot_ms=round(1e3 * at)), at)
            record(position(boot_ms=round(1e3 * at)), at)
            strange = bytearray(link_frame(link))
            file.write(struct.pack(">Q", round(1.7e15 + 1e6 * at)) + strange)
    return path


def link_frame(link: mavlink.MAVLink) -> bytes:
    """A frame of a message that is in no dialect, in sequence."""
    frame = struct.pack("<BBBBBBB", 0xFD, 4, 0, 0, link.seq, 1, 1) + (60000).to_bytes(3, "little") + bytes(6)
    link.seq = (link.seq + 1) % 256
    return frame


class Played:
    """A player on a clock that is turned, and its watch."""

    def __init__(self, recording: Tlog | SampleLog, **where: float) -> None:
        self.clock = VirtualClock()
        self.player = Player(recording, clock=self.clock.monotonic, **where)
        self.watch = Watch(self.player.heard, X8)

    def look(self, later_s: float = 0.0) -> Moment:
        self.player.advance()
        self.clock.sleep(later_s)
        self.player.advance()
        return self.watch.look()


def test_a_tlog_plays_by_its_recorder_s_clock_at_any_speed(tlog: Path) -> None:
    played = Played(load_recording(tlog), speed=4.0)
    player = played.player
    assert player.recording.length_s == pytest.approx(SECONDS + 0.4)
    assert not played.look().vehicle.armed
    view = played.look(10.0)  # four times as fast
    assert player.position_s == pytest.approx(40.0)
    assert view.vehicle.armed and view.link.state == "live" and view.link.loss == 0.0
    assert view.arms[0].upper.throttle == pytest.approx(0.439)
    assert view.board.kind == "standard" and view.board.upper_ct == pytest.approx(73.06)
    assert [t.text for t in view.texts] == []
    assert [t.text for t in played.look(0.5).texts] == ["Takeoff detected"]
    played.look(400.0)
    assert player.position_s == player.recording.length_s and not player.playing
    player.toggle()
    assert player.playing and player.position_s == 0.0


@pytest.mark.slow
def test_a_leap_shows_the_same_as_playing_there_and_knows_no_future(tlog: Path) -> None:
    recording = load_recording(tlog)
    played, leapt = Played(recording, speed=10.0), Played(recording, start_s=90.0)
    for _ in range(9):
        there = played.look(1.0)
    here = leapt.look()
    assert played.player.position_s == pytest.approx(90.0) and leapt.player.position_s == 90.0
    assert [a.upper for a in here.arms] == [a.upper for a in there.arms]
    assert here.board == there.board and here.vehicle == there.vehicle
    assert here.texts == there.texts
    leapt.player.seek(10.0)
    back = leapt.look()
    assert not back.vehicle.armed and back.texts == () and back.board.kind == "standard"
    leapt.player.seek(-5.0)
    assert leapt.player.position_s == 0.0
    leapt.player.scale(1e9)
    assert leapt.player.speed == FASTEST


def test_a_log_of_samples_shows_its_commands_without_rounding_and_no_mode() -> None:
    time = np.arange(0, 20, 0.004)
    columns = {"time_s": 5.0 + time, **{f"motor{n}": 0.4001 + 0.01 * time for n in range(1, 9)}}
    columns |= {f"{a}_rad": np.full_like(time, 0.1) for a in ("roll", "pitch", "yaw")}
    columns |= {f"rpm{n}": 0 * time + 2000.0 for n in range(1, 9)}
    columns |= {f"vel_{a}_m_s": 0 * time for a in "ned"} | {"landed": (time < 10).astype(float)}
    columns |= {"height_m": 0 * time + 3.0, "voltage_V": 0 * time + 24.0, "armed": (time > 10).astype(float)}
    texts = ((17.0, 4, "low battery"),)
    board = px4_table(73.06, 73.06)
    log = SampleLog("a.ulg", [Samples(columns, "a.ulg", parameters=board, texts=texts)], 12)
    played = Played(log, start_s=5.0)
    view = played.look()
    assert view.arms[0].upper.throttle == pytest.approx(0.4501, abs=2e-4) and not view.vehicle.armed
    assert view.vehicle.mode == "" and view.vehicle.height_m == 3.0 and view.vehicle.voltage_V == 24.0
    assert view.board.kind == "standard" and view.vehicle.clock_s == pytest.approx(10.0, abs=0.03)
    assert view.arms[0].upper.rpm == 2000.0 and "a log of samples" in view.notes[-1]
    later = played.look(8.0)
    assert later.vehicle.armed and [t.text for t in later.texts] == ["low battery"]


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    start = struct.pack(">Q", 10**15)
    camera = mavlink.MAVLink_heartbeat_message(30, 8, 0, 0, 0, 3).pack(mavlink.MAVLink(None, 1, 100))
    for data in (b"", b"not a log", start + b"\xfd", start + b"x" * 60, start + camera):
        path.write_bytes(data)
        with pytest.raises(InputError):
            load_recording(path)


@pytest.mark.slow
def test_keys_of_a_replay(tlog: Path) -> None:
    async def story() -> None:
        played = Played(load_recording(tlog))
        player, app = played.player, Monitor(played.look, player=played.player)
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.press("space")
            stopped = player.position_s
            assert not player.playing
            await pilot.press("full_stop", "greater_than_sign", "comma", "right_square_bracket")
            assert player.position_s == pytest.approx(stopped + 60.0) and player.speed == 2.0
            await pilot.press("g", *"x", "enter")
            assert len(app.screen_stack) == 2  # no time: asked again
            await pilot.press("backspace", *"1:30", "enter")
            await pilot.pause()
            assert player.position_s == 90.0
            app.draw()
            head = str(app.query_one("#head").visual)
            assert "stopped" in head and "1:30.0 / 2:00.4 x2" in head and "ARMED" in head

    asyncio.run(story())
