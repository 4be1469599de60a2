"""The PX4 module that `bridge` writes: its law beside Python's, whom it follows, and the files."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from board_law import WARNINGS, build, compare, on_board
from verb import run

from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.live.onboard.description import airframe_hash, board_law, board_vehicle
from coaxlink.live.onboard.px4 import module_files
from coaxlink.rotor import RotorModel
from coaxlink.rotor.drive import Drive, SideDrive
from coaxlink.vehicle import Vehicle, load_vehicle

X8 = load_vehicle(example("x8_paper.toml"))
NUTTX = Path(__file__).parents[1] / "helpers" / "nuttx_cxx"  # of C++'s library, what PX4 on a board has
SANE = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ compiles the module's law")


@needs_compiler
@pytest.mark.slow
def test_law_on_board_is_the_python_law(tmp_path):
    host = build(tmp_path, board_law(X8), *SANE)
    for found in compare(X8, host, 250):
        assert found["worse_than_reduced"] == 0 and found["worse"] == 0, found
        assert found["passes"][2] <= 430, found  # bounded: the budget, and what is begun within it
        if found["kind"] in ("smooth", "steps"):
            # a demand out of reach is looked for all round, which takes a budget or two
            assert found["settled"] > 0.97 and found["worst"] < 1e-4, found
        else:
            assert found["settled"] > 0.75 and found["within"] > 0.95, found


# the lower rotor pulls down beneath half of the upper one's speed; the wake first brakes it, then turns it
WAKE = RotorModel.from_terms(
    "crm",
    5400.0,
    {
        "upper.thrust_N": {"u_u^2": 60.0},
        "upper.torque_Nm": {"u_u^2": 1.2},
        "lower.thrust_N": {"u_l^2": 60.0, "u_u u_l": -30.0},
        "lower.torque_Nm": {"u_l^2": 1.2, "u_u u_l": 0.8, "u_u^2 u_l": -0.8},
    },
    drive=Drive(SideDrive((0.0, 0.5, 0.3), 0.15), SideDrive((0.0, 0.5, 0.2), 0.25)),
)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("dead", [3, 8])
def test_law_on_board_knows_what_an_arm_does_of_which_a_rotor_stands_still(tmp_path, dead):
    about = board_law(Vehicle(X8.airframe, WAKE))
    host, slots = build(tmp_path, about, *SANE), about.units.slots
    rng, weight = np.random.default_rng(dead), 9.81 * X8.airframe.mass_kg
    given = rng.uniform([0.9, -4, -4, -0.5], [1.1, 4, 4, 0.5], (40, 4)) * [weight, 1, 1, 1]
    given[-1] = [8 * weight, 0, 0, 0]
    ours = on_board(host, given[:, about.units.order] / about.units.scale, 1 << int(slots[dead - 1]))
    speeds, commands = ours.speeds[:, slots], ours.commands[:, slots]
    upper, lower = np.array([(0, 5), (1, 4), (2, 7), (3, 6)]).T
    pull, drag = np.zeros((40, 8)), np.zeros((40, 8))
    a, b = speeds[:, upper], speeds[:, lower]
    pull[:, upper], drag[:, upper] = 60 * a * a, 1.2 * a * a
    pull[:, lower], drag[:, lower] = 60 * b * b - 30 * a * b, 1.2 * b * b + 0.8 * a * b - 0.8 * a * a * b
    place = np.array([r.position_m for r in X8.airframe.rotors])
    spin = np.array([1, -1, 1, -1, 1, -1, 1, -1])  # of x8_paper.toml
    got = np.stack([pull.sum(1), -pull @ place[:, 1], pull @ place[:, 0], drag @ spin], axis=1)
    assert not speeds[:, dead - 1].any()
    assert np.abs(got - given)[:-1].max() < 0.01  # N, N m
    assert commands[-1, 10 - dead] == pytest.approx(1.0, abs=2e-3)  # the other of the arm


@needs_compiler
@pytest.mark.slow
def test_law_and_companion_need_no_more_of_the_library_than_a_board_has(tmp_path):
    (tmp_path / "on_board.cpp").write_text(
        '#include "coax_vehicle.hpp"\n#include "Companion.hpp"\n'
        "using namespace coaxlink;\n"
        "template class coaxlink::ExactLaw<ARMS, SURFACES, ORDER_U, ORDER_S, POWER_U, POWER_S>;\n"
        "template class coaxlink::Companion<ROTORS>;\n"
    )
    for name, text in module_files(board_law(X8), "tests").items():
        if name.endswith(".hpp"):
            (tmp_path / Path(name).name).write_text(text)
    bare = ("-std=gnu++14", "-nostdinc++", f"-I{NUTTX}", f"-I{tmp_path}", "-fsyntax-only")
    subprocess.run(["g++", *WARNINGS[1:], *bare, tmp_path / "on_board.cpp"], check=True)


@pytest.fixture(scope="module")
def rules(tmp_path_factory):
    """Whom the module follows, as a program."""
    return build(tmp_path_factory.mktemp("rules"), board_law(X8), *SANE, source="board_companion.cpp")


def follow(host: Path, script: str) -> list[list[float]]:
    """One row a `b` of the script: the speed flown, five kinds of refusal, times handed back."""
    reported = subprocess.run([host], input=script, capture_output=True, text=True, check=True).stdout
    return [[float(word) for word in line.split()] for line in reported.splitlines()]


FIRST = "d 1000\na 5000 abcdef 7 1 255 191 2 0.6\nb 5000\n"  # one good answer: 0.5 flies on towards 0.6
REFUSED = (  # what comes next, and which refusal it is
    ("another vehicle's", "a 6000 123456 7 2 255 191 2 0.6", 0),
    ("another number of rotors", "a 6000 abcdef 7 2 255 191 8 0.6", 0),
    ("another companion", "a 6000 abcdef 7 2 255 192 2 0.6", 1),
    ("the same place, another start", "a 6000 abcdef 8 2 255 191 2 0.6", 1),
    ("not finite", "a 6000 abcdef 7 2 255 191 2 nan", 2),
    ("above 1", "a 6000 abcdef 7 2 255 191 2 1.01", 2),
    ("the same answer twice", "a 6000 abcdef 7 1 255 191 2 0.6", 3),
    ("an answer to no demand", "a 6000 abcdef 7 3 255 191 2 0.6", 3),
    ("a demand of 21 ms ago", "a 26100 abcdef 7 2 255 191 2 0.6", 3),
    ("a lie", "a 6000 abcdef 7 2 255 191 2 0.9", 4),
)


@needs_compiler
@pytest.mark.slow
def test_what_is_not_flown_is_counted(rules):
    for what, line, kind in REFUSED:
        before, after = follow(rules, f"{FIRST}d 5000\n{line}\nb {line.split()[1]}\n")
        assert before[0] > 0.5 and before[1:] == [0] * 6, what
        assert [n for n in range(5) if after[1 + n]] == [kind], (what, after)


@needs_compiler
@pytest.mark.slow
def test_who_turns_a_motor_that_is_out_of_the_law_is_not_flown(rules):
    answer = "a 6000 abcdef 7 2 255 191 2"
    assert follow(rules, f"{FIRST}d 5000\ns 5500\n{answer} 0.6\nb 26000\n")[-1][:6] == [0.5, 0, 0, 0, 0, 1]
    assert follow(rules, f"{FIRST}d 5000\ns 5500\n{answer} 0.0\nb 6000\n")[-1][5] == 1  # delivers nothing


@needs_compiler
@pytest.mark.slow
def test_a_silent_companion_is_out_when_its_demand_is_20_ms_old(rules):
    (_, *_), at_20, at_21 = follow(rules, f"{FIRST}b 21000\nb 21004\n")
    assert at_20[0] > 0.5 and at_21[0] == 0.5 and at_21[-1] == 1


@needs_compiler
@pytest.mark.slow
def test_another_companion_is_followed_after_100_ms_of_silence(rules):
    script = f"{FIRST}d 106000\na 106001 abcdef 9 2 255 192 2 0.6\nb 106001\n"
    assert follow(rules, script)[-1][0] > 0.5


def test_files_name_the_vehicle_and_the_way_back():
    files = module_files(board_law(X8), "x8.toml")
    identity = f"0x{airframe_hash(X8.declared):06x}"
    assert identity in files["src/modules/coax_mixer/coax_vehicle.hpp"]
    assert "control_allocator stop" in files["etc/extras.txt"] and identity in files["README.md"]
    assert {Path(name).name for name in files} == {
        "CMakeLists.txt", "CoaxMixer.cpp", "CoaxMixer.hpp", "Companion.hpp", "Share.hpp", "coax_law.hpp",
        "coax_vehicle.hpp", "module.yaml", "extras.txt", "README.md",
    }  # fmt: skip


def test_identity_is_of_the_airframe_and_not_of_its_rotor_model():
    other = load_vehicle(example("x8_paper.toml"), example("rotor_rcrm_paper.toml"))
    assert board_law(other).identity == board_law(X8).identity == board_vehicle(X8.declared).identity
    assert board_law(load_vehicle(example("y6.toml"))).identity != board_law(X8).identity


def test_a_name_is_no_code(tmp_path):
    airframe = example("x8_paper.toml").read_text().replace('name = "paper-x8"', 'name = "a\\n#error */ ??/"')
    (tmp_path / "rotor_paper.toml").write_text(example("rotor_paper.toml").read_text())
    (tmp_path / "x8.toml").write_text(airframe)
    try:
        text = module_files(board_law(load_vehicle(tmp_path / "x8.toml")), "a\nb")
    except InputError:
        return  # refused already as a name
    assert "\n#error" not in text["src/modules/coax_mixer/coax_vehicle.hpp"]


def test_verb_writes_both_firmwares_from_one_airframe_file(tmp_path, capsys):
    x8 = example("x8_paper.toml")
    for firmware, file in (("px4", "etc/extras.txt"), ("ardupilot", "scripts/coaxlink_bridge.lua")):
        code, _, reported = run(capsys, "bridge", x8, "--firmware", firmware, "--out", tmp_path)
        assert code == 0 and (tmp_path / file).exists(), reported
    assert run(capsys, "bridge", x8, "--firmware", "betaflight")[0] == 2
