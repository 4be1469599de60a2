"""What is said about a log beside its model, and what to measure next."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import pair_log

from coaxlink.data import Samples
from coaxlink.data.averaging import conditions
from coaxlink.rotor.fit import Options
from coaxlink.rotor.identification import identify
from coaxlink.rotor.log_checks import check_log, coverage, for_the_table, unusual
from coaxlink.rotor.stand_data import StandData, stand_data

TOP = 5400.0
SQUARES = Options(max_order=2)


def log(u: np.ndarray, v: np.ndarray, **more: np.ndarray) -> Samples:
    loads = [60 * u**2, 1.5 * u**2, 60 * v**2 - 25 * u * v, 1.5 * v**2 - 0.2 * u * v]
    noise = [0.003 * x.max() for x in loads]
    return pair_log(u, v, loads, noise, np.random.default_rng(3), rpm=TOP).with_columns(**more)


def full(steps: int = 8) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(0.2, 1, steps), np.linspace(0.2, 1, steps), indexing="ij")
    return u.ravel(), v.ravel()


def odd(data: StandData, form: str = "rcrm") -> str:
    return "\n".join(unusual(data, form))


def test_a_sound_log_is_not_odd_nor_is_a_rotor_alone() -> None:
    assert odd(stand_data(log(*full()))) == "" == odd(stand_data(log(*full()), TOP))
    u = np.linspace(0.2, 1, 20)
    columns = {"upper_rpm": TOP * u, "upper_thrust_N": 60 * u**2, "upper_torque_Nm": 1.5 * u**2}
    alone = Samples(columns, "x.csv")
    assert odd(stand_data(alone), "crm") == ""
    found = coverage(identify(alone, "rcrm", compare=False))
    assert found.lower == (0.0, 0.0) and found.cells == pytest.approx(4 / 5)


def test_what_is_odd_is_said() -> None:
    u, v = full()
    sound = log(u, v, voltage_V=24 + 0 * u, upper_current_A=20 * u**3)
    dead, turned = sound["upper_thrust_N"].copy(), sound["upper_torque_Nm"].copy()
    dead[40:43], turned[60] = 0.0, -turned[60]
    steep, w = full(20)
    stalling = log(steep, w)
    over = np.where(steep > 0.8, 1 - 4 * (steep - 0.8), 1.0)
    cases = [
        (stand_data(sound, 0.8 * TOP), "run faster than `speed_max_rpm`, up to 1.25 of it"),
        (stand_data(sound, 2 * TOP), "no row beyond 0.50"),
        (
            stand_data(stalling.with_columns(upper_thrust_N=stalling["upper_thrust_N"] * over)),
            "upper: thrust falls with speed above 0.80",
        ),
        (
            stand_data(sound.with_columns(upper_thrust_N=dead)),
            "upper: 3 rows draw power without thrust (row 41, row 42, row 43)",
        ),
        (
            stand_data(sound.with_columns(upper_torque_Nm=turned)),
            "upper: torque against its rotor in 1 rows",
        ),
        (stand_data(log(*full(3))), "lower.thrust_N: 9 rows for the 9 terms of crm"),
    ]
    missing = [line for data, line in cases if line not in odd(data, "crm")]
    assert not missing


def test_coverage_repeats_noise_and_poor_errors() -> None:
    u, v = full()
    again = log(np.concatenate([u, u[:20]]), np.concatenate([v, v[:20]]))
    checks = check_log(identify(again, "srm", compare=False))
    found = checks.coverage
    assert found.cells == pytest.approx(16 / 25) and found.repeats == 20  # slower than 0.2 was not run
    assert found.repeatability["upper_thrust"] == pytest.approx(0.18, rel=0.5)
    assert found.upper == pytest.approx((0.2, 1.0)) and found.correlation == pytest.approx(0, abs=0.2)
    assert any("20 conditions measured again" in line for line in checks.covers)
    assert any(line.startswith("lower_thrust: srm misses held-out rows") for line in checks.odd)
    once = check_log(identify(log(u, v), "rcrm", compare=False))
    assert once.coverage.repeats == 0 and "repeats: none" in "\n".join(once.covers)


def test_what_a_line_of_speeds_means_for_a_table() -> None:
    u = np.linspace(0.3, 0.95, 40)
    line = log(u, u * (1 + 0.005 * np.sin(np.arange(40))))
    text = for_the_table(identify(line, "rcrm", compare=False), "lower.thrust_N")
    assert "fly it only with both rotors between" in text and "of the upper one's" in text
    full_map = identify(log(*full()), "rcrm", compare=False)
    assert "for a table it does not matter" in for_the_table(full_map, "lower.thrust_N")


def test_logs_in_time_are_averaged_where_speeds_hold() -> None:
    u, v = full()
    held = log(np.repeat(u, 1000), np.repeat(v, 1000))
    short = conditions(held)
    assert short.rows == len(u) and f"{held.rows} rows as {len(u)} steady stretches" in short.notes[-1]
    np.testing.assert_allclose(short["upper_thrust_N"], 60 * (short["upper_rpm"] / TOP) ** 2, atol=0.05)
    assert conditions(short) is short
    random = np.random.default_rng(0).permutation(len(held["upper_rpm"]))
    assert conditions(held.take(random), 2000).rows < 4000  # speeds never hold still: rows left out evenly
