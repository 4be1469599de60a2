"""Where the exact law starts from must not show in what it answers."""

from pathlib import Path

import numpy as np
import pytest

from coaxlink.mixer.exact import ExactLaw
from coaxlink.vehicle import load_vehicle

X8 = load_vehicle(Path(__file__).parents[2] / "examples" / "x8_paper.toml")


def smooth(rows):
    """A motion at 1 kHz, (rows, 4)."""
    t = np.arange(rows) * 1e-3
    return np.column_stack([200 + 40 * np.sin(4 * t), 4 * np.sin(8 * t), 4 * np.cos(7 * t), np.sin(6 * t)])


def missed(speeds, demands):
    """Demanded minus delivered, (rows, 4)."""
    return demands - X8.airframe.wrench(*X8.airframe.loads(X8.model, speeds))


def cold(demands):
    """Each row by a law that never saw another."""
    return np.array([ExactLaw(X8).speeds(d) for d in demands])


def test_a_smooth_motion_takes_one_step_and_lands_where_a_cold_start_does():
    demands, law = smooth(300), ExactLaw(X8)
    speeds, steps = [], []
    for row in demands:
        speeds.append(law.speeds(row))
        steps.append(law.certificate.steps)
    assert max(steps[1:]) == 1 and np.abs(missed(np.array(speeds), demands)).max() < 1e-6
    assert np.array(speeds)[::25] == pytest.approx(cold(demands[::25]), abs=2e-4)


def test_noise_on_the_demand_costs_no_exactness():
    demands = smooth(300) + np.random.default_rng(2).normal(0.0, 0.2, (300, 4))
    found = ExactLaw(X8).many(demands)
    assert np.abs(missed(found, demands)).max() < 1e-6
    assert found[::30] == pytest.approx(cold(demands[::30]), abs=2e-4)


def test_kicks_out_of_reach_and_back_leave_no_trace():
    demands = smooth(400)
    kicked = np.arange(400) % 100 >= 80
    demands[kicked, 3] += 9.0
    found = ExactLaw(X8).many(demands)
    miss = missed(found, demands)
    assert np.abs(miss[~kicked]).max() < 1e-6 and np.abs(miss[kicked, :3]).max() < 1e-6
    at = np.flatnonzero(np.diff(kicked)) + 1
    assert len(at) == 7
    assert found[at] == pytest.approx(cold(demands[at]), abs=1e-3)
    assert miss[at, 3] == pytest.approx(missed(cold(demands[at]), demands[at])[:, 3], abs=1e-5)


def test_the_second_kick_is_entered_from_the_first_and_reset_forgets_both():
    law = ExactLaw(X8)
    near, far = [200.0, 1.0, 1.0, 0.2], [200.0, 1.0, 1.0, 9.0]
    rounds = []
    for wrench in (near, far, near, far, near):
        law.speeds(wrench)
        rounds.append(law.certificate.rounds)
    assert rounds[3] < rounds[1]  # bounds and given-up axes stand as they did
    law.reset()
    assert (law.speeds(far) == ExactLaw(X8).speeds(far)).all()
