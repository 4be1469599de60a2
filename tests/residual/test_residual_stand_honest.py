"""Stand logs in which an effect could be named that is not there, and the names that are right."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, run, steady_loads

from coaxlink import files
from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
CONTEXT = ("voltage_V", "air_temperature_C", "motor_temperature_C", "rotor_spacing_m", "operator_mood")


@pytest.fixture(scope="module")
def paper():
    return load_rotor_model(files.example("rotor_paper.toml"))


def refined(columns, model=None, *without):
    return refine_stand(Samples({k: v for k, v in columns.items() if k not in without}, "test", ()), model)


def names(answer):
    return [e.name for e in answer.effects]


@pytest.mark.slow
def test_a_dead_band_shows_where_a_rotor_stands_at_rest(paper):
    """Levels 0, 0.2 .. 1: no throttle between, but the whole scale is stretched."""
    columns = run(seed=9)
    level = np.round(columns["upper_throttle"] * 5.0) / 5.0, np.round(columns["lower_throttle"] * 5.0) / 5.0
    u = [np.maximum(x - 0.08, 0.0) / 0.92 for x in level]
    rng = np.random.default_rng(1)
    loads = steady_loads(*u) + np.array([[0.3], [0.006], [0.3], [0.006]]) * rng.standard_normal(
        (4, len(u[0]))
    )
    for name, throttle, speed in zip(("upper", "lower"), level, u, strict=True):
        columns[f"{name}_throttle"] = throttle
        columns[f"{name}_rpm"] = FULL_RPM * speed + 2.0 * rng.standard_normal(len(speed)) * (speed > 0.0)
    named = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    answer = refined(columns | dict(zip(named, loads, strict=True)), paper, *CONTEXT)
    assert names(answer) == ["dead_band"]


def test_a_tachometer_that_stands_still_is_flagged_with_its_rows(paper):
    columns = run(seed=10, throttle=False)
    order = np.random.default_rng(3).permutation(len(columns["time_s"]))
    columns = {k: (v if k == "time_s" else v[order]) for k, v in columns.items()}
    columns["lower_rpm"][200:280] = columns["lower_rpm"][200]
    answer = refined(columns, paper, *CONTEXT)
    (suspect,) = answer.suspect_data
    assert not answer.effects and suspect.column == "lower_rpm" and suspect.rows.startswith("201-280")


@pytest.mark.slow
def test_a_stretched_scale_is_a_dead_band_though_no_throttle_was_low(paper):
    rng = np.random.default_rng(4)
    throttle = rng.uniform(0.35, 1.0, (2, 400))
    loads = steady_loads(*((throttle - 0.12) / 0.88))
    loads += np.array([[0.3], [0.006], [0.3], [0.006]]) * rng.standard_normal(loads.shape)
    columns = {"time_s": np.arange(400.0), "upper_throttle": throttle[0], "lower_throttle": throttle[1]}
    named = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    answer = refined(columns | dict(zip(named, loads, strict=True)), paper)
    assert names(answer) == ["dead_band"]
    assert {p.name: p.value for p in answer.effects[0].parameters}["band"] == pytest.approx(0.12, abs=0.02)


@pytest.mark.slow
def test_a_band_that_no_throttle_entered_is_not_seen():
    """A throttle's own curve, no cubic; the lowest throttle is at twice what a band would be."""
    columns = run(seed=14)
    for rotor in ("upper", "lower"):
        u = np.maximum(columns[f"{rotor}_rpm"] / FULL_RPM, 0.3)
        columns[f"{rotor}_rpm"] = FULL_RPM * u
        columns[f"{rotor}_throttle"] = 0.55 * u + 0.45 * u**2.2
    rng = np.random.default_rng(15)
    u = np.stack([columns["upper_rpm"], columns["lower_rpm"]]) / FULL_RPM
    loads = steady_loads(*u)
    loads += np.array([[0.15], [0.003], [0.15], [0.003]]) * rng.standard_normal(loads.shape)
    for name, load in zip(LOADS, loads, strict=True):
        columns[name] = load
    for rotor in ("upper", "lower"):
        columns[f"{rotor}_rpm"] = columns[f"{rotor}_rpm"] + 1.0 * rng.standard_normal(u.shape[1])
    assert names(refined(columns)) == []


@pytest.mark.slow
def test_a_throttle_with_empty_cells_is_left_out(paper, capfd):
    columns = run(seed=4, battery=0.8)
    columns["upper_throttle"] = np.where(
        np.arange(len(columns["time_s"])) % 3, columns["upper_throttle"], np.nan
    )
    answer = refined(columns, paper)
    assert any(note.startswith("upper_throttle: empty in") for note in answer.notes)
    assert not answer.effects and not answer.suspect_data
    assert "DLASCL" not in "".join(capfd.readouterr())  # of LAPACK, which writes where it likes


@pytest.mark.slow
def test_empty_cells_of_a_load_beside_a_wrong_sign_leave_numbers(paper):
    columns = run(seed=4)
    rows = np.arange(len(columns["time_s"]))
    columns["upper_thrust_N"] = np.where(rows % 4, columns["upper_thrust_N"], np.nan)
    columns["lower_thrust_N"] = np.where(
        rows < len(rows) // 2, -columns["lower_thrust_N"], columns["lower_thrust_N"]
    )
    answer = refined(columns, paper)
    assert [s.column for s in answer.suspect_data] == ["lower_thrust_N"]
    assert all(np.isfinite([c.rmse_after, c.noise_floor]).all() for c in answer.channels.values())


@pytest.mark.slow
def test_cells_without_numbers_at_the_librarys_door(paper):
    columns = run(seed=4, spacing=0.5)
    rows = np.arange(len(columns["time_s"]))
    columns["motor_temperature_C"] = np.where(rows % 5, columns["motor_temperature_C"], np.nan)
    columns["upper_rpm"] = np.where(rows % 7 == 3, np.nan, columns["upper_rpm"])
    columns["lower_torque_Nm"] = np.full(len(rows), np.nan)
    answer = refined(columns, paper)
    assert names(answer) == ["rotor_spacing"] and "lower_torque" not in answer.channels
    determined = " ".join(answer.notes)
    assert f"{np.sum(rows % 7 == 3)} rows without a number in upper_rpm are left out" in determined
    assert (
        "motor_temperature_C: empty in" in determined and "lower_torque_Nm: no row has a number" in determined
    )
    columns["upper_rpm"][::2] = np.nan
    columns["lower_rpm"][1::2] = np.nan
    with pytest.raises(InputError, match="no row has a number in each of upper_rpm, lower_rpm"):
        refined(columns, paper)
