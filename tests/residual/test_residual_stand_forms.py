"""Stand logs whose effects follow other laws than the analysis has, and pairs that no polynomial follows."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table
from residual_rig import steady_loads
from residual_stand_logs import log_of, model, names, over, ramps

from coaxlink.effects.hysteresis import direction
from coaxlink.effects.play import fading, slipping
from coaxlink.residual import refine_stand


@pytest.mark.slow
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


@pytest.mark.slow
def test_growth_of_lift_at_the_tips_is_a_blade_speed_law_though_the_nuisance_takes_most_of_it():
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    for row, u in ((0, a), (1, a), (2, b), (3, b)):
        loads[row] *= 1.0 + 0.09 * (u > 0.5) * ((u - 0.5) / 0.4) ** 2
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["blade_speed_law"]
    assert over(answer) < 1.12


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


def test_a_memory_fades_as_it_does_one_row_at_a_time():
    time_profile = np.cumsum(0.03 * np.random.default_rng(1).standard_normal(317))
    state, expected = 0.0, []
    for move in np.diff(time_profile, prepend=time_profile[0]):
        state = np.sign(move) + (state - np.sign(move)) * np.exp(-abs(move) / 0.08)
        expected.append(state)
    assert np.allclose(fading(time_profile, 0.08), expected)


def test_slipping_elements_are_those_run_one_row_at_a_time():
    with case_table() as case:
        for rows in (1, 7, 400):
            with case(f"{rows}"):
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


@pytest.mark.slow
@pytest.mark.parametrize(("onset", "named"), [(0.45, ["blade_speed_law"]), (None, [])])
def test_without_a_model_a_law_that_sets_in_at_a_speed_is_named_and_one_that_bends_over_all_is_the_pairs_own(
    onset, named
):
    t, a, b = ramps()
    loads = steady_loads(a, b)
    for side, u in enumerate((a, b)):
        loss = 0.5 * np.maximum(u - onset, 0.0) ** 2 if onset else 0.06 * np.log(np.maximum(u, 0.1))
        loads[2 * side] *= 1.0 - loss
        loads[2 * side + 1] *= 1.0 + loss
    assert names(refine_stand(log_of(t, a, b, loads))) == named
