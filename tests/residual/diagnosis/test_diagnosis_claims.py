"""What is flagged, and what is claimed only where nothing else could be confounded with it.

The rig is that of tests/helpers and shares nothing with coaxlink.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from residual_rig import FULL_RPM, run

from coaxlink.data import Samples
from coaxlink.effects import effect
from coaxlink.residual import refine_stand
from coaxlink.residual.diagnosis.claims import claims
from coaxlink.residual.diagnosis.posterior import Posterior


def loads_and_speeds(seed):
    """Columns of the rig without supply, heat, spacing and mood."""
    columns = run(seed=seed, throttle=False)
    beside = ("voltage_V", "air_temperature_C", "motor_temperature_C", "rotor_spacing_m", "operator_mood")
    return {k: v for k, v in columns.items() if k not in beside}


@pytest.mark.slow
def test_a_cell_at_its_limit_is_flagged_though_it_trembles():
    columns = loads_and_speeds(11)
    rng = np.random.default_rng(1)
    load = columns["lower_thrust_N"]
    limit = 0.6 * load.max()
    columns["lower_thrust_N"] = np.minimum(load, limit) + 0.2 * rng.standard_normal(len(load))
    answer = refine_stand(Samples(columns, "rig.csv"))
    assert [s.column for s in answer.suspect_data] == ["lower_thrust_N"]
    assert "saturated" in answer.suspect_data[0].why
    assert answer.effects == ()


@pytest.mark.slow
def test_pulses_counted_twice_in_a_band_are_flagged_and_nothing_is_claimed(paper):
    columns = loads_and_speeds(12)
    speed = columns["lower_rpm"] / FULL_RPM
    columns["lower_rpm"] = np.where((speed > 0.35) & (speed < 0.55), 2.0, 1.0) * columns["lower_rpm"]
    answer = refine_stand(Samples(columns, "rig.csv"), paper)
    assert {s.column for s in answer.suspect_data} == {"lower_rpm"}
    assert "2 times" in answer.suspect_data[-1].why
    assert answer.effects == () and any("tachometer is accused" in n for n in answer.notes)


@pytest.mark.slow
def test_air_that_warms_once_may_be_the_amplifier_warming_up():
    columns = loads_and_speeds(13)
    t = columns["time_s"]
    celsius = 12.0 + 14.0 * (1.0 - np.exp(-t / (0.2 * t[-1])))
    for name in ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm"):
        columns[name] = columns[name] * 288.15 / (celsius + 273.15)
    columns["air_temperature_C"] = celsius
    answer = refine_stand(Samples(columns, "rig.csv"))
    assert [set(a.names) for a in answer.ambiguous] == [{"air_density", "sensor_drift"}]
    assert answer.effects == ()


def hypothesis(*names):
    empty = SimpleNamespace(deviation=np.zeros(0))
    return SimpleNamespace(names=frozenset(names), effects=frozenset(names), forms=(), members=(), fit=empty)


@pytest.mark.parametrize(
    ("nats", "rows", "said"), [(30.0, 20.0, True), (30.0, 4.0, True), (9.0, 20.0, False)]
)
def test_a_name_needs_five_standard_errors_against_nothing(nats, rows, said):
    sets = hypothesis("hysteresis", "rotor_lag"), hypothesis("rotor_lag"), hypothesis()
    far = 1000.0
    found = Posterior(
        sets,
        np.array([1.0, 0.0, 0.0]),
        np.ones(3),
        np.array([0.0, nats, far]),
        np.array([0.0, rows, far]),
    )
    made = claims(SimpleNamespace(), found)
    assert ("hysteresis" in made.sure) is said
    assert ("hysteresis" in made.withheld) is not said
    assert "rotor_lag" in made.sure


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("rotor_spacing", {"alike": 1.0, "loads_share": -0.07, "reference_spacing_m": 0.15}),
        ("sensor_drift", {"amplifier": 1.0, "memory": 0.3, "span_per_minute": 0.01}),
        (
            "hysteresis",
            {"lower": 1.0, "relay": 0.0, "on": 0.7, "off": 0.5, "thrust_share": 0.1, "torque_share": 0.0},
        ),
    ],
)
def test_a_form_that_stands_in_is_read_back_as_it_was_written(name, numbers, paper):
    from coaxlink.residual.channels.stand import stand_frame

    frame = stand_frame(Samples(run(seed=14), "rig.csv"), paper)
    tracing = effect(name).stand
    shape, coefficients = tracing.inverse(frame, numbers)
    columns = tracing.columns(frame, shape)
    assert columns.shape == (len(frame.time_s), 6, len(coefficients))
    assert np.abs(columns @ coefficients).max() > 0.0
    back = tracing.parameters(frame, shape, coefficients)
    assert {k: back[k] for k in numbers} == pytest.approx(numbers)


def test_a_relay_turns_on_above_one_speed_and_off_below_another(paper):
    from coaxlink.residual.channels.stand import stand_frame

    columns = run(seed=15, throttle=False)
    frame = stand_frame(Samples(columns, "rig.csv"), paper)
    tracing = effect("hysteresis").stand
    added = tracing.columns(frame, {"lower": 1.0, "relay": 0.0, "on": 0.75, "off": 0.45})[:, 2, 0]
    state = added / np.where(frame.predicted[:, 2] == 0.0, 1.0, frame.predicted[:, 2])
    now, expected = 0.0, []
    for u in frame.speeds[:, 0]:
        now = 1.0 if u > 0.75 else 0.0 if u < 0.45 else now
        expected.append(now)
    between = (frame.speeds[:, 0] > 0.45) & (frame.speeds[:, 0] < 0.75)
    np.testing.assert_allclose(state, expected)
    assert {0.0, 1.0} <= set(np.round(state[between], 6))
