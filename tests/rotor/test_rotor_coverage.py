"""What is said about a log before and beside its model, and what to measure next."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from rotor_bench import eq17

from coaxlink.data import Samples
from coaxlink.data.averaging import shortened
from coaxlink.rotor.coverage import coverage, for_the_table
from coaxlink.rotor.identification import StandData, identify, stand_data
from coaxlink.rotor.next_runs import next_runs
from coaxlink.rotor.plausible import oddities
from sim.stand.schedule import read_schedule

TOP = 5400.0


def log(u: np.ndarray, v: np.ndarray, **more: np.ndarray) -> Samples:
    loads = {
        "upper_thrust_N": 60 * u**2,
        "upper_torque_Nm": 1.5 * u**2,
        "lower_thrust_N": 60 * v**2 - 25 * u * v,
        "lower_torque_Nm": 1.5 * v**2 - 0.2 * u * v,
    }
    random = np.random.default_rng(3)
    noisy = {k: x + 0.003 * x.max() * random.standard_normal(len(x)) for k, x in loads.items()}
    return Samples({"upper_rpm": TOP * u, "lower_rpm": TOP * v, **noisy, **more}, "x.csv")


def measured(seed: int, u: np.ndarray, v: np.ndarray) -> Samples:
    """Eq. 17 with the paper's noise."""
    random = np.random.default_rng(seed)
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    loads = {
        name: y + s * random.standard_normal(len(u))
        for name, y, s in zip(names, eq17(u, v), (0.5, 0.01) * 2, strict=True)
    }
    speeds = {"upper_rpm": TOP * u, "lower_rpm": TOP * v, "upper_throttle": u, "lower_throttle": v}
    return Samples({**speeds, **loads}, "x.csv")


def full(steps: int = 8) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(0.2, 1, steps), np.linspace(0.2, 1, steps), indexing="ij")
    return u.ravel(), v.ravel()


def said(data: StandData, form: str = "rcrm") -> str:
    return "\n".join(oddities(data, form))


def test_a_sound_log_is_not_odd() -> None:
    assert said(stand_data(log(*full()))) == ""
    assert said(stand_data(log(*full()), TOP)) == ""


def test_a_rotor_alone_is_not_odd_either() -> None:
    u = np.linspace(0.2, 1, 20)
    alone = Samples(
        {"upper_rpm": TOP * u, "upper_thrust_N": 60 * u**2, "upper_torque_Nm": 1.5 * u**2}, "x.csv"
    )
    assert said(stand_data(alone), "crm") == ""
    found = coverage(identify(alone, "rcrm", compare=False))
    assert found.lower == (0.0, 0.0) and found.cells == pytest.approx(4 / 5)


def test_speeds_beyond_or_far_below_the_top() -> None:
    assert "64 rows" not in said(stand_data(log(*full()), 0.8 * TOP))
    assert "run faster than `speed_max_rpm`, up to 1.25 of it" in said(stand_data(log(*full()), 0.8 * TOP))
    assert "no row beyond 0.50" in said(stand_data(log(*full()), 2 * TOP))


def test_thrust_that_falls_at_the_top() -> None:
    u, v = full(20)
    samples = log(u, v)
    stalled = np.where(u > 0.8, samples["upper_thrust_N"] * (1 - 4 * (u - 0.8)), samples["upper_thrust_N"])
    assert "upper: thrust falls with speed above 0.80" in said(
        stand_data(samples.with_columns(upper_thrust_N=stalled))
    )


def test_power_without_thrust_and_loads_the_wrong_way() -> None:
    u, v = full()
    samples = log(u, v, voltage_V=24 + 0 * u, upper_current_A=20 * u**3)
    dead = samples["upper_thrust_N"].copy()
    dead[40:43] = 0.0
    text = said(stand_data(samples.with_columns(upper_thrust_N=dead)))
    assert "upper: 3 rows draw power without thrust (row 41, row 42, row 43)" in text
    turned = samples["upper_torque_Nm"].copy()
    turned[60] *= -1
    assert "upper: torque against its rotor in 1 rows" in said(
        stand_data(samples.with_columns(upper_torque_Nm=turned))
    )


