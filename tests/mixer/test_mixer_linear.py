"""The linear mixers against the paper's printed matrices and against arithmetic done by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import LAWS, allocate, make_law, reduced_coefficients, standard_coefficients
from coaxlink.rotor import load_rotor_model
from coaxlink.studies.paper import printed_laws
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM, RCRM, SRM = (load_rotor_model(EXAMPLES / f"rotor{n}_paper.toml") for n in ("", "_rcrm", "_srm"))


def test_printed_models_give_the_numbers_of_eq_15_and_18():
    c = reduced_coefficients(RCRM)
    assert (c.p_upper, c.p_lower) == pytest.approx((46.98, 69.89), abs=0.05)
    assert (c.q_0u - c.q_1l, c.q_0l) == pytest.approx((2.44, 2.0), abs=0.02)
    assert (standard_coefficients(SRM).p, standard_coefficients(SRM).q) == (73.06, 1.9)


def test_squares_fitted_to_eq_17_are_those_of_the_normal_equations_and_far_from_the_printed_ones():
    # the paper's grid by plain sums: sum u^4 and so on, two unknowns
    grid = [0.09 * k for k in range(11)]
    rows = [
        (
            a * a,
            b * b,
            2.755 * a**2 * b**2 + 64.721 * b**2 - 2.547 * a * b + 12.402 * b - 37.502 * a**2 + 0.801,
        )
        for a in grid
        for b in grid
    ]
    s11, s12, s22 = (sum(r[i] * r[j] for r in rows) for i, j in ((0, 0), (0, 1), (1, 1)))
    t1, t2 = (sum(r[i] * r[2] for r in rows) for i in (0, 1))
    det = s11 * s22 - s12 * s12
    fit = reduced_coefficients(CRM)
    assert fit.p_1l == pytest.approx((s22 * t1 - s12 * t2) / det, rel=1e-9)
    assert fit.p_0l == pytest.approx((s11 * t2 - s12 * t1) / det, rel=1e-9)
    assert (fit.p_0u, fit.p_0l, fit.p_1l) == pytest.approx((85.7, 80.4, -34.6), abs=0.05)
    assert (fit.q_0u, fit.q_0l, fit.q_1l) == pytest.approx((2.19, 2.27, -0.53), abs=0.006)


def test_printed_mixers_hover_on_the_printed_rotors_as_the_paper_s_numbers_say():
    hover = allocate(make_law("reduced", Vehicle(X8, RCRM)), Vehicle(X8, CRM), [196.2, 0, 0, 0])
    assert hover.speeds[[0, 4]] == pytest.approx([0.570, 0.695], abs=1e-3)
    assert hover.error[0] == pytest.approx(39.5, abs=0.2)  # far too strong
    assert hover.error[1:] == pytest.approx(np.zeros(3), abs=1e-9)
    hover = allocate(make_law("standard", Vehicle(X8, SRM)), Vehicle(X8, CRM), [196.2, 0, 0, 0])
    assert hover.speeds == pytest.approx(np.full(8, 0.5794), abs=1e-3)
    assert abs(hover.error[0]) == pytest.approx(2.7, abs=0.1)


def test_a_law_is_exact_on_the_rotors_it_believes_in():
    for name, model in (("reduced", RCRM), ("standard", SRM)):
        result = allocate(make_law(name, Vehicle(X8, model)), Vehicle(X8, model), [190.0, 3.0, -2.0, 0.7])
        assert result.error == pytest.approx(np.zeros(4), abs=1e-9), name
        assert not result.saturated.any(), name


def test_the_yaw_row_as_printed_asks_for_73_times_the_torque():
    mended = make_law("standard", Vehicle(X8, SRM)).speeds([196.2, 0, 0, 0.05]) ** 2
    printed = printed_laws(Vehicle(X8, SRM))["standard-printed"].speeds([196.2, 0, 0, 0.05]) ** 2
    level = 196.2 / 8 / 73.06
    assert (printed - level) == pytest.approx(73.06 * (mended - level), rel=1e-6)


def test_signs_of_the_rows_are_frd():
    law = make_law("standard", Vehicle(X8, SRM))
    # right side down: the left rotors work harder; nose up: the front ones; clockwise: the ccw ones
    for wrench, harder, less in (
        ([196.2, 2.0, 0, 0], 1, 0),
        ([196.2, 0, 2.0, 0], 0, 2),
        ([196.2, 0, 0, 1.0], 0, 1),
    ):
        speeds = law.speeds(wrench)
        assert speeds[harder] > speeds[less], wrench


def test_a_wrench_that_is_not_four_numbers_and_an_unknown_law_are_refused():
    law = make_law("reduced", Vehicle(X8, RCRM))
    for bad in ([1, 2, 3], [np.nan, 0, 0, 0], [np.inf, 0, 0, 0]):
        with pytest.raises(InputError, match="four finite numbers"):
            law.speeds(bad)
    with pytest.raises(InputError, match="magic: no such law"):
        make_law("magic", Vehicle(X8, RCRM))


@pytest.mark.parametrize("law", LAWS)
def test_a_vehicle_that_its_rotors_do_not_lift_is_refused_with_both_forces(law):
    # by hand, of eq. 15: 4 x (46.98 + 69.89) N at full throttle, 50 kg x 9.807
    with pytest.raises(InputError, match=r"mass_kg: cannot fly: .* 467\.4 N at full throttle, 490\.3 N hang"):
        make_law(law, Vehicle(replace(X8, mass_kg=50.0), RCRM))
