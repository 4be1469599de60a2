"""The ESCs' amps beside the battery monitor's: what is there, what is none, and what a scale does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as m

from coaxlink.errors import InputError
from coaxlink.fly.esc_amps import EscAmps, esc_amps
from coaxlink.fly.split_plan import PowerRecord, SplitPlan
from coaxlink.mavlink.telemetry import Telemetry
from firmware_params.px4.messages import MAVLink_esc_status_message

UPPER = (True, True, True, True, False, False, False, False)
LEVELS = np.linspace(0.4, 0.6, 7)
TRIALS, HELD = 200, 181  # 95 % of 200 are fewer than this once in a hundred


def hover(rng: np.random.Generator, scale: float = 1.0, dwells: int = 40) -> tuple[Any, Any]:
    """A pack of 24 V and 50 A; least power at 0.53; its power module reads `scale` of the amps."""
    rows, amps = [], []
    for n in range(dwells):
        share = LEVELS[abs((n % 12) - 6)]
        true = 50.0 * (1.0 + 0.8 * (share - 0.53) ** 2 + 1e-3 * rng.normal())
        for k in range(36):
            escs = np.where(UPPER, share, 1.0 - share) * true / 4.0 + 0.1 * rng.normal(size=8)
            reported = scale * true + 0.3 * rng.normal()
            rows.append([n, 18.0 * n + 0.5 * k, 24.0 * reported, share, 0.0, 0.0])
            amps.append([reported, *escs])
    return np.array(rows), np.array(amps)


def judged(rows: Any, amps: Any) -> EscAmps:
    return esc_amps(rows, amps, UPPER, 4.0, float(LEVELS[3]))


@pytest.mark.slow
def test_the_interval_holds_a_power_modules_scale_and_they_agree_where_it_has_none() -> None:
    rng = np.random.default_rng(3)
    right = [judged(*hover(rng)) for _ in range(TRIALS)]
    assert sum(a.agree for a in right) >= HELD
    wrong = [judged(*hover(rng, 1.06)) for _ in range(TRIALS)]
    assert sum(a.ratio_ci[0] <= 1.0 / 1.06 <= a.ratio_ci[1] for a in wrong) >= HELD
    assert not any(a.agree for a in wrong)


def test_the_escs_have_a_share_of_their_own_whatever_the_power_module_scales() -> None:
    found = judged(*hover(np.random.default_rng(4), 1.06))
    first, second = found.words()
    assert "0.94" in first and "rests on the battery monitor" in first
    assert found.as_json()["by_escs"]["share"] == pytest.approx(0.53, abs=0.02)
    assert "by the ESCs alone: least power with" in second
    share, upper, lower = np.array(found.share), np.array(found.upper_A), np.array(found.lower_A)
    assert upper / (upper + lower) == pytest.approx(share, abs=0.005)


@pytest.mark.parametrize(
    ("escs", "why"),
    [
        (slice(0, 8), "none of them says any"),
        (slice(2, 3), "ESC 3 says none"),
    ],
)
def test_an_esc_that_says_nothing_is_no_current(escs: slice, why: str) -> None:
    rows, amps = hover(np.random.default_rng(5))
    amps[:, 1:][:, escs] = np.nan
    with pytest.raises(InputError, match=why):
        judged(rows, amps)


def test_zeros_and_constants_are_of_escs_that_measure_none() -> None:
    for constant in (0.0, 0.8):
        rows, amps = hover(np.random.default_rng(6))
        amps[:, 6] = constant
        with pytest.raises(InputError, match=f"ESC 6 says {constant:g} A all the time"):
            judged(rows, amps)


def test_px4s_repetition_of_the_first_four_is_no_measurement() -> None:
    rows, amps = hover(np.random.default_rng(7))
    amps[:, 5:] = amps[:, 1:5]
    with pytest.raises(InputError, match="repeats"):
        judged(rows, amps)


def test_amps_are_those_of_the_battery_readings_own_second() -> None:
    now = [0.0]
    record = PowerRecord(Telemetry(lambda: now[0]), SplitPlan(tuple(LEVELS), 0.5, 14), upper=UPPER)
    record.now_s = 19.0

    def hear(*reported: Any) -> None:
        for message in reported:
            record.telemetry.hear(message)
            record.hear(message)

    moves = (
        m.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        m.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )
    battery = m.MAVLink_battery_status_message(0, 0, 0, 0, [4000] * 6 + [65535] * 4, 5000, 0, 0, 90)
    first, second = (
        MAVLink_esc_status_message(k, 0, [3000] * 4, [24.0] * 4, [6.0 + k, 6.1, 6.2, 6.3]) for k in (0, 4)
    )
    hear(*moves, first, second, battery)
    assert record.amps[0] == pytest.approx((50.0, 6.0, 6.1, 6.2, 6.3, 10.0, 6.1, 6.2, 6.3))
    now[0] = 1.5
    hear(first, battery)
    assert record.amps[1][:5] == pytest.approx((50.0, 6.0, 6.1, 6.2, 6.3))
    assert np.isnan(record.amps[1][5:]).all()


def heard_record(batteries: dict[int, int], rpm_of: Any, amps_of: Any) -> PowerRecord:
    """A minute's readings of these packs (id: hundredths of an ampere) and of eight ESCs by their command."""
    now = [0.0]
    record = PowerRecord(
        Telemetry(lambda: now[0]), SplitPlan((0.4, 0.5, 0.6), 0.5, 3), upper=UPPER, now_s=0.0
    )
    rng = np.random.default_rng(5)
    for k in range(120):
        now[0] = record.now_s = 0.45 * k
        u = 0.5 + 0.1 * np.sin(0.3 * k) + 0.02 * rng.normal(size=8)
        for first in (0, 4):
            four = u[first : first + 4]
            rpm, amps = [int(v) for v in rpm_of(four)], [float(v) for v in amps_of(four)]
            record.telemetry.hear(MAVLink_esc_status_message(first, 0, rpm, [24.0] * 4, amps))
        record.telemetry.hear(m.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        record.telemetry.hear(m.MAVLink_local_position_ned_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        for number, amps in batteries.items():
            cells = [4000] * 6 + [65535] * 4
            record.hear(m.MAVLink_battery_status_message(number, 0, 0, 0, cells, amps, 0, 0, 90))
    return record


def test_amps_that_a_simulator_made_with_the_rpm_are_none() -> None:
    """As PX4's SITL: 6000 rpm and 1 A + 15 A times the command."""
    made = heard_record({0: 5000}, lambda u: 6000.0 * u, lambda u: 1.0 + 15.0 * u)
    with pytest.raises(InputError, match="a simulator made both"):
        made.escs()
    read = heard_record({0: 5000}, lambda u: 6000.0 * np.sqrt(u), lambda u: np.round(1.0 + 15.0 * u**1.5, 2))
    with pytest.raises(InputError) as other:  # of another reason: three dwells are too few
        read.escs()
    assert "simulator" not in str(other.value)


@pytest.mark.parametrize(
    "batteries", [{0: 5000, 1: 900}, {1: 900, 0: 5000}, {255: 900, 0: 5000}, {255: 5000}]
)
def test_of_several_battery_monitors_one_is_read(batteries: dict[int, int]) -> None:
    record = heard_record(batteries, lambda u: 6000.0 * u, lambda u: 15.0 * u**1.5)
    assert {row[0] for row in record.amps} == {50.0} and len(record.rows) >= 119
