"""Stand logs of a rig of its own: effects by name, faults as suspects, the strange as unexplained."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, run, steady_loads

from coaxlink import files
from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.instruments.stand.repeats import repeated_rows
from coaxlink.residual import refine_stand
from coaxlink.rotor import load_rotor_model

CASES = {
    "clean": ({}, []),
    "battery": ({"battery": 0.7, "rpm": False}, ["battery_voltage"]),
    "drift": ({"drift": 0.35}, ["sensor_drift"]),
    "spacing": ({"spacing": 0.5}, ["rotor_spacing"]),
    "heat": ({"heat": 0.12, "rpm": False}, ["motor_heating"]),
    "air and drift": ({"air": 1.0, "drift": 0.35}, ["air_density", "sensor_drift"]),
}


@pytest.fixture(scope="module")
def paper():
    return load_rotor_model(files.example("rotor_paper.toml"))


def samples(**true) -> Samples:
    return Samples(run(**true), "rig.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_named_with_the_paper_model_given(name, paper):
    true, names = CASES[name]
    answer = refine_stand(samples(seed=3, **true), paper)
    assert sorted(e.name for e in answer.effects) == names
    assert answer.ambiguous == () and answer.suspect_data == ()
    for effect in answer.effects:
        for channel in effect.channels:
            c = answer.channels[channel]
            assert c.rmse_after < c.rmse_before and c.rmse_after < 1.35 * c.noise_floor
    assert answer.model is not None and [e.name for e in answer.model.effects] == [
        e.name for e in answer.effects
    ]


def test_a_lying_tachometer_is_flagged_not_explained(paper):
    answer = refine_stand(samples(seed=6, tachometer=0.06), paper)
    assert answer.effects == () and [s.column for s in answer.suspect_data] == ["lower_rpm"]


@pytest.mark.slow
def test_swapped_labels_stop_everything(paper):
    for model in (paper, None):
        answer = refine_stand(samples(seed=7, swapped=1), model)
        assert answer.effects == () and "swapped" in answer.suspect_data[0].why


@pytest.mark.slow
def test_stuck_and_repeated_rows_are_named_and_left_out(paper):
    stuck = refine_stand(samples(seed=8, stuck=1), paper)
    assert [(s.column, s.rows) for s in stuck.suspect_data] == [("upper_torque_Nm", "101-130")]
    assert stuck.effects == () and stuck.channels["upper_torque"].rmse_after < 0.0095
    repeated = refine_stand(samples(seed=8, repeated=1), paper)
    assert [s.rows for s in repeated.suspect_data] == ["201-230"] and repeated.effects == ()


def test_readings_in_steps_agree_by_chance_and_are_no_copy(paper):
    """Two speeds held in turn, cells that round to a tenth of their noise: three rows agree."""
    rng = np.random.default_rng(0)
    a, b = np.tile(np.repeat([[0.5, 0.7], [0.6, 0.4]], 20, axis=1), 20)
    loads = steady_loads(a, b) + np.array([[0.2], [0.004], [0.2], [0.004]]) * rng.standard_normal((4, len(a)))
    names = {"upper_thrust_N": 0.02, "upper_torque_Nm": 0.0004}
    columns = {n: np.round(load / step) * step for load, (n, step) in zip(loads, names.items(), strict=False)}
    rpm = {f"{s}_rpm": FULL_RPM * u + rng.standard_normal(len(a)) for s, u in (("upper", a), ("lower", b))}
    log = Samples({"time_s": np.arange(len(a)) * 1.0, **rpm, **columns}, "steps.csv")
    frame = stand_frame(log, paper)
    twins = len(a) - len(np.unique(frame.measured[:, :2], axis=0))
    assert twins > 20 and not repeated_rows(frame).any()
    whole = {name: np.concatenate([column, column[100:130]]) for name, column in log.columns.items()}
    whole["time_s"] = np.arange(len(a) + 30) * 1.0
    assert np.flatnonzero(repeated_rows(stand_frame(Samples(whole, "copied.csv"), paper))).tolist() == list(
        range(len(a), len(a) + 30)
    )


@pytest.mark.slow
def test_a_cell_that_drops_to_nothing_is_named_and_left_out(paper):
    """A loose plug: for a few rows now and then one cell reads next to nothing and the others go on."""
    for model in (paper, None):
        columns, rows = run(seed=8), np.r_[104:107, 121:123, 140:146, 211:212]
        columns["upper_torque_Nm"][rows] = 0.001 * np.arange(len(rows))
        answer = refine_stand(Samples(columns, "rig.csv"), model)
        (suspect,) = answer.suspect_data
        assert (suspect.column, suspect.rows) == ("upper_torque_Nm", "105-107, 122-123, 141-146, 212")
        assert answer.effects == () and answer.unexplained == ()


@pytest.mark.slow
def test_a_rotor_at_rest_dropped_nothing(paper):
    """Both of its cells read nothing: it was stopped, and its throttle does not say so."""
    columns, rows = run(seed=8, rpm=False), slice(121, 126)
    columns["upper_torque_Nm"][rows] = columns["upper_thrust_N"][rows] = 0.0
    answer = refine_stand(Samples(columns, "rig.csv"), paper)
    assert "a plug" not in "".join(s.why for s in answer.suspect_data)


@pytest.mark.slow
def test_a_load_that_goes_through_zero_on_a_ramp_dropped_nothing(paper):
    """Closer rotors than the model's: where it has the lower one pull 10 N, it pulls down and then up."""
    up = np.linspace(0.1, 0.95, 300)
    a, b = np.tile([0.9] * 600, 2), np.tile(np.concatenate([up, up[::-1]]), 2)
    loads, near = steady_loads(a, b), np.arange(1200) < 600
    loads[2] -= np.where(near, 20.0 * a**2, 0.0)
    loads += np.array([[0.4], [0.008], [0.4], [0.008]]) * np.random.default_rng(1).standard_normal((4, 1200))
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    columns = dict(zip(names, loads, strict=True)) | {"rotor_spacing_m": np.where(near, 0.06, 0.12)}
    columns |= {"upper_rpm": FULL_RPM * a, "lower_rpm": FULL_RPM * b, "time_s": 0.1 * np.arange(1200)}
    answer = refine_stand(Samples(columns, "rig.csv"), paper)
    assert answer.suspect_data == () and [e.name for e in answer.effects] == ["rotor_spacing"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8])
