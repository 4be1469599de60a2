"""Stand logs: what is there is named, a clean log says nothing, odds are told.

The rig is that of tests/helpers and shares nothing with coaxlink.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from residual_rig import FULL_RPM, followed, run
from scipy.signal import lfilter

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.evidence.noise import white
from coaxlink.load import Load
from coaxlink.residual import refine_stand
from coaxlink.residual.answer.concluded import answered
from coaxlink.residual.diagnosis.decide import Decision
from coaxlink.residual.diagnosis.hypotheses import Scorer, begun
from coaxlink.residual.diagnosis.posterior import posterior
from coaxlink.residual.diagnosis.stand import speed_law, stand_channels
from sim.physics.rotors import read_pair


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true", "names"),
    [
        ({}, []),
        ({"battery": 0.7, "rpm": False}, ["battery_voltage"]),
        ({"interference": 5.0}, ["lower_on_upper_interference"]),
    ],
)
def test_what_is_there_is_named_with_its_probability(true, names, paper):
    answer = refine_stand(Samples(run(seed=3, **true), "rig.csv"), paper)
    assert sorted(e.name for e in answer.effects) == names
    assert answer.ambiguous == () and answer.suspect_data == ()
    for effect in answer.effects:
        assert 0.5 < effect.evidence["probability"] <= 1.0
        for channel in effect.channels:
            c = answer.channels[channel]
            assert c.rmse_after < c.rmse_before
    json.dumps(answer.to_json(), allow_nan=False)


@pytest.mark.slow
def test_mass_over_sets_is_a_probability():
    answer = refine_stand(Samples(run(seed=4, air=1.0), "rig.csv"))
    mass = [s.p_value for s in answer.trace]
    assert 0.99 < sum(mass) <= 1.0 + 1e-9
    kept = [s for s in answer.trace if s.kept]
    assert len(kept) == 1 and kept[0].name == "air_density"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "lag_s", "down", "seed"), [(20, 0.01, 1.3, 2), (20, 0.06, 1.5, 1), (5, 0.1, 1.2, 1)]
)
def test_a_lag_between_rows_is_no_other_effect_and_has_its_length(rate_hz, lag_s, down, seed, paper):
    log = followed(seed, rate_hz, lag_s, down=down, hold_s=max(1.0, 10.0 / rate_hz))
    (lag,) = refine_stand(Samples(log, "rig.csv"), paper).effects
    numbers = {p.name: p.value for p in lag.parameters}
    assert lag.name == "rotor_lag"
    assert numbers["lag_s"] == pytest.approx(lag_s, rel=0.1)
    assert numbers["down"] == pytest.approx(down, rel=0.1)


@pytest.mark.slow
def test_a_number_that_a_log_hardly_shows_is_told_where_it_was_fitted(paper):
    log = followed(1, 20, 0.04, hold_s=2.0, ramp=True)
    (lag,) = refine_stand(Samples(log, "rig.csv"), paper).effects
    numbers = {p.name: p.value for p in lag.parameters}
    assert numbers["lag_s"] + numbers.get("second_s", 0.0) == pytest.approx(0.04, rel=0.2)


def test_a_name_that_betters_no_error_where_the_fit_did_not_look_is_not_claimed(paper):
    log = Samples(run(seed=3), "rig.csv")  # in which nothing is hidden
    ch = stand_channels(log, paper)
    scorer, refuted = Scorer(ch, white(ch.count)), 0
    for effect in ch.effects:
        shape = effect.shapes(ch.frame)[0]
        count = effect.columns(ch.frame, shape).shape[-1]
        member = begun(ch, effect, shape, np.full(count, 1e-3))
        found = posterior(ch, scorer.colour, [scorer.score([member], ()), scorer.empty])
        answer = answered(ch, found, Decision({effect.name: 0.99}, (), {}, 0.0, False), [], [], [log])
        if answer.effects:
            assert any(c.rmse_after < c.rmse_before for c in answer.channels.values()), effect.name
            continue
        refuted += 1
        assert any(r.name == effect.name and "held-out" in r.why for r in answer.rejected)
        assert answer.model.effects == paper.effects and answer.unexplained and answer.more == 0.99
    assert refuted


def stalling(seed):
    """A rig whose lower torque bends over the ratio of the speeds, as no polynomial does."""
    columns = run(seed=seed, throttle=False)
    a, b = columns["upper_rpm"] / FULL_RPM, columns["lower_rpm"] / FULL_RPM
    bend = np.exp(-(((b / np.maximum(a, 0.05) - 0.35) / 0.12) ** 2))
    columns["lower_torque_Nm"] = columns["lower_torque_Nm"] - 0.4 * bend * (a**2 + b**2)
    return columns


@pytest.mark.slow
def test_what_a_pair_does_over_the_ratio_of_its_speeds_is_its_map_and_no_effect():
    answer = refine_stand(Samples(stalling(5), "rig.csv"))
    assert (answer.effects, answer.ambiguous, answer.suspect_data) == ((), (), ())
    assert answer.unexplained == ()
    told = [s.channel for s in answer.surface]
    assert "lower_torque" in told and len(told) == len(set(told))


def test_where_no_model_is_given_how_blades_follow_reynolds_number_is_the_map():
    own = np.linspace(0.05, 1.0, 60)
    functions, deviations = speed_law(own)
    for power in (-0.45, 0.2):  # of the lift slope: measured on small blades
        share = own**power - 1.0
        precision = (functions * deviations).T @ (functions * deviations) + 1e-4 * np.eye(len(deviations))
        numbers = np.linalg.solve(precision, (functions * deviations).T @ share)
        assert np.std(share - functions @ (deviations * numbers)) < 0.01
        assert np.linalg.norm(numbers) < 3.33  # of what the prior draws, 95 % (chi-square of five)


def blades(seed):
    """Two blades whose lift slope falls as the speed to -0.45, ramps, cells that wander; nothing hidden."""
    random, pair = np.random.default_rng(seed), read_pair(Path("kde5215_bemt"))
    ramp = np.concatenate([np.linspace(0.0, 0.9, 70), np.linspace(0.9, 0.0, 70)])
    a = np.concatenate([ramp, ramp, 0.35 + 0 * ramp, 0.8 + 0 * ramp])
    b = np.concatenate([ramp, 0.5 + 0 * ramp, ramp, ramp])
    loads = pair.loads(a, b)
    full = np.quantile(np.abs(loads), 0.95, axis=1)[:, None]
    wander = lfilter([1.0], [1.0, -0.96], random.standard_normal((4, 2 * len(a))), axis=1)[:, len(a) :]
    loads = loads + 0.002 * full * (random.standard_normal(loads.shape) + wander / np.std(wander))
    columns = {"time_s": 0.1 * np.arange(len(a)), "upper_throttle": a, "lower_throttle": b}
    return columns | dict(zip((load.column for load in Load), loads, strict=True))


@pytest.mark.slow
def test_of_clean_blades_of_another_pair_nothing_is_said():
    answer = refine_stand(Samples(blades(7), "blades.csv"))
    assert (answer.effects, answer.ambiguous, answer.suspect_data, answer.unexplained) == ((), (), (), ())


@pytest.mark.slow
def test_beside_such_a_map_an_effect_is_still_named():
    columns = stalling(6)
    time_min = columns["time_s"] / 60.0
    columns["lower_thrust_N"] = columns["lower_thrust_N"] + 0.25 * time_min
    answer = refine_stand(Samples(columns, "rig.csv"))
    assert [e.name for e in answer.effects] == ["sensor_drift"]


@pytest.mark.slow
def test_cells_that_wander_are_noise_and_no_open_end(paper):
    columns, random = run(seed=8), np.random.default_rng(8)
    for name, size in (("upper_thrust_N", 0.8), ("lower_torque_Nm", 0.016)):
        wander = lfilter([1.0], [1.0, -0.95], random.standard_normal(len(columns["time_s"])))
        columns[name] = columns[name] + size * wander / np.std(wander)
    answer = refine_stand(Samples(columns, "rig.csv"), paper)
    assert (answer.effects, answer.ambiguous, answer.unexplained) == ((), (), ())


@pytest.mark.slow
def test_a_log_without_anything_names_what_it_would_have_taken_for_one_another_and_the_run_to_make(paper):
    columns = run(seed=9, rpm=False)
    columns["motor_temperature_C"] = 25.0 + 12.0 * (25.0 - columns["voltage_V"])
    answer = refine_stand(Samples(columns, "rig.csv"), paper)
    assert answer.effects == () and answer.ambiguous == ()
    least = {w["name"]: w for w in answer.to_json()["would_show"]}
    assert 0.0 < least["battery_voltage"]["share"] < 0.1
    assert "motor_heating" in least["battery_voltage"]["not_told_from"]
    assert len(answer.to_json()["next_run"]["pieces"]) > 0


def settled(power, memory_s, step_s=2.0):
    share = -np.expm1(-step_s / memory_s)
    return lfilter([share], [1.0, share - 1.0], power)


@pytest.mark.slow
def test_a_room_whose_air_goes_round_is_no_heat_of_motors():
    columns = run(seed=11, rpm=False)
    air = settled(columns["upper_thrust_N"] + columns["lower_thrust_N"], 25.0)
    for name in ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm"):
        columns[name] = columns[name] * (1.0 - 0.12 * air / air.max())
    del columns["motor_temperature_C"], columns["voltage_V"]
    answer = refine_stand(Samples(columns, "rig.csv"))
    assert (answer.effects, answer.ambiguous) == ((), ())
    assert answer.unexplained
    why = {r.name: r.why for r in answer.rejected}
    assert "motor_temperature_C is not in the log" in why["motor_heating"]


@pytest.mark.slow
def test_an_upper_cell_that_feels_the_lower_rotor_is_unexplained_over_its_speed():
    columns = run(seed=12, rpm=False)
    columns["upper_torque_Nm"] = columns["upper_torque_Nm"] + 0.15 * columns["lower_throttle"] ** 3
    answer = refine_stand(Samples(columns, "rig.csv"))
    assert (answer.effects, answer.ambiguous) == ((), ())
    assert ("upper_torque", ("lower_speed",)) in {(u.channel, u.depends_on) for u in answer.unexplained}


def test_what_was_never_measured_is_one_line():
    columns = run(seed=5)
    columns["upper_thrust_N"] = np.where(np.arange(len(columns["upper_thrust_N"])) == 7, 1e30, 1.0)
    with pytest.raises(InputError, match=r"upper_thrust_N.*no measured value"):
        refine_stand(Samples(columns, "rig.csv"))
