"""Two tables in turn: how often the interval holds their difference; the verb where nothing is mixed live."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_flight import CRM, EXAMPLES, X8, Flight
from memory_net import plugged
from verb import run

from coaxlink.cli.sim import coax_firmware
from coaxlink.errors import InputError
from coaxlink.fly.split_answer import Dwells
from coaxlink.fly.table_flights import compare_tables, flights_for
from coaxlink.live.onboard.description import board_law
from coaxlink.live.onboard.px4 import module_files
from coaxlink.mixer.split import table_of
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Vehicle
from sim.physics.rotors import read_pair

TRIALS, HELD = 300, 273  # 95 % of 300 are fewer than this once in a hundred
FRAME = EXAMPLES / "x8_demo.toml"


def hovers(rng: np.random.Generator, order: str, saving: float, repeat: float = 0.01) -> list[Dwells]:
    """Flights of ten dwells: a pack that sags, wind, and what differs between flights."""
    flights = []
    for table in order:
        t = 9.0 + 18.0 * np.arange(10)
        wind = rng.normal(1.0, 0.3) + rng.normal(0.0, 0.2, 10)
        level = 900.0 * (1.0 + repeat * rng.normal()) * (1.0 - saving * (table == "B"))
        watts = level * (1.0 + 1e-4 * t) - 6.0 * wind + rng.normal(0.0, 3.0, 10)
        share = np.full(10, 0.62 if table == "A" else 0.53)
        flights.append(Dwells(t, watts, share, wind[:, None]))
    return flights


@pytest.mark.parametrize(("order", "saving"), [("ABBA", 0.0), ("ABBA", 0.03), ("ABBAABBA", 0.02)])
def test_the_interval_holds_the_difference(order: str, saving: float) -> None:
    rng = np.random.default_rng(5)
    answers = [compare_tables(hovers(rng, order, saving)) for _ in range(TRIALS)]
    assert sum(a.saving_ci[0] <= saving <= a.saving_ci[1] for a in answers) >= HELD
    if not saving:
        assert sum(not a.worth_it for a in answers) >= HELD
        assert "no difference" in next(a for a in answers if not a.worth_it).words()


def test_as_many_flights_as_were_said_tell_two_per_cent_half_of_the_time() -> None:
    rng, count = np.random.default_rng(6), flights_for(0.02, 0.01)
    order = "ABBA" * (count // 2)
    determined = [compare_tables(hovers(rng, order, 0.02)).worth_it for _ in range(TRIALS)]
    assert 0.45 < np.mean(determined) < 0.9  # the half width of the interval is what was asked for
    assert flights_for(0.02, 0.03) > 4 * count


@pytest.mark.parametrize("order", ["AAAA", "AB", "ABB"])
def test_too_few_are_refused(order: str) -> None:
    with pytest.raises(InputError, match="two of each"):
        compare_tables(hovers(np.random.default_rng(1), order, 0.0))


@pytest.mark.slow
def test_the_verb_flies_two_tables_on_a_px4_that_is_not_mixed_live(capsys: Any, tmp_path: Path) -> None:
    vehicle = Vehicle(X8, CRM)
    other = report_px4(vehicle, "fitted", fit=table_of(vehicle, 0.6)).params
    done: list[Path] = []
    for number, table in enumerate("ABBA"):

        class Tabled(Flight):
            firmware = "px4:1.16"
            params = other if table == "B" else {}

            def prepare(self) -> None:
                self.autopilot.store.recall(self.params)

        flight, out = Tabled(airborne=False), tmp_path / str(number)
        words: list[Any] = ["fly", "--plan", "split", "--tables", "--minutes", 1.6, "--connect", flight.url()]
        words += [
            "--airframe",
            FRAME,
            "--no-log",
            "--yes",
            "--out",
            out,
            "--json",
            tmp_path / f"{number}.json",
        ]
        for path in done:
            words += ["--after", path]
        with plugged(flight.net):
            code, reported, err = run(capsys, *words)
        assert code == 0, err
        assert "two of each answer" in reported or number == 3
        done.append(tmp_path / f"{number}.json")
    found = json.loads(done[-1].read_text())["split"]
    assert "of the thrust from above takes" in reported
    assert found["escs"]["ratio"] == pytest.approx(1.0, abs=0.03)
    assert found["flights"] == [2, 2] and found["shares"][1] == pytest.approx(0.6, abs=0.01)
    truth = [shaft_watts(vehicle, share) for share in found["shares"]]
    assert found["saving"] == pytest.approx(1.0 - truth[1] / truth[0], abs=0.01)


@pytest.mark.slow
def test_arducopters_escs_are_heard_all_eight_though_one_message_was_asked_for(
    capsys: Any, tmp_path: Path
) -> None:
    class Copter(Flight):
        firmware = "ardupilot"

        def prepare(self) -> None:
            pass

    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "power_module"\nsize = 0.06\noffset_A = 0.0\n')
    flight = Copter(airborne=False, truth=truth)
    words = ["fly", "--plan", "split", "--tables", "--minutes", 1.6, "--connect", flight.url(), "--airframe"]
    words += [FRAME, "--no-log", "--yes", "--out", tmp_path, "--json", tmp_path / "fly.json"]
    with plugged(flight.net):
        code, _, err = run(capsys, *words)
    assert code == 0, err
    escs = json.loads((tmp_path / "fly.json").read_text())["split"]["escs"]
    assert escs["ratio"] == pytest.approx(1.0 / 1.06, abs=0.02) and not escs["agree"]
    assert min(*escs["upper_A"], *escs["lower_A"]) > 1.0
    assert "the ESCs' amps sum to 0.9" in err


@pytest.mark.parametrize(("firmware", "acts"), [("px4:1.13", 0), ("px4:1.13", 1), ("px4:1.16", None)])
def test_a_table_that_px4_ignores_is_not_flown_in_turn(
    capsys: Any, tmp_path: Path, firmware: str, acts: int | None
) -> None:
    class Board(Flight):
        def prepare(self) -> None:
            super().prepare()
            if acts is not None:
                self.autopilot.store.write("SYS_CTRL_ALLOC", 6, acts)

    Board.firmware = firmware
    flight = Board(airborne=False)
    words = ["fly", "--plan", "split", "--tables", "--minutes", 1.6, "--connect", flight.url()]
    with plugged(flight.net):
        code, _, err = run(capsys, *words, "--airframe", FRAME, "--no-log", "--dry-run", "--out", tmp_path)
    if acts == 0:
        assert code == 4 and "ignores the table while SYS_CTRL_ALLOC is 0" in err, err
    else:
        assert code == 0, err
    assert not flight.autopilot.armed


@pytest.mark.slow
def test_tables_are_not_flown_in_turn_while_the_module_has_the_motors(capsys: Any, tmp_path: Path) -> None:
    vehicle = Vehicle(X8, CRM)

    class Board(Flight):
        firmware = "px4:1.16"

        def prepare(self) -> None:
            a = self.autopilot
            a.firmware_module = coax_firmware(vehicle)
            a.store.write("MPC_THR_HOVER", 9, board_law(vehicle).hover)
            extras = module_files(board_law(vehicle), "tests")["etc/extras.txt"]
            a.files.files["etc/extras.txt"] = extras.encode()
            a.boot()

    flight = Board(airborne=False)
    words = ["fly", "--plan", "split", "--tables", "--minutes", 1.6, "--connect", flight.url()]
    with plugged(flight.net):
        code, _, err = run(capsys, *words, "--airframe", FRAME, "--no-log", "--dry-run", "--out", tmp_path)
    assert code == 4 and "module flies the motors" in err and "--tables" in err, err


def shaft_watts(vehicle: Vehicle, share: float) -> float:
    """The world's own: torques of its rotor file times speeds, at a hover of that share."""
    weight, top = X8.mass_kg * 9.80665 / 4.0, CRM.speed_max_rpm * np.pi / 30.0
    u = np.linspace(0.2, 1.1, 181)
    upper, lower = np.meshgrid(u, u, indexing="ij")
    up, q_up, low, q_low = (
        np.asarray(v) for v in read_pair(EXAMPLES / "rotor_paper.toml").loads(upper, lower)
    )
    near = np.hypot(up / weight - share, low / weight - (1.0 - share)).argmin()
    return float((q_up * upper + q_low * lower).ravel()[near] * top)


def test_rubbish_is_refused_before_anything_is_opened(capsys: Any, tmp_path: Path) -> None:
    words = ("fly", "--airframe", str(FRAME), "--connect", "udpout:127.0.0.1:1")
    code, _, err = run(capsys, *words, "--tables")
    assert code == 2 and "--plan split" in err
    code, _, err = run(capsys, *words, "--tables", "--plan", "split", "--minutes", "1")
    assert code == 2 and "1.5 at least" in err
