"""Own fits of pairs that polynomials do not follow, and rows that no other row tells of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from residual_rig import steady_loads
from residual_stand_logs import log_of, names, over, ramps
from scipy.signal import lfilter

from coaxlink.report.refine import verdict
from coaxlink.residual import refine_stand
from coaxlink.residual.answer import stand as judge_stand
from coaxlink.residual.answer.discrepancy_model import with_discrepancy_model
from coaxlink.residual.channels.stand_problem import reducing
from coaxlink.residual.nuisance.gaussian_process import find_process
from coaxlink.residual.regression.blocks import folds_of
from coaxlink.residual.search.joint_fit import fit_jointly
from coaxlink.rotor.polynomial import design_matrix

TERMS = ("1", "u_u", "u_l", "u_u^2", "u_l^2", "u_u u_l")


def rough(a, b):
    """Loads of a pair whose blades stall at a ratio of the speeds, the earlier the slower they are."""
    loads = steady_loads(a, b)
    ratio = np.arctan2(b, a + 1e-9)
    loads[2] -= 3.0 * (a**2 + b**2) * np.tanh((ratio - 0.5 - 0.1 * a) / 0.09)
    loads[3] -= 0.12 * (a**2 + b**2) * np.tanh((ratio - 0.4 + 0.1 * a) / 0.06)
    loads[1] += 0.04 * np.tanh((a - 0.45) / 0.09)
    return loads


def test_a_process_says_how_well_it_knows_a_row():
    rng = np.random.default_rng(4)
    u = rng.uniform(0.15, 0.95, (600, 2))
    u[580:, 1] = 0.02 * u[580:, 0]  # one piece of the log alone shows a lower rotor this slow
    fold = folds_of(30)[np.arange(600) // 20]
    load = rough(*u.T)[3] + 0.006 * rng.standard_normal(600)
    process, deviation = find_process(u, load, fold, 0.006, 1.5, TERMS, True)
    assert np.median(deviation[:580]) < 0.6
    assert np.median(deviation[580:]) > 1.0
    share = design_matrix(TERMS, *u.T).T @ process.columns(u)
    assert np.max(np.abs(share)) < 1e-6 * len(u)


def test_a_fitted_nuisance_follows_a_pair_that_polynomials_do_not():
    t, a, b = ramps(2000)
    calm = refine_stand(log_of(t, a, b, rough(a, b)))
    assert names(calm) == [] and not calm.unexplained
    assert over(calm) < 1.1
    assert any("Gaussian process" in note for note in calm.notes)
    # what polynomials do not follow is told first, with its size, and in the JSON
    held = {s.channel: s.rms for s in calm.surface}
    powers = np.stack([a**i * b**j for i in range(5) for j in range(5 - i)], axis=1)
    torque = rough(a, b)[3]
    missed = np.std(torque - powers @ np.linalg.lstsq(powers, torque, rcond=None)[0])
    assert held["lower_torque"] == pytest.approx(missed, rel=0.3)
    assert verdict(calm).startswith("no effect found, but the loads are no polynomials of the speeds")
    assert {s["channel"] for s in calm.to_json()["surface"]} == set(held)
    celsius = 15.0 + 18.0 * np.tanh(6.0 * (t / t[-1] - 0.5))
    thin = rough(a, b) * 288.15 / (celsius + 273.15)
    warm = refine_stand(log_of(t, a, b, thin, air_temperature_C=celsius))
    assert names(warm) == ["air_density"] and not warm.unexplained
    assert over(warm) < 1.1


def test_speeds_that_the_log_shows_once_are_not_judged():
    t, a, b = ramps(1500)
    b = np.where((t > 60.0) & (t < 64.0), 0.05 + 0.03 * np.sin(t), np.maximum(b, 0.25))
    loads = rough(a, b)
    loads[3] += 0.4 * a**2 * np.exp(-(((b - 0.05) / 0.03) ** 2))
    answer = refine_stand(log_of(t, a, b, loads))
    assert names(answer) == []
    assert over(answer) < 1.1
    assert any("no other part of the log" in note for note in answer.notes)


def test_a_fitted_nuisance_that_polynomials_follow_stays_one():
    t, a, b = ramps(900)
    answer = refine_stand(log_of(t, a, b, steady_loads(a, b)))
    assert names(answer) == [] and over(answer) < 1.1
    assert not any("Gaussian process" in note for note in answer.notes)


def test_throttles_that_are_alike_for_a_while_are_no_copy_where_nothing_contradicts():
    t, a, b = ramps(1300)
    b = np.where((t > 60.0) & (t < 82.0), a, np.maximum(b, 0.3))
    loads = steady_loads(a, b)
    loads[3] += 0.6 * (a**2 + b**2) * np.exp(-(((np.arctan2(b, a) - 0.785) / 0.02) ** 2))
    log = log_of(t, a, b, loads, upper_throttle=a, lower_throttle=b)
    answer = refine_stand(log.without("upper_rpm", "lower_rpm"))
    assert names(answer) == [] and not answer.suspect_data


def test_a_short_log_of_a_lower_rotor_at_one_speed_flags_nobody():
    """Its load goes up and down with the upper rotor's wake; the tachometer is right."""
    a = np.random.default_rng(0).uniform(0.1, 0.95, 24)
    answer = refine_stand(log_of(2.0 * np.arange(24.0), a, 0.0 * a + 0.5, rough(a, 0.0 * a + 0.5)))
    assert names(answer) == [] and answer.suspect_data == ()


