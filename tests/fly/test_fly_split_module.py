"""The split plan on the stand-in PX4 whose module tries shares by itself: flown, answered, ended."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live_flight import CRM, EXAMPLES, X8, Faults, Flight
from memory_net import Line, plugged
from pymavlink.dialects.v20 import common as m
from verb import run

from coaxlink.cli.sim import _module, coax_firmware
from coaxlink.live.onboard.description import board_law
from coaxlink.live.onboard.px4 import module_files
from coaxlink.mavlink import connect
from coaxlink.vehicle import Vehicle
from sim.px4.autopilot import Mode
from sim.vehicle import LOWER

FRAME = EXAMPLES / "x8_demo.toml"
BACK_S = 0.5  # asked for, from an abort until the split on board flies
LOST_M = 0.4
VEHICLE = Vehicle(X8, CRM)
OWN = 0.424  # of the exact law with eq. 17, by `test_live_px4_share`'s bisection
pytestmark = pytest.mark.slow


class Board(Flight):
    """The share that the plant's rotors give, tick by tick; a line that may die."""

    firmware = "px4:1.16"

    def __init__(self, **params: float) -> None:
        self.params, self.seen, self.line, self.pilots = params, [], Faults(), set()
        super().__init__(airborne=False)
        self.companions = Everybody(self)

    def prepare(self) -> None:
        a = self.autopilot
        a.firmware_module = coax_firmware(VEHICLE)
        a.store.write("MPC_THR_HOVER", 9, board_law(VEHICLE).hover)
        a.files.files["etc/extras.txt"] = module_files(board_law(VEHICLE), "tests")["etc/extras.txt"].encode()
        a.boot()
        for name, value in self.params.items():
            a.store.write(name, 9, value)
        a.boot()

    def _tick(self) -> None:
        super()._tick()
        plant = self.autopilot.plant
        upper = np.asarray(plant.vehicle.level) != LOWER
        share = plant.thrust[upper].sum() / max(plant.thrust.sum(), 1e-9)
        self.seen.append((self.clock.now, float(share), plant.height, self.autopilot.mode))

    def far_s(self) -> float:
        """How long the share has been 0.03 or more from the law's own, in the plan."""
        last = [row[1] for row in self.seen[-2500:]]
        return 10.0 if len(last) == 2500 and min(abs(s - OWN) for s in last[-1250:]) > 0.03 else 0.0


class Everybody(dict[Any, Any]):
    """All but the pilot are on the line that may die."""

    def __init__(self, flight: Board) -> None:
        super().__init__()
        self._flight = flight

    def get(self, source: Any, default: Any = None) -> Any:
        on_line = source not in self._flight.pilots
        return SimpleNamespace(line=self._flight.line) if on_line else default


def fly(flight: Board, capsys: Any, tmp_path: Path, act: Any = None, *options: Any) -> Any:
    gave: list[float] = []

    def look() -> None:
        if flight.far_s() > 1.0 and flight.autopilot.mode == Mode.OFFBOARD:
            act(flight)
            gave.append(flight.clock.now)
        else:
            flight.clock.later(0.1, look)

    if act:
        look()
    path = tmp_path / "fly.json"
    words = ["fly", "--plan", "split", "--connect", flight.url(), "--airframe", FRAME, "--minutes", 4.3]
    words += ["--no-log", "--yes", "--out", tmp_path, "--json", path, "--battery", 0.1, *options]
    with plugged(flight.net):
        code, out, err = run(capsys, *words)
        flight.clock.sleep(2.0)
    return code, out + err, json.loads(path.read_text()) if path.exists() else {}, gave


def back(flight: Board, since: float, share: float = OWN) -> tuple[float, float]:
    """Seconds until the plant's share is that on board for good, and metres lost until a second later."""
    rows = [row for row in flight.seen if since <= row[0] < since + 3.0]
    off = [row[0] for row in rows if abs(row[1] - share) > 0.01]
    took = max(off) - since if off else 0.0
    lost = rows[0][2] - min(row[2] for row in rows if row[0] < since + took + 1.0)
    sys.stdout.write(f"\nthe share on board after {took:.2f} s, {lost:.2f} m lost\n")
    return took, lost


