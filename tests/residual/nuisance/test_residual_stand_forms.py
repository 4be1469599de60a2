"""Stand logs whose effects follow other laws than the analysis has, and pairs that no polynomial follows."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from residual_rig import steady_loads
from residual_stand_logs import log_of, model, names, over, ramps

from coaxlink.effects.hysteresis import direction, fading, slipping
from coaxlink.residual import refine_stand


def test_friction_that_takes_a_way_to_turn_is_hysteresis_and_nothing_else():
    t, a, b = ramps()
    loads = steady_loads(a, b)
    for row, u in ((0, a), (2, b)):  # a viscous element in the travelled way: it fades
        state = np.zeros(len(u))
        for k in range(1, len(u)):
            move = u[k] - u[k - 1]
            state[k] = state[k - 1] * np.exp(-abs(move) / 0.06) + np.sign(move) * -np.expm1(-abs(move) / 0.06)
        loads[row] *= 1.0 - 0.06 * state
        loads[row + 1] *= 1.0 - 0.04 * state
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["hysteresis"]
    assert over(answer) < 1.05


def test_growth_of_lift_at_the_tips_is_a_blade_speed_law_though_the_nuisance_takes_most_of_it():
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    for row, u in ((0, a), (1, a), (2, b), (3, b)):
        loads[row] *= 1.0 + 0.09 * (u > 0.5) * ((u - 0.5) / 0.4) ** 2
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["blade_speed_law"]
    assert over(answer) < 1.12


def test_cold_air_all_along_is_density_and_no_other_law():
    t, a, b = ramps()
    celsius = -12.0 + 9.0 * np.sin(0.05 * t)  # 10 % denser than where the model holds
    loads = steady_loads(a, b) * 288.15 / (celsius + 273.15)
    answer = refine_stand(log_of(t, a, b, loads, air_temperature_C=celsius), model())
    assert names(answer) == ["air_density"]
    assert over(answer) < 1.1


def test_a_pair_that_no_polynomial_follows_still_shows_a_drift():
    t, a, b = ramps(1200)
    loads = steady_loads(a, b)
    angle = np.arctan2(b, a + 1e-9)
    whole = a**2 + b**2
    loads[2] = whole * (70.0 * np.sin(angle) - 35.0 * np.cos(angle) / (1.0 + 6.0 * angle))
    loads[3] = whole * (1.7 * np.sin(angle) - 1.2 * np.exp(-9.0 * angle))
    calm = refine_stand(log_of(t, a, b, loads, seed=1))
    assert names(calm) == []
    loads[2] += 2.0 * t / t[-1]
    answer = refine_stand(log_of(t, a, b, loads, seed=1))
    assert names(answer) == ["sensor_drift"]
    assert answer.channels["lower_thrust"].rmse_after < 1.15 * answer.channels["lower_thrust"].noise_floor
    assert any("polynomials do not follow" in note for note in answer.notes)


def test_no_tachometer_is_flagged_without_a_throttle_to_witness():
    t, a, b = ramps()
    answer = refine_stand(log_of(t, a * (1 + 0.06 * (a > 0.5)), b, steady_loads(a, b)), model())
    assert not any("rpm" in s.column for s in answer.suspect_data)


def test_a_cell_stuck_where_the_load_stands_still():
    t = 0.1 * np.arange(600)
    levels = np.repeat(np.linspace(0.2, 0.9, 10), 60)
    loads = steady_loads(levels, levels[::-1])
    log = log_of(t, levels, levels[::-1], loads)
    stuck = log["upper_torque_Nm"].copy()
    stuck[305:350] = stuck[305]
    answer = refine_stand(log.with_columns(upper_torque_Nm=stuck), model())
    assert [s.column for s in answer.suspect_data] == ["upper_torque_Nm"]
    assert "306-350" in answer.suspect_data[0].rows


def test_a_long_log_is_judged_on_stretches(monkeypatch):
    monkeypatch.setattr(
        sys.modules["coaxlink.residual.answer.stand"], "MANY_ROWS", 2000
    )  # as a hundred thousand would be
    rows = 4000
    t = 0.02 * np.arange(rows)
    a, b = 0.45 * (1 - np.cos(0.21 * t)), 0.45 * (1 - np.cos(0.057 * t))
    loads = steady_loads(a, b)
    loads[2] += 2.0 * t / t[-1]
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["sensor_drift"]
    assert any("in 2 is judged" in note for note in answer.notes)
    assert max(c.held_out_rows for c in answer.channels.values()) < rows


def test_a_memory_fades_as_it_does_one_row_at_a_time():
    time_profile = np.cumsum(0.03 * np.random.default_rng(1).standard_normal(317))
    state, expected = 0.0, []
    for move in np.diff(time_profile, prepend=time_profile[0]):
        state = np.sign(move) + (state - np.sign(move)) * np.exp(-abs(move) / 0.08)
        expected.append(state)
    assert np.allclose(fading(time_profile, 0.08), expected)


@pytest.mark.parametrize("rows", [1, 7, 400])
def test_slipping_elements_are_those_run_one_row_at_a_time(rows):
    time_profile = np.cumsum(np.random.default_rng(3).normal(0.0, 0.02, rows))
    ways = np.array([0.01, 0.1])
    state, expected = np.zeros(2), []
    for k in range(rows):
        move = (time_profile[k] - time_profile[k - 1]) if k else 0.0
        state = np.clip(state + 2.0 * move / ways, -1.0, 1.0)
        expected.append(state)
    assert np.allclose(slipping(time_profile, ways), expected)


def test_a_sweep_that_jumps_back_has_no_way_down():
    class Frame:
        throttles = None
        speeds = np.column_stack([np.tile(np.linspace(0.0, 0.9, 10), 5)] * 2)

    assert not np.any(direction(Frame(), 0) < 0)


def dragged(load, width):
    """A load read through a slide that sticks until it is `width` behind."""
    held, out = load[0], []
    for x in load:
        held = min(max(held, x - width), x + width)
        out.append(held)
    return np.array(out)


def test_two_slides_of_one_width_are_one_hysteresis():
    """The loads differ, so the shares do; and while one rotor is held its tachometer trembles."""
    up = np.arange(0.0, 0.9, 0.01)
    leg = np.concatenate([up, up[::-1]])
    still = np.ones_like(leg)
    a = np.concatenate([leg, leg, *(h * still for h in (0.3, 0.5, 0.7, 0.9)), 0.0 * still])
    b = np.concatenate([leg, 0.6 * still, *(leg for _ in range(5))])
    rng = np.random.default_rng(11)
    loads = steady_loads(a, b)
    for c in (0, 2):
        loads[c] = dragged(loads[c], 2.0)
    read = [np.maximum(u + 5e-4 * rng.standard_normal(len(u)), 0.0) for u in (a, b)]
    answer = refine_stand(log_of(0.1 * np.arange(len(a)), *read, loads), model())
    assert names(answer) == ["hysteresis"]
    assert over(answer) < 1.08
    assert {p.name for p in answer.effects[0].parameters} >= {"lower_over_upper"}


def test_what_kept_another_out_and_goes_lets_it_in():
    """A drift that takes up a part of what the lower rotor does to the upper, beside a rig that sticks."""
    up = np.arange(0.0, 0.9, 0.01)
    leg = np.concatenate([up, up[::-1]])
    still = np.ones_like(leg)
    a = np.concatenate([leg, leg, *(h * still for h in (0.3, 0.5, 0.7)), 0.0 * still])
    b = np.concatenate([leg, 0.3 * still, *(leg for _ in range(4))])
    loads, alone = steady_loads(a, b), steady_loads(0.0 * a, b)[2]
    loads[0] -= 6.0 * a * np.sqrt(np.maximum(alone, 0.0) / 60.0) * (b > 0.0)
    for c in (0, 2):
        loads[c] = dragged(loads[c], 1.5)
    answer = refine_stand(log_of(0.1 * np.arange(len(a)), a, b, loads, seed=3), model())
    assert names(answer) == ["hysteresis", "lower_on_upper_interference"]
    assert over(answer) < 1.08
    assert any(s.name == "sensor_drift" and "leaves most" in s.why for s in answer.trace)
