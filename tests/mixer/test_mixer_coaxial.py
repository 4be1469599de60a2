"""Algorithm 1 as printed and completed, on vehicles of pairs and single rotors."""

from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import allocate, make_law
from coaxlink.mixer.plain import PlainLoad
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.studies.paper import printed_laws
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
X8 = Vehicle(load_airframe(EXAMPLES / "x8_paper.toml"), CRM)
PRINTED, LAW = printed_laws(X8)["coaxial-printed"], make_law("coaxial", X8)


def test_as_printed_both_rotors_of_an_arm_pull_alike_and_yaw_is_not_controlled():
    for yaw in (-1.0, 0.0, 0.4):
        result = allocate(PRINTED, X8, [196.2, 0, 0, yaw])
        assert result.thrust_N == pytest.approx(np.full(8, 196.2 / 8), abs=1e-8)
        assert result.error == pytest.approx([0, 0, 0, -yaw], abs=1e-8)
        assert result.dropped == ("yaw",)


def test_completed_it_delivers_the_whole_wrench_close_to_the_printed_equal_split():
    for wrench in np.random.default_rng(3).uniform([150, -4, -4, -1], [260, 4, 4, 1], (40, 4)):
        result = allocate(LAW, X8, wrench)
        assert np.abs(result.error).max() < 1e-6 and result.dropped == ()
    hover = [196.2, 1.0, -1.0, 0.2]
    assert LAW.speeds(hover) == pytest.approx(PRINTED.speeds(hover), abs=0.05)


def test_other_vehicles_get_their_wrench_too():
    missed = {}
    for frame, wrench in (
        ("y6", [137.0, 2.0, -1.5, 0.3]),
        ("coax_quad_plus", [157.0, 2.0, -1.5, 0.3]),
        ("coax_tilted", [176.0, 2.0, -1.5, 0.3]),
        ("mixed_hexa", [108.0, 1.0, 1.0, 0.1]),
    ):
        vehicle = Vehicle(load_airframe(EXAMPLES / f"{frame}.toml"), CRM)
        missed[frame] = np.abs(allocate(make_law("coaxial", vehicle), vehicle, wrench).error).max()
    assert max(missed.values()) < 1e-4, missed


def test_out_of_reach_the_speeds_stay_in_bounds():
    far = [2000.0, 0, 0, 0], [-50.0, 0, 0, 0], [196.2, 80, -80, 30], [0, 0, 0, 1e9], [1e30, 0, 0, 0]
    for law in (LAW, PRINTED):
        for wrench in far:
            u = law.speeds(wrench)
            assert np.isfinite(u).all() and u.min() >= 0.0 and u.max() <= 1.0, (law.name, wrench)


def test_rotors_on_one_line_cannot_make_roll(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text((EXAMPLES / "y6.toml").read_text().replace("0.3464", "0.0").replace("rotor_model", "#"))
    with pytest.raises(InputError, match=r"line\.toml.*cannot make"):
        make_law("coaxial", Vehicle(load_airframe(path), CRM))


def test_a_plain_load_is_the_polynomial_its_slopes_and_its_inverse():
    load = PlainLoad.of(Polynomial.from_terms({"u_u^2 u_l^3": 2.0, "u_u": -1.5, "1": 0.25, "u_l": 4.0}))
    value = 2 * 0.16 * 0.343 - 0.6 + 0.25 + 2.8
    slopes = 2 * 2 * 0.4 * 0.343 - 1.5, 2 * 0.16 * 3 * 0.49 + 4.0
    assert load.at(0.4, 0.7) == pytest.approx((value, *slopes)) and load.value(0.4, 0.7) == pytest.approx(
        value
    )
    thrust = PlainLoad.of(CRM.upper_thrust)
    for u in (0.0, 1e-6, 0.3, 0.77, 1.0):
        assert thrust.upper_for(55.9517 * u * u + 22.4464 * u) == pytest.approx(u, abs=1e-12)
    assert (thrust.upper_for(-1.0), thrust.upper_for(1e3)) == (0.0, 1.0)
    aim = float(CRM.lower_thrust(0.5, 0.6))
    assert PlainLoad.of(CRM.lower_thrust).lower_for(aim, 0.5) == pytest.approx(0.6, abs=1e-12)
