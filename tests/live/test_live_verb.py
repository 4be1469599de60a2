"""`coaxlink mix` as users run it, on a stand-in in flight, in memory: what it says, writes and ends with."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_flight import EXAMPLES, Faults, Flight, LiveLine
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.cli import build_app
from coaxlink.cli.mix import _line, _lost
from coaxlink.cli.shared.shell import run
from coaxlink.data.logs.live_record import MAGIC, RECORD, read_record
from coaxlink.errors import InputError
from coaxlink.live.record import LiveRecord
from coaxlink.mavlink.opening import connect

AIRFRAME = str(EXAMPLES / "x8_demo.toml")


class Verb:
    """The verb beside a vehicle; its clock is the vehicle's."""

    def __init__(self, flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
        self.flight, self.line = flight, Faults()
        monkeypatch.setattr("coaxlink.mavlink.connect", self._connect)
        monkeypatch.setattr("coaxlink.live.health_watch.ASK_AFTER_S", 1e6)  # it has a thread and a real clock

    def _connect(self, url: str, **options: Any) -> Any:
        line = LiveLine(self.flight.net, self.flight.addresses[0])
        self.flight.companions[line.address] = self
        return connect(url, transport=line, clock=self.flight.clock, **options)

    def __call__(self, *options: str) -> int:
        self.flight.rows.clear()
        return run(build_app(), ["mix", AIRFRAME, "--connect", self.flight.url(), *options])


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight()


@pytest.fixture
def mix(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> Verb:
    flight.fly(2.0)
    return Verb(flight, monkeypatch)


@pytest.mark.slow
def test_a_dry_run_shows_everything_and_moves_nothing(mix: Verb, tmp_path: Path, capsys: Any) -> None:
    result = tmp_path / "mix.json"
    assert mix("--dry-run", "--seconds", "0.8", "--json", str(result)) == 0
    assert not any(row.driven for row in mix.flight.rows)
    summary = json.loads(result.read_text())
    assert summary["dry_run"] and summary["law"] == "exact" and summary["cycles"] > 150
    assert max(summary["allocation_error"]["max"]) < 1e-4
    assert {"word", "why", "calls"} < set(summary["health"])
    reported = capsys.readouterr()
    assert "exact (dry run)" in reported.out and "no motor command is sent" in reported.err


@pytest.mark.slow
def test_a_live_run_is_recorded(mix: Verb, tmp_path: Path) -> None:
    assert mix("--seconds", "1.2", "--record", str(tmp_path)) == 0
    driven = [row for row in mix.flight.rows if row.driven]
    assert len(driven) > 200 and mix.flight.outputs_are_sound()
    header, rows = read_record(tmp_path / "mix.live")
    assert header["law"] == "exact" and len(rows) > 200
    assert (np.diff(rows["stamp_us"].astype(np.int64)) > 0).all()
    assert ((rows["commands"] >= 0) & (rows["commands"] <= 1)).all() and np.abs(rows["error"]).max() < 1e-3
    assert (tmp_path / "mix.tlog").stat().st_size > 10_000


@pytest.mark.slow
def test_interrupted_it_hands_the_vehicle_back(mix: Verb, capsys: Any) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    mix.flight.clock.later(4.0, interrupt)
    assert mix() == 0
    assert "the autopilot flies its own mixer again" in capsys.readouterr().err
    assert mix.flight.rows[-500].driven
    mix.flight.fly(0.2)
    assert not mix.flight.driven


@pytest.mark.slow
def test_a_link_that_is_lost_is_exit_code_3(mix: Verb, capsys: Any) -> None:
    mix.flight.clock.later(3.0, lambda: setattr(mix.line, "dead", True))
    assert mix("--lost", "1") == 3
    assert "no word of the vehicle for 1 s" in capsys.readouterr().err


@pytest.mark.slow
def test_commands_that_never_arrive_are_told_and_exit_code_1(mix: Verb, capsys: Any) -> None:
    draw = random.Random(3)
    mix.flight.clock.later(2.5, lambda: setattr(mix.line, "steal", lambda data: draw.random() < 0.7))
    assert mix("--seconds", "8") == 1
    assert "motor commands never arrived" in capsys.readouterr().err


@pytest.mark.slow
def test_a_loop_that_fails_is_exit_code_1_and_another_companion_4(mix: Verb, capsys: Any) -> None:
    clock, rival = (
        mix.flight.clock,
        mavlink.MAVLink_set_actuator_control_target_message(1, 0, 1, 1, [0.5] * 8),
    )
    frame = bytes(rival.pack(mavlink.MAVLink(None, 1, 192)))

    def intrude() -> None:
        for address in mix.flight.companions:
            mix.flight.net.send(frame, mix.flight.addresses[0], address)

    clock.later(3.0, intrude)
    assert mix() == 4
    assert "another companion commands the motors" in capsys.readouterr().err
    broken = {"name": "exact", "dropped": (), "speeds": lambda self, wrench: 1 / (wrench[1] == 0)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("coaxlink.live.mixer_core.live_law", lambda *_: type("Law", (), broken)())
        assert mix() == 1
    assert "live mixing stopped itself and fell silent" in capsys.readouterr().err


def test_wrong_words_are_exit_code_2(capsys: Any) -> None:
    for words in (["--law", "none"], ["--rate", "0"]):
        assert run(build_app(), ["mix", AIRFRAME, "--connect", "udpout:127.0.0.1:9", *words]) == 2
        assert words[0] in capsys.readouterr().err


def test_what_never_arrived_in_words() -> None:
    arrival = {"sent": 1000, "never_arrived": 800, "share": 0.8, "by": "timesync"}
    assert _lost(arrival).startswith("about 800 of 1000 motor commands never arrived (80 %")
    assert _lost({**arrival, "by": "bridge"}).startswith("800 of 1000")
    summary = {
        "law": "exact", "dry_run": False, "state": "live", "cycles": 1000, "seconds": 4.0, "rate_hz": 250.0,
        "latency_us": {"p50": 100.0, "p99": 300.0}, "allocation_error": {"mean": [0.0] * 4},
        "unanswered": {"late": 3}, "not_believed": 7, "arrival": arrival, "board": None,
    }  # fmt: skip
    assert _line(summary).endswith("unanswered 3, never arrived 800, 7 datagrams under its ids not believed")


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
