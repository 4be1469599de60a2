"""Algorithm 1 as printed and completed, on vehicles of pairs and single rotors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import allocate, make_law
from coaxlink.mixer.surface import Surface
from coaxlink.rotor.model import load_rotor_model
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")


def test_as_printed_yaw_is_not_controlled_and_says_so() -> None:
    law = make_law("coaxial-printed", Vehicle(X8, CRM))
    for yaw in (-1.0, 0.4, 1.0):
        result = allocate(law, Vehicle(X8, CRM), [196.2, 0, 0, yaw])
        assert result.error[:3] == pytest.approx(np.zeros(3), abs=1e-8)
        assert result.error[3] == pytest.approx(-yaw, abs=1e-9)
        assert result.dropped == ("yaw",)


def test_as_printed_both_rotors_of_an_arm_pull_alike() -> None:
    result = allocate(make_law("coaxial-printed", Vehicle(X8, CRM)), Vehicle(X8, CRM), [196.2, 0, 0, 0])
    assert result.thrust_N == pytest.approx(np.full(8, 196.2 / 8), abs=1e-8)


def test_completed_it_delivers_the_whole_wrench() -> None:
    law = make_law("coaxial", Vehicle(X8, CRM))
    rng = np.random.default_rng(3)
    for _ in range(40):
        wrench = rng.uniform([150, -4, -4, -1], [260, 4, 4, 1])
        result = allocate(law, Vehicle(X8, CRM), wrench)
        assert np.abs(result.error).max() < 1e-6
        assert result.dropped == ()


def test_completed_it_stays_close_to_the_equal_split_of_the_printed_one() -> None:
    hover = [196.2, 1.0, -1.0, 0.2]
    printed = make_law("coaxial-printed", Vehicle(X8, CRM)).speeds(hover)
    assert make_law("coaxial", Vehicle(X8, CRM)).speeds(hover) == pytest.approx(printed, abs=0.05)


@pytest.mark.parametrize(
    ("frame", "wrench"),
    [
        ("y6", [137.0, 2.0, -1.5, 0.3]),
        ("coax_quad_plus", [157.0, 2.0, -1.5, 0.3]),
        ("coax_tilted", [176.0, 2.0, -1.5, 0.3]),
        ("mixed_hexa", [108.0, 1.0, 1.0, 0.1]),
    ],
)
def test_other_vehicles_get_their_wrench_too(frame: str, wrench: list[float]) -> None:
    airframe = load_airframe(EXAMPLES / f"{frame}.toml")
    result = allocate(make_law("coaxial", Vehicle(airframe, CRM)), Vehicle(airframe, CRM), wrench)
    assert np.abs(result.error).max() < 1e-4


def test_out_of_reach_the_speeds_stay_in_bounds() -> None:
    for name in ("coaxial", "coaxial-printed"):
        law = make_law(name, Vehicle(X8, CRM))
        for wrench in (
            [2000.0, 0, 0, 0],
            [-50.0, 0, 0, 0],
            [196.2, 80, -80, 30],
            [0, 0, 0, 1e9],
            [1e30, 0, 0, 0],
        ):
            u = law.speeds(wrench)
            assert np.isfinite(u).all()
            assert u.min() >= 0.0
            assert u.max() <= 1.0


def test_rotors_on_one_line_cannot_make_roll(tmp_path: Path) -> None:
    text = (EXAMPLES / "y6.toml").read_text().replace("0.3464", "0.0")
    path = tmp_path / "line.toml"
    path.write_text(text.replace("rotor_model", "#"))
    with pytest.raises(InputError, match=r"line\.toml.*cannot make"):
        make_law("coaxial", Vehicle(load_airframe(path), CRM))


def test_a_surface_is_the_polynomial_and_its_slopes() -> None:
    load = Polynomial.from_terms({"u_u^2 u_l^3": 2.0, "u_u": -1.5, "1": 0.25, "u_l": 4.0})
    value, by_upper, by_lower = Surface.of(load).at(0.4, 0.7)
    assert value == pytest.approx(2 * 0.16 * 0.343 - 0.6 + 0.25 + 2.8)
    assert by_upper == pytest.approx(2 * 2 * 0.4 * 0.343 - 1.5)
    assert by_lower == pytest.approx(2 * 0.16 * 3 * 0.49 + 4.0)


def test_a_surface_is_inverted_on_its_range_and_held_at_its_ends() -> None:
    thrust = Surface.of(CRM.upper_thrust)
    for u in (0.0, 1e-6, 0.3, 0.77, 1.0):
        assert thrust.upper_for(55.9517 * u * u + 22.4464 * u) == pytest.approx(u, abs=1e-12)
    assert thrust.upper_for(-1.0) == 0.0
    assert thrust.upper_for(1e3) == 1.0
    lower = Surface.of(CRM.lower_thrust)
    aim = float(CRM.lower_thrust(0.5, 0.6))
    assert lower.lower_for(aim, 0.5) == pytest.approx(0.6, abs=1e-12)
