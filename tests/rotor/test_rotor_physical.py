"""Physical sense on request: loads that rise and fall as rotors' do, where the free fit does not."""

import numpy as np
import pytest
from rotor_bench import pair_log

from coaxlink.data import Samples
from coaxlink.report.identify import remarks
from coaxlink.rotor import identify
from coaxlink.rotor.fit import LoadFit, Options
from coaxlink.rotor.physical import constrained
from coaxlink.rotor.polynomial import design_matrix, dictionary
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import Intervals

LEVELS = np.linspace(0.0, 0.9, 11)


def stand(seed: int, noise_N: float, rig: float = 0.0) -> Samples:
    """A small pair on a stand; with `rig`, cells that lean on one another: thrusts bend the wrong way."""
    u, v = (g.ravel() for g in np.meshgrid(LEVELS, LEVELS, indexing="ij"))
    loads = [
        4.0 * u**2 - rig * u,
        0.10 * u**2,
        4.0 * v**2 - 0.3 * u**2 + rig * u * (1 - v),
        0.10 * v**2,
    ]
    noise = (noise_N, 0.02 * noise_N) * 2
    log = pair_log(u, v, loads, noise, np.random.default_rng(seed), rpm=5000)
    return log.with_columns(upper_throttle=u, lower_throttle=v)


def free_fit(terms: list[str], b: np.ndarray) -> LoadFit:
    return LoadFit(tuple(terms), b, 2, Intervals({}, {}))


def rows_of(load: str, u: np.ndarray, v: np.ndarray, y: np.ndarray) -> LoadRows:
    return LoadRows(load, u, v, y, np.zeros(len(y), np.int64))


def broken(model, fine: np.ndarray) -> dict[str, float]:
    """How far each rule is missed, by values and differences on a fine grid (docs/stand.md has the rules)."""
    u, v = np.meshgrid(fine, fine, indexing="ij")
    loads = model.loads(u, v)
    work = np.triu(np.ones(u.shape, bool))  # the lower rotor at least as fast as the upper one
    rising = {
        "upper thrust": np.diff(loads.upper_thrust, axis=0),
        "upper torque": np.diff(loads.upper_torque, axis=0),
        "lower thrust": np.diff(loads.lower_thrust, axis=1)[work[:, :-1]],
        "lower torque": np.diff(loads.lower_torque, axis=1)[work[:, :-1]],
        "wake": -np.diff(loads.lower_thrust, axis=0),
        "more than alone": loads.lower_thrust[:1] - loads.lower_thrust,
        "negative thrust": loads.upper_thrust,
        "negative power": np.concatenate([loads.upper_torque.ravel(), loads.lower_torque[work]]),
    }
    return {name: -float(values.min()) for name, values in rising.items()}


@pytest.mark.slow
def test_the_rules_hold_between_the_points_and_up_to_full_speed() -> None:
    log = stand(1, 0.02, rig=0.8)
    free = identify(log, "crm", options=Options(max_order=2), compare=False)
    made = identify(log, "crm", options=Options(max_order=2, physical=True), compare=False)
    fine = np.linspace(0.0, 0.9 / log["upper_throttle"].max(), 61)
    assert max(broken(made.model, fine).values()) < 1e-3
    missed = {name for name, by in broken(free.model, fine).items() if by > 1e-3}
    assert missed >= {"upper thrust", "wake", "more than alone"}  # the free fit does need it
    said = {(load, rule.rule) for load, fit in made.fits.items() for rule in fit.broken}
    assert ("upper.thrust_N", "falls with its own speed") in said
    assert ("lower.thrust_N", "rises with the upper rotor's speed") in said
    for load, fit in made.fits.items():
        assert fit.freely.terms() == free.fits[load].polynomial.terms()
    assert made.without == free.channels
    lines = " ".join(remarks(made))
    assert "free fit falls with its own speed" in lines and "95 %" in lines
    # this rig bends the loads against the rules on purpose: physics must cost here, and that is said
    assert made.channels["upper_thrust"].rmse > 2 * free.channels["upper_thrust"].rmse
    assert "upper_thrust held out" in lines
    assert made.as_json()["physical"]["channels_without"]["upper_thrust"]["rmse"] > 0


def test_sense_makes_up_for_rows_that_are_missing() -> None:
    """Few, noisy rows of a sound pair: beyond them the free fit bends, the constrained one less."""
    fine = np.linspace(0.2, 1.0, 33)
    u, v = np.meshgrid(fine, fine, indexing="ij")
    truth = 4.0 * v**2 - 1.6 * u * v - 0.3 * u**2
    gains = []
    for seed in range(6):
        dice = np.random.default_rng(seed)
        a, b = dice.uniform(0.2, 0.7, (2, 40))
        y = 4.0 * b**2 - 1.6 * a * b - 0.3 * a**2 + 0.1 * dice.standard_normal(40)
        terms = dictionary(2, 2)
        free = free_fit(terms, np.linalg.lstsq(design_matrix(terms, a, b), y, rcond=None)[0])
        made = constrained(free, rows_of("lower.thrust_N", a, b, y), np.ones(40))
        far = [float(np.sqrt(np.mean((fit.predict(u, v) - truth) ** 2))) for fit in (free, made)]
        gains.append(far[1] / far[0])
    assert np.median(gains) < 0.8, gains


def test_a_fit_that_makes_sense_is_left_alone() -> None:
    log = stand(4, 0.01)
    free = identify(log, "rcrm", compare=False)
    made = identify(log, "rcrm", options=Options(physical=True), compare=False)
    assert made.model.terms() == free.model.terms()
    assert not any(fit.broken for fit in made.fits.values())
    assert any("nothing was changed" in line for line in remarks(made))


def test_what_no_coefficients_can_meet_keeps_the_fit_and_says_so() -> None:
    u = np.linspace(0.1, 0.9, 20)
    free = free_fit(["u_u^2"], np.array([-3.0]))
    kept = constrained(free, rows_of("upper.thrust_N", u, 0 * u, -3.0 * u**2), np.ones(20))
    assert kept.unmet and kept.coefficients == free.coefficients
