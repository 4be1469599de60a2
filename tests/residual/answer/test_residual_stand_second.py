"""Two things at once on a stand, schedules that repeat, forms that begin late or differ by direction."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, run, steady_loads
from residual_stand_logs import log_of, model, names, over, ramps

from coaxlink.data.samples import Samples
from coaxlink.residual import refine_stand
from coaxlink.residual.regression.blocks import folds_of


@pytest.mark.parametrize("count", [7, 12, 20, 24, 36, 40])
def test_folds_do_not_repeat_with_a_schedule(count):
    dealt = folds_of(count)
    assert np.ptp(np.bincount(dealt, minlength=6)) <= 1
    assert not np.any(dealt[1:] == dealt[:-1])
    for passes in range(1, count // 2 + 1):
        assert np.mean(dealt[passes:] == dealt[:-passes]) < 0.35


def test_slow_blades_that_carry_less_to_an_end_are_one_law_of_blade_speed():
    t, a, b = ramps(1200)
    loads = steady_loads(a, b)
    for row, u in enumerate((a, a, b, b)):
        loads[row] *= 1.0 - 0.35 / (1.0 + (u / 0.3) ** 2)  # no power of Reynolds number
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["blade_speed_law"]
    assert over(answer) < 1.06


def test_what_a_large_form_misses_is_no_drift():
    columns = run(spacing=0.6, rpm=True, throttle=False)
    # the wake narrows beyond what a share of it can say: a constant that steps with the spacing, half-way
    columns["lower_thrust_N"] += 0.9 * (columns["rotor_spacing_m"] / 0.15 - 1.0) / 0.2
    answer = refine_stand(Samples(columns, "stand", ()), model())
    assert names(answer) == ["rotor_spacing"]
    assert any(s.name == "sensor_drift" and "form" in s.why for s in answer.trace)


def followed(t, asked, up, down):
    """Speeds behind what is asked, on a fine grid: slower down than up."""
    fine = 20
    now, out = asked[0], []
    for target in asked:
        for _ in range(fine):
            now += (target - now) * (t[1] - t[0]) / fine / (up if target > now else down)
        out.append(now)
    return np.array(out)


def test_a_lag_that_is_longer_down_than_up_leaves_noise():
    rng = np.random.default_rng(2)
    t = 0.1 * np.arange(1200)
    asked = [np.repeat(rng.uniform(0.1, 0.95, 80), 15) for _ in range(2)]
    a, b = (followed(t, u, 0.15, 0.27) for u in asked)
    read = {f"{n}_throttle": u for n, u in zip(("upper", "lower"), asked, strict=True)}
    noisy = [u + 5e-4 * rng.standard_normal(len(t)) for u in (a, b)]
    log = log_of(t, a, b, steady_loads(a, b), **read)
    log = log.with_columns(upper_rpm=FULL_RPM * noisy[0], lower_rpm=FULL_RPM * noisy[1])
    answer = refine_stand(log, model())
    assert names(answer) == ["rotor_lag"]
    got = {q.name: q.value for q in answer.effects[0].parameters}
    assert got["lag_s"] == pytest.approx(0.15, rel=0.05)
    assert got["down"] == pytest.approx(1.8, rel=0.05)
    assert over(answer) < 1.15


def test_a_drift_that_begins_late_is_told_when():
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    loads[2] += 4.0 * np.maximum(t / t[-1] - 0.4, 0.0)
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["sensor_drift"]
    got = {q.name: q.value for q in answer.effects[0].parameters}
    assert got["since"] == pytest.approx(0.4, abs=0.05)
    assert over(answer) < 1.1


@pytest.mark.parametrize(
    ("strange", "where"),
    [
        (lambda a, b: 1.5 * np.sin(14.0 * (a - b)), "upper_speed - lower_speed"),
        (lambda a, b: 4.0 * np.exp(-(((a + b - 1.1) / 0.06) ** 2)), "upper_speed + lower_speed"),
    ],
)
def test_a_beat_or_a_resonance_of_both_speeds_in_shuffled_rows_is_seen(strange, where):
    a, b = np.random.default_rng(5).uniform(0.2, 0.95, (2, 220))
    loads = steady_loads(a, b)
    loads[2] += strange(a, b)
    answer = refine_stand(log_of(2.0 * np.arange(220.0), a, b, loads), model())
    assert names(answer) == []
    assert any(where in u.depends_on for u in answer.unexplained)


def test_a_lower_rotor_that_only_seems_to_turn_ends_in_no_error():
    t, a, b = ramps(400)
    a = np.maximum(a, 0.1)
    faint = 2e-4 * np.abs(np.random.default_rng(3).standard_normal(400)) + 1e-5
    log = log_of(t, a, faint, steady_loads(a, 0 * b))
    assert names(refine_stand(log)) == []
    assert names(refine_stand(log, model())) == []


def test_a_fitted_nuisance_does_not_stand_or_fall_with_an_idle_rotor():
    """Polynomials follow this pair but where its lower rotor windmills, at three rows in a hundred."""
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    loads[3] += 0.35 * a**2 * np.exp(-((b / 0.02) ** 2))
    answer = refine_stand(log_of(t, a, b, loads))
    assert names(answer) == [] and not answer.unexplained
    assert over(answer) < 1.1
    assert any("% of full speed: not judged" in note for note in answer.notes)


def throttled(t, asked, turned, **more):
    """A log of throttles, and of tachometers that read with noise what they turned."""
    rng = np.random.default_rng(6)
    rpm = [FULL_RPM * np.maximum(u + 5e-4 * rng.standard_normal(len(t)), 0.0) for u in turned]
    read = {f"{n}_throttle": u for n, u in zip(("upper", "lower"), asked, strict=True)} | more
    log = log_of(t, *turned, steady_loads(*turned), **read)
    return log.with_columns(upper_rpm=rpm[0], lower_rpm=rpm[1])


def test_a_motor_that_starts_late_keeps_turning_below_its_start():
    t, *asked = ramps(1500)
    turned = []
    for u in asked:
        now, mine = False, []
        for x in u:
            now = x > (0.07 if now else 0.13)
            mine.append((x - 0.07) / 0.93 if now else 0.0)
        turned.append(np.array(mine))
    answer = refine_stand(throttled(t, asked, turned), model())
    assert names(answer) == ["dead_band"]
    got = {q.name: q.value for q in answer.effects[0].parameters}
    assert got["band"] == pytest.approx(0.07, abs=0.01) and got["start"] == pytest.approx(0.13, abs=0.02)
    assert over(answer) < 1.1


def test_a_throttle_that_is_off_leaves_a_rotor_at_rest():
    levels = np.linspace(0.0, 0.9, 11)
    asked = [np.repeat(levels, 11), np.tile(levels, 11)]
    turned = [np.maximum(u - 0.03, 0.0) / 0.97 for u in asked]
    answer = refine_stand(throttled(2.0 * np.arange(121.0), asked, turned), model())
    assert names(answer) == ["dead_band"]
    assert over(answer) < 1.3  # a single sweep tells its noise to one part in ten


def test_play_of_both_torque_cells_is_told_from_a_law_of_the_blades():
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    for row in (1, 3):  # nothing below a breakaway torque, the excess above it
        loads[row] = np.sign(loads[row]) * np.maximum(np.abs(loads[row]) - 0.07, 0.0)
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["dead_band"] and not answer.ambiguous
    assert over(answer) < 1.1
    (step,) = [s for s in answer.trace if s.action == "swap" and "blade_speed_law" in s.name]
    assert "nats ahead of it in its place" in step.why
