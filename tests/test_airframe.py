"""The airframe: wrench by hand, and one clear line for each thing a file can get wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.rotor.model import load_rotor_model, save_rotor_model
from coaxlink.vehicle.changed_model import with_terms

EXAMPLES = Path(__file__).parents[1] / "examples"
ROTOR = """[[rotors]]
number = {number}
position_m = {position}
spin = "{spin}"
level = "{level}"
{more}
"""


def write(folder: Path, *rotors: str, head: str = "") -> Path:
    path = folder / "frame.toml"
    path.write_text('name = "t"\nmass_kg = 2.0\ninertia_kg_m2 = [0.1, 0.1, 0.2]\n' + head + "".join(rotors))
    return path


def single(number: int, position: list[float], spin: str = "ccw", more: str = "") -> str:
    return ROTOR.format(number=number, position=position, spin=spin, level="single", more=more)


def test_wrench_of_the_papers_vehicle_by_hand() -> None:
    x8 = load_airframe(EXAMPLES / "x8_paper.toml")
    thrust = np.array([10.0, 11, 12, 13, 14, 15, 16, 17])
    torque = np.arange(1.0, 9.0)
    right, left = 10 + 13 + 15 + 16, 11 + 12 + 14 + 17
    front, rear = 10 + 11 + 14 + 15, 12 + 13 + 16 + 17
    odd, even = 1 + 3 + 5 + 7, 2 + 4 + 6 + 8
    expected = [thrust.sum(), 0.1807 * (left - right), 0.1807 * (front - rear), odd - even]
    assert x8.wrench(thrust, torque) == pytest.approx(expected, rel=1e-12)


def test_a_tilted_rotor_pushes_sideways_and_yaws_by_its_lever(tmp_path: Path) -> None:
    tilted = single(1, [1.0, 0.0, 0.0], more="axis = [0.0, 3.0, -4.0]")
    frame = load_airframe(write(tmp_path, tilted, single(2, [0, 1.0, 0], "cw"), single(3, [0, -1.0, 0])))
    body = frame.body_loads([5.0, 0, 0], [0.0, 0, 0])
    # thrust 5 along (0, 0.6, -0.8): 3 N to the right a metre ahead of the centre is 3 N m of yaw
    assert body == pytest.approx([0, 3, -4, 0, 4, 3], abs=1e-12)


def test_a_rotor_a_kilometre_out_is_refused(tmp_path: Path) -> None:
    frame = write(tmp_path, *(single(n, [1e39, 0.0, 0.0]) for n in (1, 2, 3)))
    with pytest.raises(InputError, match=r"rotors\[1\].position_m"):
        load_airframe(frame)


def test_effectiveness_is_the_wrench_of_unit_loads() -> None:
    x8 = load_airframe(EXAMPLES / "x8_paper.toml")
    per_thrust, per_torque = x8.effectiveness()
    assert per_thrust[:, 0] == pytest.approx([1, -0.1807, 0.1807, 0])
    assert per_torque[:, 0] == pytest.approx([0, 0, 0, 1])
    assert per_torque[:, 1] == pytest.approx([0, 0, 0, -1])


def test_the_lower_rotor_of_a_pair_feels_the_upper_one() -> None:
    x8 = load_airframe(EXAMPLES / "x8_paper.toml")
    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    u = np.zeros(8)
    u[[0, 5]] = 0.5, 0.6  # rotors 1 and 6 are one pair
    thrust, torque = x8.loads(model, u)
    assert thrust[0] == pytest.approx(55.9517 * 0.25 + 22.4464 * 0.5)
    assert thrust[5] == pytest.approx(
        2.755 * 0.25 * 0.36 + 64.721 * 0.36 - 2.547 * 0.3 + 12.402 * 0.6 - 37.502 * 0.25 + 0.801
    )
    assert torque[5] == pytest.approx(0.307 * 0.5 * 0.36 + 1.466 * 0.36 + 0.573 * 0.6 - 0.695 * 0.25)


def test_a_file_of_another_kind_is_named_for_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rotor_paper\.toml: a rotor file; an airframe file .* is expected"):
        load_airframe(EXAMPLES / "rotor_paper.toml")
    with pytest.raises(InputError, match=r"x8_paper\.toml: an airframe file; a rotor file .* is expected"):
        load_rotor_model(EXAMPLES / "x8_paper.toml")
    (tmp_path / "empty.toml").touch()
    with pytest.raises(InputError, match=r"empty\.toml: empty; an airframe file .* is expected"):
        load_airframe(tmp_path / "empty.toml")
    (tmp_path / "half.toml").write_text("mass_kg = 3.0\n")
    with pytest.raises(InputError, match=r"half\.toml: name: missing$"):
        load_airframe(tmp_path / "half.toml")


def test_a_bad_file_gets_one_line_that_names_the_key(tmp_path: Path) -> None:
    with case_table() as case:
        for rotors, says in (
            ([single(1, [0, 1, 0]), single(2, [0, 1, 0])], "rotors"),
            (
                [single(1, [0, 1, 0]), single(2, [0, 1, 0]), single(2, [1, 0, 0])],
                "numbers must run from 1 to 3",
            ),
            ([single(k, [0, k, 0], more="axis = [0.0, 0.0, 0.0]") for k in (1, 2, 3)], "zero length"),
            ([single(k, [0, k, 0], more="pair = 1") for k in (1, 2, 3)], "a single rotor has no pair"),
            ([single(k, [0, k, 0], spin="left") for k in (1, 2, 3)], "spin"),
            (
                [
                    ROTOR.format(number=k, position=[0, k, 0], spin="cw", level="upper", more="pair = 1")
                    for k in (1, 2, 3)
                ],
                "expected the lower rotor that names 1 as its pair",
            ),
        ):
            with case(f"{rotors}, {says}"):
                path = write(tmp_path, *rotors)
                with pytest.raises(InputError, match=says) as caught:
                    load_airframe(path)
                assert str(path) in str(caught.value)
                assert "\n" not in str(caught.value)


def test_a_message_names_a_rotor_by_its_number_in_whatever_order_the_tables_stand(tmp_path):
    text = (EXAMPLES / "x8_paper.toml").read_text()
    head, *rotors = text.split("[[rotors]]")
    path = tmp_path / "x8.toml"
    last = rotors[7].replace("spin = ", "spins = ")
    assert "number = 8" in last and "spins" in last
    path.write_text(head + "[[rotors]]" + "[[rotors]]".join([last, *rotors[:7]]))
    with pytest.raises(InputError, match=r"rotors\[8\]\.spins: unknown; spin\?"):
        load_airframe(path)


def test_where_numbers_are_from_is_read_and_what_is_not_said_is_declared(tmp_path):
    rotors = [single(n, [x, y, 0.0]) for n, x, y in ((1, 1, 1), (2, 1, -1), (3, -1, -1), (4, -1, 1))]
    assert load_airframe(write(tmp_path, *rotors)).source_of("motor_lag_s") == "declared"
    reported = load_airframe(write(tmp_path, *rotors, head='[sources]\nmass_kg = "measured"\n'))
    assert reported.source_of("mass_kg") == "measured" and reported.source_of("inertia_kg_m2") == "declared"
    for head, says in (
        ('mass_kg = "guess"', r"sources\.mass_kg"),
        ('mass = "board"', r"sources\.mass: unknown; mass_kg"),
    ):
        with pytest.raises(InputError, match=says):
            load_airframe(write(tmp_path, *rotors, head=f"[sources]\n{head}\n"))


def test_a_rotor_file_keeps_where_its_numbers_are_from(tmp_path):
    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    save_rotor_model(tmp_path / "r.toml", replace(model, sources={"upper": "measured", "lower": "estimated"}))
    kept = with_terms(load_rotor_model(tmp_path / "r.toml"), {})
    assert kept.sources == {"upper": "measured", "lower": "estimated"}