def test_two_coarse_cells_that_agree_for_a_while_are_no_copy(paper, seed):
    """In steps of two noises two torques that are near one another often read the same."""
    columns, step = run(seed=seed), 0.02
    a, b = (np.round(columns[f"{rotor}_torque_Nm"] / step) * step for rotor in ("upper", "lower"))
    near = np.flatnonzero(np.abs(a - b) < 0.15)
    b[near] = np.where(np.arange(len(near)) % 8 < 7, a[near], a[near] + step)  # seven times in a row
    columns |= {"upper_torque_Nm": a, "lower_torque_Nm": b}
    assert refine_stand(Samples(columns, "rig.csv"), paper).suspect_data == ()


@pytest.mark.slow
def test_air_that_thins_with_the_clock_is_air_or_the_cells(paper):
    answer = refine_stand(samples(seed=3, air=1.0), paper)
    named = {e.name for e in answer.effects}.union(*(a.names for a in answer.ambiguous))
    assert "air_density" in named and named <= {"air_density", "sensor_drift"}


@pytest.mark.slow
def test_a_bump_of_no_known_physics_is_unexplained(paper):
    answer = refine_stand(samples(seed=9, bump=4.0), paper)
    assert answer.effects == ()
    assert "upper_thrust" in {u.channel for u in answer.unexplained}
    assert any("upper_speed" in variable for u in answer.unexplained for variable in u.depends_on)


@pytest.mark.slow
def test_clean_rigs_get_nothing(paper):
    for seed in range(20, 22):
        answer = refine_stand(samples(seed=seed, rpm=seed % 2 == 0), paper if seed % 3 else None)
        assert answer.effects == () and answer.suspect_data == () and answer.ambiguous == (), seed


@pytest.mark.slow
def test_what_is_missing_is_said(paper):
    columns = run(seed=1)
    del columns["voltage_V"]
    why = {r.name: r.why for r in refine_stand(Samples(columns, "rig.csv"), paper).rejected}
    assert "voltage_V is not in the log" in why["battery_voltage"]
    for name in ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm"):
        del columns[name]
    with pytest.raises(InputError, match="upper_thrust_N"):
        refine_stand(Samples(columns, "rig.csv"), paper)
    with pytest.raises(InputError, match="rows; 16 are needed to find an effect"):
        refine_stand(Samples(run(), "rig.csv").take(np.arange(15)))
    few = refine_stand(Samples(run(), "rig.csv").take(np.arange(0, 240, 20)), paper)
    assert few.effects == () and any("too few to identify" in note for note in few.notes)
    assert few.channels["upper_thrust"].rmse_before > 0
