"""The form `surface`: where no polynomial follows; sensible between rows, blind to narrow bumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rotor_bench import pair_log

from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.files import example
from coaxlink.mixer.exact import ExactLaw
from coaxlink.rotor import Identification, identify
from coaxlink.rotor.fit import Options
from coaxlink.rotor.model import load_rotor_model, save_rotor_model
from coaxlink.rotor.physical import IN_THE_WAKE, grid, rules
from coaxlink.vehicle import Vehicle

NOISE_N, NOISE_NM = 0.05, 0.001


def world(bump: float = 0.0, only: slice = slice(None), seed: int = 3) -> Samples:
    """A pair whose wake fills the lower disk by a law that is no polynomial: a root and an exponential."""
    rng = np.random.default_rng(seed)
    u, v = (x.ravel()[only] for x in np.meshgrid(np.linspace(0.15, 1, 12), np.linspace(0.15, 1, 12)))
    inflow = 0.62 * u * (1 - np.exp(-((v / u) ** 1.5)))
    thrust = 60 * v**2 * np.maximum(1 - inflow / np.sqrt(v**2 + 0.15 * u**2), 0.02)
    thrust = thrust * (1 + bump * np.exp(-0.5 * ((v - 0.7) / 0.012) ** 2))
    torque = 1.1 * v**2 * (1 - 0.3 * inflow / np.sqrt(v**2 + 0.15 * u**2))
    return pair_log(u, v, [55 * u**2, 1.0 * u**2, thrust, torque], (NOISE_N, NOISE_NM) * 2, rng, rpm=6000)


@pytest.fixture(scope="module")
def found() -> Identification:
    return identify(world(), "auto", options=Options(max_order=2))


@pytest.mark.slow
def test_auto_takes_it_where_no_polynomial_follows_and_says_so_first(found: Identification) -> None:
    assert found.form == "surface"
    crm = found.comparison["crm"]["lower_thrust"].rmse
    assert found.channels["lower_thrust"].rmse < min(2.0 * NOISE_N, 0.8 * crm)
    assert found.notes[0].startswith("crm does not follow this pair everywhere")
    assert found.as_json()["surface"]["lower.thrust_N"]["evidence"] > 20.0
    assert found.as_json()["surface"]["lower.thrust_N"]["size"] > 0.3


@pytest.mark.slow
def test_the_requested_form_stays_and_the_surface_is_named() -> None:
    chosen = identify(world(), "crm", options=Options(max_order=2))
    assert chosen.form == "crm"
    assert chosen.notes[0].startswith("crm does not follow") and "`form` surface" in chosen.notes[0]


def polynomial_pair() -> Samples:
    """A pair of squares and one product, written down here."""
    rng = np.random.default_rng(8)
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.1, 1, 11), np.linspace(0.1, 1, 11)))
    clean = [77.7 * u**2, 1.32 * u**2, 69.9 * v**2 - 9.0 * u * v - 11.0 * u**2, 1.24 * v**2 - 0.2 * u**2]
    return pair_log(u, v, clean, (NOISE_N, NOISE_NM) * 2, rng, rpm=5000)


@pytest.mark.slow
def test_where_polynomials_follow_auto_keeps_one_and_a_surface_claims_nothing() -> None:
    for form, kept in (("auto", "crm"), ("surface", "surface")):
        result = identify(polynomial_pair(), form, options=Options(max_order=2))
        assert result.form == kept and not any("follow" in note for note in result.notes)


@pytest.mark.slow
def test_poor_logs_give_a_model_of_numbers() -> None:
    full = world()
    u, v = full["upper_rpm"] / 6000, full["lower_rpm"] / 6000
    exact = {"upper_thrust_N": 50 * u**2, "upper_torque_Nm": u**2, "lower_thrust_N": 40 * v**2}
    poor = {
        "few": full.take(np.arange(0, full.rows, 20)),
        "one rotor": full.with_columns(lower_rpm=0 * v),
        "along one line": full.with_columns(lower_rpm=6000 * u),
        "upper stands": full.with_columns(upper_rpm=0 * u + 3000),
        "noiseless": full.with_columns(**exact, lower_torque_Nm=0.9 * v**2),
    }
    for case, log in poor.items():
        terms = identify(log, "surface", compare=False).model.terms().values()
        assert all(np.isfinite(list(t.values())).all() for t in terms), case


@pytest.mark.slow
def test_it_does_what_rotors_do_on_the_whole_range(found: Identification) -> None:
    u, v = grid(found.data.speeds.upper, found.data.speeds.lower)
    for load, fit in found.fits.items():
        for rule, C in rules(load, fit.terms, u, v):
            if rule == IN_THE_WAKE:
                continue  # held where physical sense is requested
            values = C @ fit.coefficients
            assert values.min() > -1e-6 * np.abs(values).max(), (load, rule)


@pytest.mark.slow
def test_half_a_map_is_carried_on_without_a_swing() -> None:
    """Rows with the lower rotor up to 0.6 only: above, the prior keeps near the R-CRM's squares."""
    rows = slice(0, 12 * 7)
    half = identify(world(only=rows), "surface", speed_max_rpm=6000.0, compare=False).model
    full = world(seed=4)
    u, v = full["upper_rpm"] / 6000, full["lower_rpm"] / 6000
    off = half.loads(u, v).lower_thrust - full["lower_thrust_N"]
    assert np.abs(off).max() < 0.15 * full["lower_thrust_N"].max()


@pytest.mark.slow
def test_a_narrow_bump_is_not_followed() -> None:
    bumped, plain = world(bump=0.06), world()
    model = identify(bumped, "surface", compare=False).model
    u, v = bumped["upper_rpm"] / 6000, bumped["lower_rpm"] / 6000
    bump = bumped["lower_thrust_N"] - plain["lower_thrust_N"]
    left = bumped["lower_thrust_N"] - model.loads(u, v).lower_thrust
    at = np.abs(bump) > 0.5
    assert at.sum() >= 6
    assert np.median(left[at] / bump[at]) > 0.5


@pytest.mark.slow
def test_it_goes_through_a_file_and_exact_allocation(found: Identification, tmp_path: Path) -> None:
    save_rotor_model(tmp_path / "r.toml", found.model)
    model = load_rotor_model(tmp_path / "r.toml")
    assert model.form == "surface" and model.terms() == found.model.terms()
    vehicle = Vehicle(load_airframe(example("x8_demo.toml")), model)
    law = ExactLaw(vehicle)
    weight = vehicle.airframe.mass_kg * 9.81
    for demand in ([weight, 0.0, 0.0, 0.0], [1.2 * weight, 2.0, -1.0, 0.3], [0.8 * weight, 0.0, 1.0, -0.3]):
        speeds = law.speeds(np.array(demand))
        wrench = vehicle.airframe.wrench(*vehicle.airframe.loads(model, speeds))
        assert np.allclose(wrench, demand, atol=1e-5 * weight)
