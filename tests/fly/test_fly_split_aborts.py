"""Ends of a split flight on both stand-ins: how soon the split on board flies again, and the height lost.

`pytest -s` prints the figures of docs/measured.md. A companion that is killed is, in memory, one that neither
hears nor says anything any more; a process that really is, is the last test's.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from live_flight import EXAMPLES, HEIGHT_M, TICK_S, Faults, Flight
from memory_net import Line, plugged
from pymavlink.dialects.v20 import common as m
from verb import run

from coaxlink.live.onboard.ardupilot import SCRIPT_NAME, bridge_script
from coaxlink.mavlink import connect
from sim.effects import HiddenEffect
from sim.simulation import Simulation, build, open_links
from sim.truth import Truth

BACK_S = 0.5  # asked for
LOST_M = 0.4  # what the same vehicle loses at any hand-over, docs/live.md
SECOND_S = 1.0  # in which the height is looked at: a landing sinks by less than that
FLOOR = 0.93  # of the charge; said in whole per cent
FRAME = EXAMPLES / "x8_demo.toml"
FLOWN = 500  # ticks flown by the companion before it is killed
PATIENCE_S = 60.0  # for a verb that starts on a busy machine
PX4_POSITION, AP_LOITER = 3, 5  # main mode, custom mode
pytestmark = pytest.mark.slow


class Aborted(Flight):
    """A flight whose line may die; where the vehicle is, is kept."""

    pilots_mode: float = PX4_POSITION

    def __init__(self) -> None:
        self.line, self.places, self.pilots = Faults(), [], set()
        super().__init__(airborne=False)
        self.companions = Everybody(self)

    def _tick(self) -> None:
        super()._tick()
        plant = self.autopilot.plant
        self.places.append((self.clock.now, *plant.position.tolist(), plant.charge))

    def since(self, came: Callable[[tuple[float, ...]], bool]) -> float:
        """When a place first was so."""
        return next(place[0] for place in self.places if came(place))

    def settled(self) -> bool:
        """Whether the companion has flown for ten seconds."""
        return len(self.rows) > 2500 and all(row.driven for row in self.rows[-2500:])


class AbortedCopter(Aborted):
    firmware, pilots_mode = "ardupilot", AP_LOITER

    def prepare(self) -> None:
        a = self.autopilot
        a.scripts_start_s = 0.0
        a.store.write("SCR_ENABLE", 1.0)
        a.boot()
        a.files.folders.add("scripts")
        a.files.files[f"scripts/{SCRIPT_NAME}"] = bridge_script(8).encode()
        a.boot()

    @property
    def driven(self) -> bool:
        return bool(self.autopilot.bridged)


class Everybody(dict[Any, Any]):
    """All but the pilot are on the line that may die."""

    def __init__(self, flight: Aborted) -> None:
        super().__init__()
        self._flight = flight

    def get(self, source: Any, default: Any = None) -> Any:
        on_line = source not in self._flight.pilots
        return SimpleNamespace(line=self._flight.line) if on_line else default


def grabbed(flight: Aborted) -> float:
    """The pilot's mode change."""
    line = Line(flight.net, flight.addresses[0])
    flight.pilots.add(line.address)
    pilot = connect(flight.url(), transport=line, clock=flight.clock, source_system=255, source_component=190)
    pilot.send(m.MAVLink_command_long_message(1, 1, 176, 0, 1, flight.pilots_mode, 0, 0, 0, 0, 0))
    return flight.clock.now


def blown(flight: Aborted) -> None:
    """A gust that no position loop holds."""
    now = flight.autopilot.plant.time_s
    flight.autopilot.truth = Truth((HiddenEffect("wind", 40.0, now, {"direction_deg": 30.0}, "steady"),))


def unplugged(flight: Aborted) -> float:
    """The link dies, both ways."""
    flight.line.dead = True
    return flight.clock.now


def fly(flight: Aborted, capsys: Any, tmp_path: Path, act: Callable[[Aborted], Any], *options: Any) -> Any:
    """Exit code, what `fly` said, its JSON, and what `act` gave; it acts once the companion flies."""
    gave: list[Any] = []

    def look() -> None:
        if flight.settled():
            gave.append(act(flight))
        else:
            flight.clock.later(0.1, look)

    look()
    path = tmp_path / "fly.json"
    words = ["fly", "--plan", "split", "--connect", flight.url(), "--airframe", FRAME, "--minutes", 4.3]
    words += ["--no-log", "--yes", "--out", tmp_path, "--json", path, *options]
    with plugged(flight.net):
        code, _, err = run(capsys, *words)
        flight.clock.sleep(2.0)
    return code, err, json.loads(path.read_text()), gave[0] if gave else None


