"""Identification on bench data whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rotor_bench import TRUTH, eq17, grid, stand

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.rotor import Identification, identify, load_rotor_model, save_rotor_model
from coaxlink.rotor.fit import Options
from coaxlink.rotor.stand_data import blocks, folds, normalised_speeds

SQUARES = Options(max_order=2)  # the order of eq. 17: quicker, where order is not the question


def rcrm(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    return [77.65 * u**2, 1.93 * u**2, 69.89 * v**2 - 30.7 * u**2, 2.0 * v**2 - 0.5 * u**2]


def cpcm(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    return [77.65 * u**2, 1.93 * u**2, 60.0 * v**2, 1.5 * v**2]


def srm(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    return [73.06 * u**2, 1.9 * u**2, 73.06 * v**2, 1.9 * v**2]


def without(log: Samples, ending: str) -> Samples:
    return Samples({k: c for k, c in log.columns.items() if not k.endswith(ending)}, "bench")


@pytest.fixture(scope="module")
def crm() -> Identification:
    return identify(stand(0), "crm", options=SQUARES, compare=False)


@pytest.mark.slow
def test_crm_reaches_the_noise_and_the_paper_s_errors(crm: Identification) -> None:
    """Held-out error within 5 % of the noise, over four draws; NRMSE under the paper's."""
    ratios = []
    truth = eq17(*grid())
    for seed in range(4):
        log = stand(seed)
        error = identify(log, "crm", options=SQUARES, compare=False).channels["coaxial_thrust"]
        noise = log["upper_thrust_N"] + log["lower_thrust_N"] - truth[0] - truth[2]
        assert error.held_out_rows == 121 and error.nrmse < 0.0106
        ratios.append(error.rmse / np.sqrt(np.mean(noise**2)))
    assert np.mean(ratios) < 1.05
    assert crm.channels["coaxial_torque"].nrmse < 0.0072
    assert crm.noise_floor["upper_thrust"] == pytest.approx(0.5, rel=0.2)
    assert crm.noise_floor["coaxial_thrust"] == pytest.approx(0.5 * 2**0.5, rel=0.2)
    assert crm.model.speed_max_rpm == 5400
    loads = crm.model.loads(*grid())
    for name, true, noise in zip(
        ("upper_thrust", "upper_torque", "lower_thrust", "lower_torque"), truth, (0.5, 0.01) * 2, strict=True
    ):
        assert np.sqrt(np.mean((getattr(loads, name) - true) ** 2)) < 0.4 * noise, name


@pytest.mark.slow
def test_held_out_is_held_out() -> None:
    """Loads that are pure noise cannot be predicted: the error stays at or above the noise."""
    random = np.random.default_rng(3)
    log = stand(0).with_columns(upper_thrust_N=random.standard_normal(121))
    error = identify(log, "crm", options=SQUARES, compare=False).channels["upper_thrust"]
    assert error.rmse > 0.95 * np.std(log["upper_thrust_N"]) and error.r < 0.3


def test_blocks_are_sweeps_or_stretches_and_at_most_twelve_folds() -> None:
    log = stand(0)
    found = blocks(log, normalised_speeds(log))
    assert found.tolist() == np.repeat(np.arange(11), 11).tolist()
    shuffled = log.take(np.random.default_rng(0).permutation(121))
    assert len(set(blocks(shuffled, normalised_speeds(shuffled)).tolist())) == 10
    assert folds(np.arange(30)).max() == 11 and folds(found) is found


@pytest.mark.slow
def test_auto_keeps_what_the_data_support() -> None:
    for loads in (srm, cpcm, rcrm):
        assert identify(stand(5, loads), "auto", options=SQUARES).form == loads.__name__
    result = identify(stand(1), "auto", options=SQUARES)
    rmse = {form: c["coaxial_thrust"].rmse for form, c in result.comparison.items()}
    assert result.form == "crm" and rmse["crm"] < rmse["rcrm"] / 4 < rmse["srm"] / 4


def test_forms_have_the_terms_they_claim() -> None:
    result = identify(stand(2, rcrm), "rcrm", compare=False)
    assert {load: set(t) for load, t in result.model.terms().items()} == {
        "upper.thrust_N": {"u_u^2"},
        "upper.torque_Nm": {"u_u^2"},
        "lower.thrust_N": {"u_l^2", "u_u^2"},
        "lower.torque_Nm": {"u_l^2", "u_u^2"},
    }
    assert result.model.terms()["lower.thrust_N"]["u_u^2"] == pytest.approx(-30.7, abs=1.0)
    same = identify(stand(2, srm), "srm", compare=False).model.terms()
    assert same["upper.thrust_N"]["u_u^2"] == same["lower.thrust_N"]["u_l^2"] == pytest.approx(73.06, abs=0.5)
    with pytest.raises(InputError, match="'mutual' is not a form"):
        identify(stand(0), "mutual")


@pytest.mark.slow
def test_an_outlier_is_reported_and_does_not_change_the_model() -> None:
    clean = stand(4)
    thrust = clean["lower_thrust_N"].copy()
    thrust[60] += 40.0
    result = identify(clean.with_columns(lower_thrust_N=thrust), "crm", options=SQUARES, compare=False)
    assert [(w.where, w.load) for w in result.outliers] == [("row 61", "lower.thrust_N")]
    off = result.model.lower_thrust(*grid()) - eq17(*grid())[2]
    assert np.sqrt(np.mean(off**2)) < 0.4
    assert not identify(clean, "rcrm", compare=False).outliers