def test_few_rows_for_a_form() -> None:
    assert "lower.thrust_N: 16 rows for the 9 terms of crm" in said(stand_data(log(*full(4))), "crm")


def test_coverage_repeats_and_noise() -> None:
    u, v = full()
    again = log(np.concatenate([u, u[:20]]), np.concatenate([v, v[:20]]))
    found = coverage(identify(again, "rcrm", compare=False))
    assert found.cells == pytest.approx(16 / 25) and found.repeats == 20  # slower than 0.2 was not run
    assert found.repeatability["upper_thrust"] == pytest.approx(0.18, rel=0.5)
    assert found.upper == pytest.approx((0.2, 1.0)) and found.correlation == pytest.approx(0, abs=0.2)
    assert any("20 conditions measured again" in line for line in found.lines())
    once = coverage(identify(log(u, v), "rcrm", compare=False))
    assert once.repeats == 0 and "repeats: none" in "\n".join(once.lines())


def test_what_a_line_of_speeds_means_for_a_table() -> None:
    u = np.linspace(0.3, 0.95, 40)
    result = identify(log(u, u * (1 + 0.005 * np.sin(np.arange(40)))), "mutual", compare=False)
    text = for_the_table(result, "lower.thrust_N")
    assert "fly it only with both rotors between" in text and "of the upper one's" in text
    full_map = identify(log(*full()), "mutual", compare=False)
    assert "for a table: nothing" in for_the_table(full_map, "lower.thrust_N")


def test_the_next_run_is_a_schedule_that_halves_the_error(tmp_path: Path) -> None:
    """On eq. 17 itself: errors of the fit over the table's speeds before and after the planned points."""
    levels = np.meshgrid(np.linspace(0.1, 0.7, 6), np.linspace(0.1, 0.7, 6))
    u, v = (axis.ravel() for axis in levels)
    spots = np.meshgrid(np.linspace(0.2, 1, 17), np.linspace(0.2, 1, 17))
    before, after = [], []
    for seed in range(6):
        poor = measured(seed, u, v)
        result = identify(poor, "mutual", compare=False)
        runs = next_runs(result)
        path = tmp_path / f"{seed}.toml"
        path.write_text(tomli_w.dumps(runs.document()))
        schedule = read_schedule(path)
        assert len(schedule.time_s) == pytest.approx(10 * runs.seconds) and runs.share <= 0.51
        points = np.repeat(runs.points, runs.times, axis=0)
        more = measured(100 + seed, points[:, 0], points[:, 1])
        names = [n for n in poor.columns if more.has(n)]
        both = Samples({n: np.concatenate([poor[n], more[n]]) for n in names}, "x.csv")
        for log_, errors in ((poor, before), (both, after)):
            model = identify(log_, "mutual", compare=False, speed_max_rpm=TOP).model
            errors.append(np.mean((model.lower_thrust(*spots) - eq17(*spots)[2]) ** 2))
    assert np.sqrt(np.mean(after)) < 0.7 * np.sqrt(np.mean(before))
    assert tomllib.loads((tmp_path / "0.toml").read_text())["rate_hz"] == 10.0


def test_long_logs_are_averaged_where_speeds_hold(tmp_path: Path) -> None:
    u, v = full()
    held = log(np.repeat(u, 1000), np.repeat(v, 1000))
    short = shortened(held, 2000)
    assert short.rows <= 2000 and "means of 32" in short.notes[-1]
    np.testing.assert_allclose(short["upper_thrust_N"], 60 * (short["upper_rpm"] / TOP) ** 2, atol=0.2)
    random = np.random.default_rng(0).permutation(len(held["upper_rpm"]))
    mixed = shortened(held.take(random), 2000)
    assert mixed.rows == 2000 and "every 32th" in mixed.notes[-1]
    assert shortened(held) is not held and shortened(short) is short
