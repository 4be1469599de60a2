"""The share of the upper rotors in the PX4 module: whose word counts, how long, and what the law flies."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from board_law import build, on_board

from coaxlink.cli.sim import coax_firmware
from coaxlink.files import example
from coaxlink.live.onboard.description import board_law
from coaxlink.mixer.shares import LeaningLaw, shares_of
from coaxlink.rotor.drive import Drive, SideDrive
from coaxlink.vehicle import Vehicle, load_vehicle
from sim.px4.coax_module import CoaxModule

X8 = load_vehicle(example("x8_paper.toml"))
WEIGHT_N = 9.81 * X8.airframe.mass_kg
SANE = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
UPPER, LOWER = np.array([(0, 5), (1, 4), (2, 7), (3, 6)]).T
OWN, MOST = 0.4, 0.5  # of board_share.cpp
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ compiles the module's law")


@pytest.fixture(scope="module")
def rules(tmp_path_factory):
    return build(tmp_path_factory.mktemp("share"), board_law(X8), *SANE, source="board_share.cpp")


def run(host: Path, *script: str) -> list[list[float]]:
    """[share flown, lean, on trial, refused] a line that runs."""
    done = subprocess.run([host], input="\n".join(script), capture_output=True, text=True, check=True).stdout
    return [[float(word) for word in line.split()] for line in done.splitlines()]


@needs_compiler
@pytest.mark.slow
def test_the_share_on_board_is_flown_with_nobody_there_and_slowly(rules):
    start, moving, there, back = run(
        rules, "b 0 0", "r 1 0", "p 0.475 0", "r 1 0", "r 1 0", "p 0 0", "r 3 0"
    )  # fmt: skip
    assert start == [OWN, 0, 0, 0]
    assert OWN < moving[0] < 0.46 and -0.13 < moving[1] < 0  # 0.05 a second
    assert there == [0.475, -0.2, 0, 0]  # half-way between two leans
    assert back == [OWN, 0, 0, 0]


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["nan", "inf", "-0.4", "0.29", "0.51", "40"])
def test_what_is_no_share_of_these_rotors_is_not_flown_and_said_once(rules, wrong):
    on_board, again, trial = run(
        rules, "b 0.45 0", f"p {wrong} 0", "r 3 1", f"p {wrong} 0", "r 1 1", f"p 0.45 {wrong}", "r 3 1"
    )
    assert on_board == again == [OWN, 0, 0, 1]
    assert trial[0] == pytest.approx(0.45, abs=1e-4) and trial[2:] == [0, 2]
    assert run(rules, f"b {wrong} 0", "r 0 0") == [[OWN, 0, 0, 1]]


@needs_compiler
@pytest.mark.slow
def test_a_trial_ends_with_who_flies_it_and_begins_no_more_by_itself(rules):
    tried, ended, again, anew = run(
        rules, "b 0 0", "p 0 0.48", "r 3 1", "r 0.2 0", "p 0 0.48", "r 3 1", "p 0 0.47", "r 3 1"
    )
    assert tried[0] == pytest.approx(0.48, abs=1e-4) and tried[2] == 1
    assert ended == again == [OWN, 0, 0, 0]  # within a fifth of a second
    assert anew[0] == pytest.approx(0.47, abs=1e-4)


@needs_compiler
@pytest.mark.slow
def test_a_trial_that_is_taken_back_is_over_in_a_fifth_of_a_second(rules):
    assert run(rules, "b 0.35 0", "p 0.35 0.5", "r 4 1", "p 0.35 0", "r 0.2 1")[1] == [0.35, 0.1, 0, 0]


@needs_compiler
@pytest.mark.slow
def test_a_trial_left_in_the_parameters_is_not_flown_after_a_start(rules):
    assert run(rules, "b 0 0.48", "r 3 1", "p 0 0.48", "r 3 1") == [[OWN, 0, 0, 0]] * 2


def test_a_lean_flies_its_share_at_the_whole_wrench():
    """Of the loads that the rotor model has at these speeds, in a hover and in a turn."""
    shares, law = shares_of(X8), LeaningLaw(X8)
    assert len(shares.share) == 13 and shares.share[-1] - shares.share[0] == pytest.approx(0.36, abs=1e-3)
    assert shares.lean_of(shares.own) == 0.0
    turn = [1.1 * WEIGHT_N, 3.0, -2.0, 0.4]
    for share in (0.30, 0.36, 0.47, 0.55):
        law.lean(shares.lean_of(share))
        u = law.speeds([WEIGHT_N, 0, 0, 0])
        lift = X8.airframe.loads(X8.model, u)[0]
        assert lift[UPPER].sum() / lift.sum() == pytest.approx(share, abs=0.002)
        got = X8.airframe.wrench(*X8.airframe.loads(X8.model, law.speeds(turn)))
        assert got == pytest.approx(turn, abs=1e-3)


def test_at_the_ceiling_a_lean_costs_no_thrust():
    """Whatever the lean, what is asked for first is what the exact law gives."""
    law, asked = LeaningLaw(X8), [3.0 * WEIGHT_N, 0, 0, 0]
    most = X8.airframe.loads(X8.model, law.speeds(asked))[0].sum()
    for lean in (0.18, -0.15):
        law.lean(lean)
        assert X8.airframe.loads(X8.model, law.speeds(asked))[0].sum() == pytest.approx(most, rel=1e-4)


@needs_compiler
@pytest.mark.slow
def test_the_law_on_board_leans_as_pythons(tmp_path):
    about = board_law(X8)
    host, slots = build(tmp_path, about, *SANE), about.units.slots
    rng = np.random.default_rng(3)
    given = rng.uniform([0.8, -3, -3, -0.5], [1.2, 3, 3, 0.5], (60, 4)) * [WEIGHT_N, 1, 1, 1]
    for lean in (0.12, -0.12):
        law = LeaningLaw(X8)
        law.lean(lean)
        ours = on_board(host, given[:, about.units.order] / about.units.scale, lean=lean).speeds[:, slots]
        assert np.abs(ours - law.many(given)).max() < 2e-4


def test_the_stand_in_commands_what_the_drive_needs_for_the_speeds_of_the_law() -> None:
    side = SideDrive((0.02, 0.5, 0.3), 0.01, range=(0.05, 1.0))
    vehicle = Vehicle(X8.airframe, dataclasses.replace(X8.rotors, drive=Drive(side, side)))
    built, hover = coax_firmware(vehicle), board_law(vehicle).hover
    module = CoaxModule(built, 8)
    module.mix(0.0, 0.0, 0.0, 0.0, hover)
    speeds = built.law(0.0, 0.0, 0.0, hover)
    torque, sent = X8.airframe.loads(X8.rotors, speeds)[1], module.outputs(0.01)
    assert np.abs(sent - speeds).max() > 0.05  # else the drive was straight
    assert sent == pytest.approx(0.02 + 0.5 * speeds + 0.3 * speeds**2 + 0.01 * torque, abs=1e-6)