def test_a_value_lies_in_the_intervals_beside_it(crm: Identification) -> None:
    for load, terms in crm.model.terms().items():
        assert set(TRUTH[load]) <= set(crm.intervals[load].bounds)
        for term, value in terms.items():
            for intervals in (crm.intervals[load], crm.given[load]):
                low, high = intervals.bounds[term]
                assert low <= value <= high, (load, term)
    assert (
        crm.given["lower.thrust_N"].standard_error["u_l^2"]
        < 0.9 * (crm.intervals["lower.thrust_N"].standard_error["u_l^2"])
    )


def test_speeds_that_move_together_leave_terms_undetermined() -> None:
    log = stand(0)
    result = identify(log.take(log["upper_rpm"] == log["lower_rpm"]), "crm", compare=False)
    assert result.channels["lower_thrust"].rmse < 2.0
    assert result.intervals["lower.thrust_N"].indistinct or result.fits["lower.thrust_N"].alone
    assert any("move together" in note for note in result.notes)


@pytest.mark.slow
def test_speeds_from_rpm_from_throttle_or_given() -> None:
    log = stand(0)
    result = identify(without(log, "rpm"), "crm", options=SQUARES, compare=False)
    assert result.channels["coaxial_thrust"].rmse < 0.85
    assert any("throttle" in note for note in result.notes)
    bare = without(log, "throttle")
    assert identify(bare, "rcrm", compare=False).model.speed_max_rpm == pytest.approx(4860)
    given = identify(bare, "rcrm", speed_max_rpm=5400, compare=False).model
    assert given.terms()["upper.thrust_N"]["u_u^2"] == pytest.approx(85.7, abs=1)


@pytest.mark.slow
def test_a_rotor_alone_has_no_lower_terms(tmp_path: Path) -> None:
    u = np.linspace(0.1, 1, 40)
    log = Samples({"upper_rpm": 5000 * u, "upper_thrust_N": 70 * u**2, "upper_torque_Nm": 1.5 * u**2}, "x")
    result = identify(log, "crm", options=SQUARES)
    assert result.model.terms()["lower.thrust_N"] == {}
    assert set(result.channels) == {"upper_thrust", "upper_torque"}
    assert result.model.upper_thrust(1.0) == pytest.approx(70, rel=1e-3)
    save_rotor_model(tmp_path / "m.toml", result.model)
    assert load_rotor_model(tmp_path / "m.toml").terms() == result.model.terms()


def test_what_cannot_be_identified_is_one_line() -> None:
    cases = [
        ({"upper_rpm": [1] * 3, "upper_thrust_N": [1] * 3, "upper_torque_Nm": [1] * 3}, "too few"),
        ({"upper_rpm": [1] * 9, "upper_thrust_N": [1] * 9}, "column upper_torque_Nm: missing"),
        (
            {
                "upper_rpm": [1] * 9,
                "lower_rpm": list(range(9)),
                "upper_thrust_N": [1] * 9,
                "upper_torque_Nm": [1] * 9,
            },
            "column lower_thrust_N: missing",
        ),
        ({"upper_rpm": [1] * 9, "lower_rpm": [1] * 9}, "column upper_thrust_N: missing"),
        (
            {"upper_rpm": [0] * 9, "upper_thrust_N": [1] * 9, "upper_torque_Nm": [1] * 9},
            "no rotor ever turns",
        ),
        ({"upper_rpm": [1] * 9, "lower_thrust_N": [1] * 9}, "column lower_rpm: missing"),
    ]
    wrong = []
    for columns, expected in cases:
        log = Samples({k: np.array(c, float) for k, c in columns.items()}, "x.csv")
        with pytest.raises(InputError) as caught:
            identify(log, "crm")
        if expected not in str(caught.value):
            wrong.append((expected, str(caught.value)))
    assert not wrong
    for log in (without(stand(0), "throttle"), without(stand(0), "rpm")):
        for beyond in (-1.0, 1e-320, float("nan"), float("inf")):
            with pytest.raises(InputError, match="more than 0"):
                identify(log, "rcrm", speed_max_rpm=beyond)


def test_a_rotor_that_never_turned_gets_no_torque_of_its_idle_current() -> None:
    rpm = np.linspace(2000.0, 6000.0, 30)
    thrust, watts = 7.46e-7 * rpm**2, 1.479e-8 * rpm**3 * np.pi / 30 / 0.8
    columns = {"upper_rpm": rpm, "lower_rpm": 0 * rpm, "pair_thrust_N": thrust, "voltage_V": 22.0 + 0 * rpm}
    amps = {"upper_current_A": watts / 22.0, "lower_current_A": 0.02 + 0 * rpm}
    found = identify(Samples(columns | amps, "jig"), "auto")
    assert (
        set(found.fits) == {"upper.thrust_N", "upper.torque_Nm"}
        and not found.model.terms()["lower.torque_Nm"]
    )
