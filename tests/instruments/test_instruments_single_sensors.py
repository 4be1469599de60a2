"""One sensor that lies in some rows: spikes, a column that stands still, another gain for a while."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.instruments.stand.suspects import find_suspects
from coaxlink.residual import refine_stand

RPM, ROWS = 5400.0, 400


def visited(seed: int, rows: int = ROWS) -> Samples:
    """Points of both throttles in random order, one row each, with a supply and a current that move."""
    random = np.random.default_rng(seed)
    throttle = random.uniform(0.2, 0.95, (rows, 2))
    u, v = (throttle * (1.07 - 0.12 * throttle)).T
    loads = {
        "upper_thrust_N": 40.0 * u**2 + 3.0 * u,
        "upper_torque_Nm": 0.9 * u**2 + 0.2 * u,
        "lower_thrust_N": 42.0 * v**2 + 3.0 * v - 14.0 * u**2 + 2.0 * u * v,
        "lower_torque_Nm": 0.95 * v**2 + 0.2 * v - 0.25 * u**2,
    }
    columns = {
        "time_s": 3.0 * np.arange(rows) + random.uniform(0.0, 0.1, rows),
        "upper_throttle": throttle[:, 0],
        "lower_throttle": throttle[:, 1],
        "upper_rpm": RPM * u + 3.0 * random.standard_normal(rows),
        "lower_rpm": RPM * v + 3.0 * random.standard_normal(rows),
        "voltage_V": 24.0 - 0.6 * u**2 - 0.6 * v**2 + 0.01 * random.standard_normal(rows),
    }
    for name, clean in loads.items():
        columns[name] = clean + 0.005 * clean.max() * random.standard_normal(rows)
    return Samples(columns, "visited")


def flagged(log: Samples) -> list[tuple[str, str]]:
    return [(s.column, s.rows) for s in refine_stand(log).suspect_data]


@pytest.mark.slow
def test_spikes_of_a_tachometer_are_flagged_row_by_row() -> None:
    log = visited(1)
    read = log["lower_rpm"].copy()
    read[[20, 75, 76, 180, 333]] *= [1.35, 0.7, 1.4, 0.65, 1.3]
    answer = refine_stand(log.with_columns(lower_rpm=read))
    assert [(s.column, s.rows) for s in answer.suspect_data] == [("lower_rpm", "21, 76-77, 181, 334")]
    assert answer.effects == () and answer.suspect_data[0].why.startswith("reads -35 to +40 % here")


@pytest.mark.slow
def test_a_band_of_few_rows_is_flagged_though_slow_motors_follow_no_curve() -> None:
    levels = np.linspace(0.05, 0.95, 10)
    throttle = np.stack(np.meshgrid(levels, levels, indexing="ij"), axis=-1).reshape(-1, 2)
    random = np.random.default_rng(11)
    speeds = (
        throttle * (1.07 - 0.12 * throttle) * np.where(throttle < 0.1, random.uniform(0.3, 2, (100, 2)), 1)
    )
    u, v = speeds.T
    band = (u > 0.52) & (u < 0.62)
    columns = {
        "time_s": 3.0 * np.arange(100),
        "upper_throttle": throttle[:, 0],
        "lower_throttle": throttle[:, 1],
    }
    columns["upper_rpm"] = RPM * np.where(band, 1.05, 1.0) * u + 3.0 * random.standard_normal(100)
    columns["lower_rpm"] = RPM * v + 3.0 * random.standard_normal(100)
    columns["upper_thrust_N"] = 40.0 * u**2 + 0.05 * random.standard_normal(100)
    columns["upper_torque_Nm"] = 0.9 * u**2 + 0.001 * random.standard_normal(100)
    columns["lower_thrust_N"] = 42.0 * v**2 - 14.0 * u**2 + 2.0 * u * v + 0.05 * random.standard_normal(100)
    columns["lower_torque_Nm"] = 0.95 * v**2 - 0.25 * u**2 + 0.001 * random.standard_normal(100)
    first, last = np.flatnonzero(band)[[0, -1]] + 1
    assert flagged(Samples(columns, "map")) == [("upper_rpm", f"{first}-{last}")]


@pytest.mark.slow
def test_a_rotor_that_really_races_for_a_row_is_no_spike() -> None:
    log = visited(2)
    rows = [20, 75, 180, 333]
    u, v = log["upper_rpm"] / RPM, log["lower_rpm"].copy() / RPM
    v[rows] *= 0.7
    thrust, torque = log["lower_thrust_N"].copy(), log["lower_torque_Nm"].copy()
    thrust[rows] = (42.0 * v**2 + 3.0 * v - 14.0 * u**2 + 2.0 * u * v)[rows]
    torque[rows] = (0.95 * v**2 + 0.2 * v - 0.25 * u**2)[rows]
    assert flagged(log.with_columns(lower_rpm=RPM * v, lower_thrust_N=thrust, lower_torque_Nm=torque)) == []


@pytest.mark.slow
def test_a_supply_that_stands_still_in_some_rows_is_flagged() -> None:
    log = visited(3)
    volts = log["voltage_V"].copy()
    volts[150:230] = volts[150]
    assert flagged(log.with_columns(voltage_V=volts)) == [("voltage_V", "151-230")]


@pytest.mark.slow
def test_a_number_written_down_for_a_session_is_no_fault() -> None:
    log = visited(5)
    time = log["time_s"] + np.where(np.arange(ROWS) >= 200, 3600.0, 0.0)
    air = np.where(np.arange(ROWS) >= 200, 18.5, 21.0 + 0.1 * np.random.default_rng(5).standard_normal(ROWS))
    assert flagged(log.with_columns(time_s=time, air_temperature_C=air)) == []


@pytest.mark.slow
def test_a_rotor_that_loses_both_loads_for_a_stretch_has_sound_cells() -> None:
    log = visited(7)
    loads = {name: log[name].copy() for name in ("lower_thrust_N", "lower_torque_Nm")}
    for load in loads.values():
        load[220:275] *= 0.88
    assert flagged(log.with_columns(**loads)) == []


@pytest.mark.parametrize("gain", [0.88, 1.6])
def test_a_cell_of_another_gain_for_a_while_is_flagged(gain: float) -> None:
    """The rotor's other load goes on, and before and after rows at like speeds read otherwise."""
    log = visited(8)
    load = log["lower_torque_Nm"].copy()
    load[220:300] *= gain
    found = find_suspects(stand_frame(log.with_columns(lower_torque_Nm=load), None))
    assert [s.column for s in found.suspects] == ["lower_torque_Nm"]
    assert np.mean(found.bad == ((np.arange(ROWS) >= 220) & (np.arange(ROWS) < 300))) > 0.95


@pytest.mark.slow
def test_rows_in_another_order_are_sorted_by_their_time_and_told() -> None:
    log = visited(9)
    mixed = log.take(np.random.default_rng(9).permutation(ROWS))
    sorted_again, plain = refine_stand(mixed), refine_stand(log)
    assert any("rows are sorted by it" in note for note in sorted_again.notes)
    after = {name: (c.rmse_after, c.noise_floor) for name, c in plain.channels.items()}
    assert {n: (c.rmse_after, c.noise_floor) for n, c in sorted_again.channels.items()} == after


@pytest.mark.slow
def test_a_clock_that_starts_anew_for_every_point_sorts_nothing() -> None:
    log = visited(10)
    clock = np.arange(ROWS) % 4 + np.random.default_rng(10).uniform(0.0, 0.05, ROWS)
    answer = refine_stand(log.with_columns(time_s=clock))
    assert not any("sorted" in note for note in answer.notes)
