"""Physical sense on demand: loads that rise and fall as rotors' do, where the free fit does not."""

import numpy as np
import pytest

from coaxlink.data import Samples
from coaxlink.rotor import identify
from coaxlink.rotor.fit import Options

LEVELS = np.linspace(0.0, 0.9, 11)


def stand(seed: int, noise_N: float, rig: float = 0.0) -> Samples:
    """A small pair on a stand; with `rig`, cells that lean on one another: thrusts bend the wrong way."""
    dice = np.random.default_rng(seed)
    u, v = (g.ravel() for g in np.meshgrid(LEVELS, LEVELS, indexing="ij"))
    loads = {
        "upper_thrust_N": 4.0 * u**2 - rig * u,
        "upper_torque_Nm": 0.10 * u**2,
        "lower_thrust_N": 4.0 * v**2 - 0.3 * u**2 + rig * u * (1 - v),
        "lower_torque_Nm": 0.10 * v**2,
    }
    columns = {"upper_rpm": 5000 * u, "lower_rpm": 5000 * v, "upper_throttle": u, "lower_throttle": v}
    for name, values in loads.items():
        columns[name] = values + noise_N * (1.0 if name.endswith("_N") else 0.02) * dice.standard_normal(
            len(u)
        )
    return Samples(columns, f"stand {seed}")


def slopes(model) -> tuple[float, float, float]:
    """Least slope of f_u in u_u and of f_l in u_l, greatest of f_l in u_u, by differences on a fine grid."""
    fine = np.linspace(0.0, 0.9, 61)
    u, v = np.meshgrid(fine, fine, indexing="ij")
    upper, lower = model.upper_thrust(u, v), model.lower_thrust(u, v)
    return (
        float(np.diff(upper, axis=0).min()),
        float(np.diff(lower, axis=1).min()),
        float(np.diff(lower, axis=0).max()),
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_asked_for_holds_between_the_points_too(seed: int) -> None:
    log = stand(seed, 0.02, rig=0.8)
    free = identify(log, "crm", options=Options(), compare=False).model
    made = identify(log, "crm", options=Options(physical=True), compare=False).model
    small = 1e-3
    rising, own, wake = slopes(made)
    assert rising > -small and own > -small and wake < small
    assert made.upper_thrust(LEVELS).min() > -small
    broken = slopes(free)
    assert broken[0] < -small or broken[1] < -small or broken[2] > small  # the free fit does need it


def test_a_fit_that_makes_sense_is_left_alone() -> None:
    log = stand(4, 0.01)
    free = identify(log, "rcrm", options=Options(), compare=False).model
    made = identify(log, "rcrm", options=Options(physical=True), compare=False).model
    assert made.terms() == free.terms()
