"""Two things at once on a stand, schedules that repeat, forms that begin late or differ by direction."""

from __future__ import annotations

import numpy as np
import pytest
from case_table import case_table
from residual_rig import FULL_RPM, run, steady_loads
from residual_stand_logs import log_of, model, names, over, ramps

from coaxlink.data.samples import Samples
from coaxlink.evidence.held_out import folds_of
from coaxlink.residual import refine_stand


def test_folds_do_not_repeat_with_a_schedule():
    with case_table() as case:
        for count in (7, 12, 20, 24, 36, 40):
            with case(f"{count}"):
                dealt = folds_of(count)
                assert np.ptp(np.bincount(dealt, minlength=6)) <= 1
                assert not np.any(dealt[1:] == dealt[:-1])
                for passes in range(1, count // 2 + 1):
                    assert np.mean(dealt[passes:] == dealt[:-passes]) < 0.35


@pytest.mark.slow
def test_what_a_large_form_misses_is_no_drift():
    columns = run(spacing=0.6, rpm=True, throttle=False)
    # the wake narrows beyond what a share of it can say: a constant that steps with the spacing, half-way
    columns["lower_thrust_N"] += 0.9 * (columns["rotor_spacing_m"] / 0.15 - 1.0) / 0.2
    answer = refine_stand(Samples(columns, "stand", ()), model())
    assert names(answer) == ["rotor_spacing"]


def followed(t, asked, up, down):
    """Speeds behind what is asked, on a fine grid: slower down than up."""
    fine = 20
    now, out = asked[0], []
    for target in asked:
        for _ in range(fine):
            now += (target - now) * (t[1] - t[0]) / fine / (up if target > now else down)
        out.append(now)
    return np.array(out)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strange", "where"),
    [
        (lambda a, b: 2.0 * np.sin(14.0 * (a - b)), "upper_speed - lower_speed"),
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


@pytest.mark.slow
def test_a_lower_rotor_that_only_seems_to_turn_ends_in_no_error():
    t, a, b = ramps(400)
    a = np.maximum(a, 0.1)
    faint = 2e-4 * np.abs(np.random.default_rng(3).standard_normal(400)) + 1e-5
    log = log_of(t, a, faint, steady_loads(a, 0 * b))
    assert names(refine_stand(log)) == []
    assert names(refine_stand(log, model())) == []


def throttled(t, asked, turned, **more):
    """A log of throttles, and of tachometers that read with noise what they turned."""
    rng = np.random.default_rng(6)
    rpm = [FULL_RPM * np.maximum(u + 5e-4 * rng.standard_normal(len(t)), 0.0) for u in turned]
    read = {f"{n}_throttle": u for n, u in zip(("upper", "lower"), asked, strict=True)} | more
    log = log_of(t, *turned, steady_loads(*turned), **read)
    return log.with_columns(upper_rpm=rpm[0], lower_rpm=rpm[1])


@pytest.mark.slow
def test_a_throttle_that_is_off_leaves_a_rotor_at_rest():
    levels = np.linspace(0.0, 0.9, 11)
    asked = [np.repeat(levels, 11), np.tile(levels, 11)]
    turned = [np.maximum(u - 0.03, 0.0) / 0.97 for u in asked]
    answer = refine_stand(throttled(2.0 * np.arange(121.0), asked, turned), model())
    assert names(answer) == ["dead_band"]
    assert over(answer) < 1.6  # a single sweep hardly tells its noise
    (share,) = [p for p in answer.effects[0].parameters if p.name == "share"]
    assert share.ci[1] - share.ci[0] > 0.01  # that all of the band is there was assumed, not read


@pytest.mark.slow
def test_play_of_both_torque_cells_is_told_from_a_law_of_the_blades():
    t, a, b = ramps(1500)
    loads = steady_loads(a, b)
    for row in (1, 3):  # nothing below a breakaway torque, the excess above it
        loads[row] = np.sign(loads[row]) * np.maximum(np.abs(loads[row]) - 0.07, 0.0)
    answer = refine_stand(log_of(t, a, b, loads), model())
    assert names(answer) == ["dead_band"] and not answer.ambiguous
    assert over(answer) < 1.1
