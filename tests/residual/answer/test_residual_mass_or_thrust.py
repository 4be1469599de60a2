"""What a flight lifts, beside a mass that is claimed of it; lags that a log's rows do not show."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coaxlink.effects.mass_change import EFFECT as MASS
from coaxlink.effects.rotor_lag import EFFECT as LAG
from coaxlink.residual.answer.mass_or_thrust import lift_beside, own_doubt
from coaxlink.rotor.model import Load

KG, G = 7.34, 9.80665
ROWS = 400


def hovering(lifts: float, mass_kg: float, rmse_N: float | None = None) -> Any:
    """A hover that lifts so many times what it should, with a mass acting in its prediction."""
    thrust = KG * G * (1.0 + 0.01 * np.sin(np.arange(ROWS)))
    bare = np.zeros((ROWS, 6))
    bare[:, 2] = -thrust
    missed = {} if rmse_N is None else {Load.UPPER_THRUST: rmse_N}
    frame = SimpleNamespace(
        airframe=SimpleNamespace(mass_kg=KG, pairs=((0, 1),) * 4, motor_lag_s=0.03), weight=KG * G,
        model=SimpleNamespace(missed=missed), thrust=thrust[:, None], keep=np.arange(0, ROWS, 3),
        predicted=bare, measured=lifts * bare, time_s=0.1 * np.arange(ROWS),
    )  # fmt: skip
    frame.predicted = bare + MASS.flight.adds(frame, {"mass_kg": mass_kg})
    return frame


@pytest.mark.parametrize("lifts", [0.95, 1.0, 1.04])
@pytest.mark.parametrize("mass_kg", [6.95, 7.34, 7.8])
def test_what_a_flight_lifts_is_no_matter_of_the_mass_that_is_claimed(lifts: float, mass_kg: float) -> None:
    assert lift_beside(hovering(lifts, mass_kg), mass_kg) == pytest.approx(lifts - 1.0, abs=1e-9)


def test_a_rotor_model_that_errs_by_more_leaves_more_in_doubt() -> None:
    assert own_doubt(hovering(1.0, KG)) == pytest.approx(0.73 * 0.03)
    assert own_doubt(hovering(1.0, KG, 0.6)) == pytest.approx(
        0.73 * np.hypot(0.03, 2 * 0.6 * 4 / (KG * G)), rel=1e-3
    )


@pytest.mark.parametrize(("step_s", "least_s"), [(0.1, 0.05), (0.004, 0.008)])
def test_no_lag_is_looked_for_that_the_distance_of_commands_hides(step_s: float, least_s: float) -> None:
    frame = SimpleNamespace(
        airframe=SimpleNamespace(motor_lag_s=0.03), step_s=step_s,
        commands=np.random.default_rng(1).uniform(0.5, 0.6, (50, 8)),
    )  # fmt: skip
    lags = [numbers["lag_s"] for numbers in LAG.flight.starts(frame)]
    assert lags and min(abs(lag - 0.03) for lag in lags) > least_s
    assert (0.0 in lags) == (step_s < 0.06)