def determined(flight: Aborted, firmware: str, what: str, cause_s: float) -> tuple[float, float]:
    """Seconds until the board's own mixer flies for good, metres lost in a second from then."""
    back = flight.own_since(cause_s)
    assert back is not None, "the companion still flies it"
    at = next(row.height_m for row in flight.rows if row.time_s >= cause_s)
    after = [r.height_m for r in flight.rows if cause_s <= r.time_s <= cause_s + back + SECOND_S]
    lost = max(at - min(after), 0.0)
    sys.stdout.write(f"\n{firmware}, {what}: the split on board after {back:.3f} s, {lost:.2f} m lost\n")
    return back, lost


BOTH = pytest.mark.parametrize(("firmware", "kind"), [("PX4 1.13", Aborted), ("ArduCopter", AbortedCopter)])


@BOTH
def test_the_pilots_mode_change(capsys, tmp_path, firmware, kind) -> None:
    flight = kind()
    code, err, found, cause_s = fly(flight, capsys, tmp_path, grabbed)
    back, lost = determined(flight, firmware, "mode change", cause_s)
    assert code == 1 and found["result"] == "pilot" and "why" in found["split"], err
    assert back < BACK_S and lost < LOST_M and flight.rows[-1].height_m > 2.0


@BOTH
def test_the_battery_below_its_floor(capsys, tmp_path, firmware, kind) -> None:
    flight = kind()
    code, err, found, _ = fly(flight, capsys, tmp_path, lambda _: None, "--battery", FLOOR)
    cause_s = flight.since(lambda place: round(100 * place[4]) < 100 * FLOOR)
    back, lost = determined(flight, firmware, "battery", cause_s)
    assert code == 4 and found["result"] == "limit" and "battery" in found["why"], err
    assert back < BACK_S and lost < SECOND_S and not flight.autopilot.armed
    driven = [row.driven for row in flight.rows]
    last = len(driven) - driven[::-1].index(True)
    assert flight.rows[last].height_m > 2.0  # the landing was flown by the board


@BOTH
def test_a_gust_beyond_the_limits(capsys, tmp_path, firmware, kind) -> None:
    flight = kind()
    code, err, found, _ = fly(flight, capsys, tmp_path, blown)
    cause_s = flight.since(lambda place: math.hypot(place[1], place[2]) > 3.0)
    back, lost = determined(flight, firmware, "gust", cause_s)
    assert code == 4 and found["result"] == "limit" and "off its set-point" in found["why"], err
    assert back < BACK_S and lost < SECOND_S


@BOTH
def test_the_link_dies_or_the_companion(capsys, tmp_path, firmware, kind) -> None:
    flight = kind()
    code, err, found, cause_s = fly(flight, capsys, tmp_path, unplugged)
    back, lost = determined(flight, firmware, "dead link, killed companion", cause_s)
    assert code == 3 and found["result"] == "link" and "why" in found["split"], err
    assert back < BACK_S and lost < LOST_M


def test_a_process_that_is_killed(tmp_path) -> None:
    """Through real sockets, the vehicle in step with the machine's clock."""
    ports = open_links(["udpin:127.0.0.1:0"])
    standin = build(Simulation(FRAME, firmware="px4:1.13"), ports)
    vehicle = standin.autopilot
    vehicle.store.write("THR_MDL_FAC", 9, 1.0)

    def ticks_until(came: Callable[[], bool], seconds: float) -> int:
        due = time.monotonic()
        for count in range(round(seconds / TICK_S)):
            if came():
                return count
            standin.tick()
            due = max(due + TICK_S, time.monotonic() - TICK_S)
            time.sleep(max(due - time.monotonic(), 0.0))
        raise AssertionError(f"not within {seconds:g} s")

    url = "udpout:" + ports[0].name.partition(":")[2]
    words = [sys.executable, "-m", "coaxlink", "fly", "--plan", "split", "--connect", url, "--airframe"]
    words += [str(FRAME), "--no-log", "--yes", "--out", str(tmp_path)]
    with (tmp_path / "said.txt").open("w") as reported:
        process = subprocess.Popen(words, stdout=reported, stderr=reported)
    try:
        ticks_until(lambda: vehicle.plant.height > HEIGHT_M / 2, PATIENCE_S)
        flown = itertools.count()
        ticks_until(lambda: vehicle.live and next(flown) > FLOWN, PATIENCE_S)
        os.kill(process.pid, signal.SIGKILL)
        height_m = vehicle.plant.height
        assert TICK_S * ticks_until(lambda: not vehicle.live, BACK_S) < BACK_S
        lowest = min(height_m, *(_ticked(standin) for _ in range(round(SECOND_S / TICK_S))))
        sys.stdout.write(f"\nPX4 1.13, SIGKILL: {height_m - lowest:.2f} m lost\n")
        assert height_m - lowest < LOST_M
    finally:
        process.kill()
        process.wait()
        for port in ports:
            port.close()


def _ticked(standin: Any) -> float:
    standin.tick()
    return float(standin.autopilot.plant.height)
