"""Where the exact law starts from must not show in what it answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from coaxlink.airframe import load_airframe
from coaxlink.mixer.exact import ExactLaw
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
X8 = load_airframe(EXAMPLES / "x8_paper.toml")


def smooth(rows: int) -> NDArray[np.float64]:
    """A motion at 1 kHz, (rows, 4)."""
    t = np.arange(rows) * 1e-3
    return np.column_stack([200 + 40 * np.sin(4 * t), 4 * np.sin(8 * t), 4 * np.cos(7 * t), np.sin(6 * t)])


def missed(speeds: NDArray[np.float64], demands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Asked for minus delivered, (rows, 4)."""
    return demands - X8.wrench(*X8.loads(CRM, speeds))


def cold(demands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each row by a law that never saw another."""
    return np.array([ExactLaw(Vehicle(X8, CRM)).speeds(d) for d in demands])


def test_a_smooth_motion_takes_one_step_and_lands_where_a_cold_start_does() -> None:
    demands, law = smooth(300), ExactLaw(Vehicle(X8, CRM))
    speeds, steps = [], []
    for row in demands:
        speeds.append(law.speeds(row))
        steps.append(law.certificate.steps)
    assert max(steps[1:]) == 1
    found = np.array(speeds)
    assert np.abs(missed(found, demands)).max() < 1e-6
    power = (X8.loads(CRM, found)[1] * found).sum(axis=1)[::25]
    least = cold(demands[::25])
    assert power == pytest.approx((X8.loads(CRM, least)[1] * least).sum(axis=1), rel=1e-6)


def test_kicks_out_of_reach_and_back_leave_no_trace() -> None:
    demands = smooth(400)
    kicked = np.arange(400) % 100 >= 80
    demands[kicked, 3] += 9.0
    found = ExactLaw(Vehicle(X8, CRM)).many(demands)
    miss = missed(found, demands)
    assert np.abs(miss[~kicked]).max() < 1e-6
    assert np.abs(miss[kicked, :3]).max() < 1e-6
    at = np.flatnonzero(np.diff(kicked)) + 1
    assert len(at) == 7
    assert found[at] == pytest.approx(cold(demands[at]), abs=1e-3)
    assert miss[at, 3] == pytest.approx(missed(cold(demands[at]), demands[at])[:, 3], abs=1e-5)


def test_the_second_kick_is_entered_from_the_first() -> None:
    law = ExactLaw(Vehicle(X8, CRM))
    near, far = [200.0, 1.0, 1.0, 0.2], [200.0, 1.0, 1.0, 9.0]
    rounds = []
    for wrench in (near, far, near, far, near):
        law.speeds(wrench)
        rounds.append(law.certificate.rounds)
    assert rounds[3] < rounds[1] / 3  # bounds and given-up axes stand as they did
    assert law.certificate.steps == 1


def test_noise_on_the_demand_costs_no_exactness() -> None:
    demands = smooth(300) + np.random.default_rng(2).normal(0.0, 0.2, (300, 4))
    found = ExactLaw(Vehicle(X8, CRM)).many(demands)
    assert np.abs(missed(found, demands)).max() < 1e-6
    assert found[::30] == pytest.approx(cold(demands[::30]), abs=2e-4)


def test_a_motion_under_a_slew_limit_stays_within_it() -> None:
    law = ExactLaw(Vehicle(X8, CRM), slew=0.0005)
    speeds = np.array([law.speeds(row) for row in smooth(200)])
    assert np.abs(np.diff(speeds, axis=0)).max() <= 0.0005 + 1e-12


def test_reset_forgets_what_was_kept() -> None:
    law = ExactLaw(Vehicle(X8, CRM))
    first = law.speeds([200.0, 1.0, 1.0, 9.0])
    law.many(smooth(50))
    law.reset()
    assert (law.speeds([200.0, 1.0, 1.0, 9.0]) == first).all()