def test_what_stood_in_for_the_polynomials_goes(monkeypatch):
    """A friction of the rig, claimed beside thin air, that a following nuisance does not need."""
    judged = []
    monkeypatch.setattr(judge_stand, "with_discrepancy_model", lambda j: judged.append(j) or j)
    t, a, b = ramps(2000)
    celsius = 15.0 + 18.0 * np.tanh(6.0 * (t / t[-1] - 0.5))
    thin = rough(a, b) * 288.15 / (celsius + 273.15)
    refine_stand(log_of(t, a, b, thin, air_temperature_C=celsius))
    (j,) = judged
    friction = next(o for o in j.problem.options if o.name == "hysteresis" and "upper" in o.shape)
    more = dataclasses.replace(j.selection, members=[*j.selection.members, friction])
    bare = j.problem.frame
    joint, _ = fit_jointly(j.problem, more, bare, (), reducing(bare))
    assert {m.name for m in joint.members} == {"air_density", "hysteresis"}
    after = with_discrepancy_model(dataclasses.replace(j, selection=more, joint=joint))
    assert [m.name for m in after.joint.members] == ["air_density"]
    assert [m.name for m in after.selection.members] == ["air_density"]
    assert any(s.name == "hysteresis" and "needless" in s.why for s in after.selection.trace)


def test_a_stall_of_the_blades_is_named_without_a_rotor_model():
    t, a, b = ramps(2000)
    loads = steady_loads(a, b)
    for row, u in enumerate((a, a, b, b)):  # lift goes, drag comes: both rotors alike
        loads[row] *= 1.0 + (1.0, -1.0)[row % 2] * -1.2 * np.maximum(u - 0.6, 0.0) ** 2
    answer = refine_stand(log_of(t, a, b, loads))
    assert names(answer) == ["blade_speed_law"]
    found = {p.name: p.value for p in answer.effects[0].parameters}
    assert found["tip"] == pytest.approx(0.6, abs=0.1)
    assert over(answer) < 1.1


@pytest.mark.parametrize("seed", [0, 4])
def test_a_pair_of_another_power_under_coloured_noise_is_clean(seed):
    """Loads that grow with the speed's power of 1.8, and cells whose noise is 0.8 alike from row to row."""
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    for row, u in enumerate((a, a, b, b)):
        loads[row] *= np.maximum(u, 0.02) ** (-0.17, -0.24)[row % 2]
    white = np.random.default_rng(seed).standard_normal((4, 1700))
    size = 0.006 * np.quantile(np.abs(loads), 0.95, axis=1)
    loads += size[:, None] * lfilter([1.0], [1.0, -0.8], white, axis=1)[:, 200:]
    answer = refine_stand(log_of(t, a, b, loads))
    assert names(answer) == [] and not answer.ambiguous and not answer.unexplained


def test_one_rotor_that_bends_is_no_law_of_the_blades():
    t, a, b = ramps(2000)
    loads = steady_loads(a, b)
    loads[0] *= 1.0 - 1.2 * np.maximum(a - 0.6, 0.0) ** 2  # thrust of the upper rotor alone
    answer = refine_stand(log_of(t, a, b, loads))
    assert "blade_speed_law" not in names(answer)