def test_it_is_flown_by_the_parameter_about_the_share_on_board_and_answered(
    capsys: Any, tmp_path: Path
) -> None:
    flight = Board(COAX_SHARE=0.5)
    code, said, found, _ = fly(flight, capsys, tmp_path, None)
    assert code == 0, said
    assert "COAX_SHARE_TRY" in said and "companion is silent" not in said
    assert flight.autopilot.module.taken == 0  # no companion mixed
    flown = [row[1] for row in flight.seen if row[3] == Mode.OFFBOARD and row[2] > 1.0]
    assert min(flown) < 0.43 and max(flown) > 0.57
    assert len(found["split"]["dwell_rows"]) == 14
    assert found["split"]["on_board"] == pytest.approx(0.5, abs=1e-3)
    # towards the law's own, which is at least power by this very rotor model
    assert found["split"]["share"] < 0.48 and "COAX_SHARE 0.4" in said
    landing = [row[1] for row in flight.seen if row[3] == Mode.LAND and row[2] > 1.0]
    assert landing[-1] == pytest.approx(0.5, abs=0.005)
    assert flight.autopilot.store["COAX_SHARE_TRY"] == 0.0 and flight.autopilot.store["COAX_SHARE"] == 0.5


def grabbed(flight: Board) -> None:
    line = Line(flight.net, flight.addresses[0])
    flight.pilots.add(line.address)
    pilot = connect(flight.url(), transport=line, clock=flight.clock, source_system=255, source_component=190)
    pilot.send(m.MAVLink_command_long_message(1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0))  # position mode


def unplugged(flight: Board) -> None:
    flight.line.dead = True


def drained(flight: Board) -> None:
    flight.autopilot.plant.state[flight.autopilot.plant.index.CHARGE] = 0.05


@pytest.mark.parametrize(
    ("what", "act", "code"), [("pilot", grabbed, 1), ("link dead", unplugged, 3), ("battery", drained, 4)]
)
def test_every_end_brings_the_share_on_board_back(
    capsys: Any, tmp_path: Path, what: str, act: Any, code: int
) -> None:
    flight = Board()
    got, said, _, gave = fly(flight, capsys, tmp_path, act)
    assert gave and got == code, said
    sys.stdout.write(f"\n{what}:")
    since = gave[0]
    assert ("this plan again with --after" in said) == (what != "link dead")
    if what == "battery":  # as it is first told
        since = next(r[0] for r in flight.seen if r[0] > since and r[3] != Mode.OFFBOARD) - 0.1
    took, lost = back(flight, since)
    assert took < BACK_S and (lost < LOST_M or what == "battery")  # at whose end it lands
    trial = flight.autopilot.store["COAX_SHARE_TRY"]
    assert (trial > 0.0) == (what == "link dead")  # nobody could take it back: it is there, and not flown


def test_a_trial_that_somebody_left_is_not_flown_by_the_next(capsys: Any, tmp_path: Path) -> None:
    flight = Board(COAX_SHARE_TRY=0.5)
    flight.depart()
    flight.fly(5.0)
    assert flight.seen[-1][1] == pytest.approx(OWN, abs=0.003)


def test_a_module_of_another_rotor_model_is_refused(capsys: Any, tmp_path: Path) -> None:
    flight = Board()
    built = flight.autopilot.firmware_module
    object.__setattr__(built, "own_share", 0.46)
    flight.autopilot.boot()
    code, said, _, _ = fly(flight, capsys, tmp_path, None)
    assert code == 4 and "another" in said and not flight.autopilot.armed
    assert math.isclose(flight.seen[-1][2], flight.seen[0][2], abs_tol=0.01)


def test_while_a_companion_mixes_no_share_is_tried(capsys: Any, tmp_path: Path) -> None:
    flight = Board()
    module = flight.autopilot.module
    module._who, module._is_followed = (255, 191, 7), lambda now: True
    code, said, _, _ = fly(flight, capsys, tmp_path, None)
    assert code == 4 and "companion (system 255 component 191)" in said and not flight.autopilot.armed


def test_a_board_over_a_raw_map_has_the_law_of_the_vehicles_own_file(tmp_path: Path) -> None:
    made = tmp_path / "map.csv"
    made.write_text("pwm upper,pwm lower\n1500,1500\n")
    assert _module(FRAME, made, "px4").own_share == pytest.approx(_module(FRAME, None, "px4").own_share)
