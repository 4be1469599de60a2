"""Forms that only the engine of evidence weighs, and meters that are not exact, against plain simulations."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from residual_rig import run

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.effects import effect
from coaxlink.residual import refine_stand
from coaxlink.residual.diagnosis.meters import calmed
from coaxlink.residual.diagnosis.stand import _forms

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


def names(columns, model=None):
    answer = refine_stand(Samples(columns, "rig.csv"), model)
    return sorted(e.name for e in answer.effects), [set(a.names) for a in answer.ambiguous]


def meter(volts, u, rows, step_s=1.0):
    return SimpleNamespace(
        time_s=step_s * np.arange(rows),
        speeds=u,
        throttles=None,
        columns={"voltage_V": volts},
        context=lambda name: volts if name == "voltage_V" else None,
    )


def read(volts, u, monkeypatch):
    monkeypatch.setattr("coaxlink.residual.diagnosis.meters.replace", lambda frame, columns: columns)
    return calmed(meter(volts, u, len(volts)))["voltage_V"]


def test_a_voltmeters_noise_is_taken_out_and_the_sag_is_left(monkeypatch):
    rng = np.random.default_rng(22)
    u = np.repeat(rng.uniform(0.3, 1.0, (60, 2)), 10, axis=0)
    current = (u**2.6).sum(axis=1)
    behind = np.empty(600)
    now = current[0]
    for k in range(600):
        now += (current[k] - now) / 40.0
        behind[k] = now
    true = 24.0 - 2.0 * np.linspace(0.0, 1.0, 600) ** 1.5 - 0.5 * current - 0.4 * behind
    noise = 0.05 * rng.standard_normal(600)
    left = read(true + noise, u, monkeypatch) - true
    assert np.std(left) < 0.4 * np.std(noise)


def test_a_supply_that_moves_from_row_to_row_stays_as_it_was_read(monkeypatch):
    rng = np.random.default_rng(23)
    u = np.repeat(rng.uniform(0.3, 1.0, (60, 2)), 10, axis=0)
    volts = 24.0 + 1.5 * np.sin(2.0 * np.pi * np.arange(600) / 7.0)
    np.testing.assert_allclose(read(volts, u, monkeypatch), volts, atol=0.02)


@pytest.mark.slow
def test_a_noisy_voltmeter_hides_no_supply(paper):
    columns = run(seed=24, battery=0.7, rpm=False)
    rng = np.random.default_rng(24)
    columns["voltage_V"] = columns["voltage_V"] * (1.0 + 0.004 * rng.standard_normal(len(columns["time_s"])))
    assert names(columns, paper) == (["battery_voltage"], [])


@pytest.mark.slow
def test_a_room_that_is_heated_in_turns_is_one_drift_of_all_cells(paper):
    columns = run(seed=25, throttle=False)
    t = columns["time_s"] / columns["time_s"][-1]
    room = np.sign(np.sin(2.0 * np.pi * 2.6 * t)) * np.abs(np.sin(2.0 * np.pi * 2.6 * t)) ** 0.7
    for name, much in zip(LOADS, (0.9, -0.02, -0.7, 0.015), strict=True):
        columns[name] = columns[name] + much * room
    assert names(columns, paper) == (["sensor_drift"], [])


@pytest.mark.slow
def test_cells_with_play_are_no_law_of_the_blades(paper):
    columns = run(seed=26, throttle=False, noise=0.5)
    for first in (0, 1):
        play = 0.05 * max(np.max(columns[name]) for name in LOADS[first::2])
        for name in LOADS[first::2]:
            columns[name] = columns[name] - play * np.tanh(columns[name] / play)
    assert names(columns, paper) == (["dead_band"], [])


def lag_frame(u, time_s):
    return SimpleNamespace(speeds=u, throttles=u, driven=False, time_s=time_s)


def lagged_by(u, time_s, numbers):
    frame = lag_frame(u, time_s)
    return u + effect("rotor_lag").stand.adds(frame, {"share": 1.0, **numbers})[:, 4:]


@pytest.mark.slow
def test_a_speed_loop_that_rings_is_that_of_its_differential_equation():
    rng = np.random.default_rng(27)
    step, damping, lag = 0.05, 0.4, 0.12
    rate = 2.0 * damping / lag
    u = np.repeat(rng.uniform(0.2, 1.0, (20, 2)), 15, axis=0)
    x, v, out = u[0].copy(), np.zeros(2), np.empty_like(u)
    for k in range(len(u)):
        for _ in range(400):
            v += step / 400 * (rate**2 * (u[k] - x) - 2.0 * damping * rate * v)
            x = x + step / 400 * v
        out[k] = x
    made = lagged_by(u, step * np.arange(len(u)), {"lag_s": lag, "damping": damping, "stepped": 1.0})
    assert np.max(out[:, 0]) > np.max(u[:, 0]) + 0.02  # it overshoots
    np.testing.assert_allclose(made[1:], out[1:], atol=2e-3)


def test_behind_a_gap_a_ramp_is_late_from_its_first_row_on():
    step, lag = 0.1, 0.4
    up, down = np.linspace(0.3, 0.8, 60), np.linspace(0.8, 0.3, 60)
    time = np.concatenate([step * np.arange(60), 30.0 + step * np.arange(60)])
    u = np.repeat(np.concatenate([up, down])[:, None], 2, axis=1)
    u[60:] -= 0.1  # the turn was in the gap, and higher up
    made = lagged_by(u, time, {"lag_s": lag})
    slope = (down[1] - down[0]) / step
    late = u[60:, 0] - lag * slope
    # the turn itself is not in the log: of its memory no more than a tenth of the lateness is left
    assert np.max(np.abs(made[61:, 0] - late[1:])) < 0.12 * lag * abs(slope)


def test_a_governor_loses_speed_where_its_supply_runs_out(paper):
    frame = stand_frame(Samples(run(seed=28), "rig.csv"), paper)
    tracing = effect("battery_voltage").stand
    volts = frame.context("voltage_V")
    numbers = {"speed_exponent": 1.0, "reference_voltage_V": np.median(volts), "cap": 0.8, "soft": 0.002}
    lost = -tracing.contribution(frame, numbers | {"reach": 1.0})[:, 4:]
    held = 0.8 * volts / np.median(volts)
    np.testing.assert_allclose(lost, np.maximum(frame.throttles - held[:, None], 0.0), atol=2e-3)
    assert lost.max() > 0.05


def test_a_rotor_that_stands_still_has_no_sum_of_speeds():
    u = np.column_stack([np.linspace(0.2, 1.0, 50), np.zeros(50)])
    forms = _forms(
        ["upper_thrust"], {"time_s": np.arange(50.0)}, np.ones((50, 1)), np.ones(1), [0], u, u, True
    )
    variables = {form.split("|")[0] for form in forms}
    assert variables == {"time_s", "upper_speed"}
    turning = _forms(
        ["upper_thrust"],
        {"time_s": np.arange(50.0)},
        np.ones((50, 1)),
        np.ones(1),
        [0],
        u + 0.1 * u[::-1, :1],
        u,
        True,
    )
    assert any("lower_speed" in form for form in turning)
