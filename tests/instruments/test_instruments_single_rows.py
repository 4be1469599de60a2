"""A cell that jumps for single rows or comes late; a coarse tachometer that is no list of set-points.

Loads are of blades whose thrust coefficient falls with the wake's inflow (a square root), none of a
polynomial; rows come 20 times a second.
"""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.instruments.stand.suspects import find_suspects
from coaxlink.residual import refine_stand

FULL_RPM, RATE = 5400.0, 20.0


def bench(seed: int, *, holds: int = 50, grain_rpm: float = 0.0, rotor_lag_s: float = 0.0) -> Samples:
    """Ramps between random levels with rests on them; what turns may follow what was asked for late."""
    random = np.random.default_rng(seed)
    levels = np.repeat(random.uniform(0.35, 0.95, (holds, 2)), 2, axis=0)
    at = np.cumsum(np.tile([0.8, 1.7], holds))
    time = np.arange(0.0, at[-1], 1.0 / RATE)
    asked = np.column_stack([np.interp(time, at, x) for x in levels.T])
    turns = asked.copy()
    for k in range(1, len(time)) if rotor_lag_s else ():
        turns[k] = turns[k - 1] + (asked[k] - turns[k - 1]) / (rotor_lag_s * RATE)
    u, v = turns.T
    inflow = np.sqrt(0.3 * u**2 + 0.05 * v**2)
    loads = {
        "upper_thrust_N": 52.0 * u**2,
        "upper_torque_Nm": 1.1 * u**2,
        "lower_thrust_N": 55.0 * v * (v - 0.45 * inflow),
        "lower_torque_Nm": 1.2 * v**2 - 0.2 * v * inflow,
    }
    read = FULL_RPM * asked * (1.0 + 8e-4 * random.standard_normal(asked.shape))
    if grain_rpm:
        read = np.round(read / grain_rpm) * grain_rpm
    columns = {"time_s": time, "upper_rpm": read[:, 0], "lower_rpm": read[:, 1]}
    for name, clean in loads.items():
        columns[name] = clean + 0.004 * clean.max() * random.standard_normal(len(time))
    return Samples(columns, "bench")


def suspects(log: Samples) -> list[tuple[str, str]]:
    """Columns that are flagged, and why."""
    return [(s.column, s.why) for s in find_suspects(stand_frame(log, None)).suspects]


@pytest.mark.parametrize("seed", range(3))
def test_spikes_of_one_cell_are_flagged_and_left_out(seed: int) -> None:
    log = bench(seed)
    assert suspects(log) == []
    random = np.random.default_rng(50 + seed)
    hit = random.uniform(size=log.rows) < 0.012
    spoiled = log["upper_thrust_N"] + hit * random.choice([-1.0, 1.0], log.rows) * 25.0
    log = log.with_columns(upper_thrust_N=spoiled)
    ((column, why),) = suspects(log)
    assert column == "upper_thrust_N" and "spikes" in why
    bad = find_suspects(stand_frame(log, None)).bad
    assert np.mean(bad[hit]) > 0.6 and not np.any(bad & ~hit)  # those on ramps may be the rotor's


@pytest.mark.parametrize("late_s", [0.6, 1.5])
def test_one_cell_that_comes_late_is_flagged_with_its_seconds(late_s: float) -> None:
    log = bench(3)
    rows = round(late_s * RATE)
    behind = np.concatenate([np.repeat(log["lower_thrust_N"][0], rows), log["lower_thrust_N"][:-rows]])
    ((column, why),) = suspects(log.with_columns(lower_thrust_N=behind))
    assert column == "lower_thrust_N" and f"comes {late_s:.2g} s after the speeds" in why


def test_a_rotor_that_is_late_makes_no_cell_late() -> None:
    assert suspects(bench(4, rotor_lag_s=0.5)) == []


def test_a_tachometer_that_counts_in_twelves_shows_speeds_and_not_set_points() -> None:
    coarse = bench(5, grain_rpm=12.0)
    assert len(np.unique(coarse["upper_rpm"])) < 0.2 * coarse.rows  # so few that they could be set-points
    assert not stand_frame(coarse, None).driven
    held = {name: np.round(coarse[name] / 500.0) * 500.0 for name in ("upper_rpm", "lower_rpm")}
    assert stand_frame(coarse.with_columns(**held), None).driven


@pytest.mark.slow
def test_where_speeds_were_measured_no_rotor_is_late_behind_them() -> None:
    """Cells with a filter, behind a tachometer: a lag there is, and no rotor's."""
    log = bench(6, holds=15)
    keep, filtered = np.exp(-1.0 / (0.25 * RATE)), {}
    for name in ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm"):
        y = log[name].copy()
        for k in range(1, log.rows):
            y[k] = keep * y[k - 1] + (1.0 - keep) * log[name][k]
        filtered[name] = y
    answer = refine_stand(log.with_columns(**filtered))
    reported = {e.name for e in answer.effects} | {n for a in answer.ambiguous for n in a.names}
    assert "rotor_lag" not in reported
    assert any("after the speeds" in note and "upper_thrust 0.1" in note for note in answer.notes)
