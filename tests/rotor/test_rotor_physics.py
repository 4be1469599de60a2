"""Slopes and signs that an allocator trusts, on a pair by momentum theory: no polynomial makes its loads."""

import numpy as np
import pytest
from rotor_bench import stand

from coaxlink.data import Samples
from coaxlink.load import Load
from coaxlink.rotor.fit import LOWEST, LoadFit
from coaxlink.rotor.identification import identify, measured
from coaxlink.rotor.model import load_rotor_model, save_rotor_model
from coaxlink.rotor.physics import held_to_physics, keeps_to_physics, windmilling_ratio
from coaxlink.rotor.stand_data import stand_data
from coaxlink.rotor.uncertainty import Intervals

FULL_RAD_S, RADIUS, SOLIDITY, LIFT_SLOPE, PITCH, DRAG, RHO = 700.0, 0.2, 0.09, 5.7, 0.24, 0.02, 1.2
WAKE = 1.4  # of the upper rotor's induced speed, at the lower one


def rotor(u, inflow):
    """Thrust and torque of one rotor: blade elements at 3/4 radius and momentum, in a stream from above."""
    tip, area = np.maximum(u, 1e-6) * FULL_RAD_S * RADIUS, np.pi * RADIUS**2
    low, high = np.zeros_like(tip), np.full_like(tip, 80.0)
    for _ in range(60):  # induced speed at which both say the same
        own = 0.5 * (low + high)
        ratio = (own + inflow) / tip
        blades = 0.25 * SOLIDITY * LIFT_SLOPE * (PITCH * 2 / 3 - ratio) * RHO * area * tip**2
        more = blades > 2 * RHO * area * (own + inflow) * own
        low, high = np.where(more, own, low), np.where(more, high, own)
    thrust = 0.25 * SOLIDITY * LIFT_SLOPE * (PITCH * 2 / 3 - ratio) * RHO * area * tip**2
    profile = SOLIDITY * DRAG / 8 * RHO * area * tip**2 * RADIUS
    return thrust, thrust * ratio * RADIUS + profile, own


def pair(u, v):
    """The four loads; the wake turns a slow lower rotor."""
    upper_thrust, upper_torque, induced = rotor(u, np.zeros_like(u))
    lower_thrust, lower_torque, _ = rotor(v, WAKE * induced)
    return upper_thrust, upper_torque, lower_thrust, lower_torque


def log(levels, noise, seed=0):
    """A map of the pair over both speeds, noise as a share of each load's range."""
    u, v = (g.ravel() for g in np.meshgrid(levels, levels, indexing="ij"))
    random, columns = np.random.default_rng(seed), {"upper_rpm": 6685.0 * u, "lower_rpm": 6685.0 * v}
    for load, y in zip(Load, pair(u, v), strict=True):
        columns[load.column] = y + noise * np.ptp(y) * random.standard_normal(len(y))
    return Samples(columns, "momentum.csv")


@pytest.fixture(scope="module")
def found():
    """A sparse and noisy map, whose best polynomials bend between the rows and beyond them."""
    return identify(log(np.linspace(0.25, 0.9, 6), 0.02), "crm", speed_max_rpm=6685.0, compare=False)


def test_no_load_bends_where_an_allocator_may_go(found):
    ratio = windmilling_ratio(found.data)
    u, v = np.meshgrid(np.linspace(0.15, 1.04, 40), np.linspace(0.15, 1.04, 40), indexing="ij")
    driven, step, wrong = v >= ratio * u, 1e-4, []
    assert any("kept to physics" in note for note in found.notes)
    below, above = found.model.loads(u - step, v), found.model.loads(u + step, v)
    left, right = found.model.loads(u, v - step), found.model.loads(u, v + step)
    for load, change, where in (
        (Load.UPPER_THRUST, above[Load.UPPER_THRUST] - below[Load.UPPER_THRUST], np.ones_like(driven)),
        (Load.UPPER_TORQUE, above[Load.UPPER_TORQUE] - below[Load.UPPER_TORQUE], np.ones_like(driven)),
        (Load.LOWER_THRUST, right[Load.LOWER_THRUST] - left[Load.LOWER_THRUST], driven),
        (Load.LOWER_TORQUE, right[Load.LOWER_TORQUE] - left[Load.LOWER_TORQUE], driven),
        (Load.LOWER_THRUST, below[Load.LOWER_THRUST] - above[Load.LOWER_THRUST], driven),
    ):
        # between the grid's points a slope may pass zero by a little: that of a thousandth of the load
        if (change[where] / (2 * step)).min() < -1e-3 * np.abs(found.model.loads(1.0, 1.0)[load]):
            wrong.append(load.key)
    assert not wrong


def test_the_error_beside_the_model_is_that_of_the_model(found):
    """A map of the same pair that no fit saw: what it is missed by is what was said, within two."""
    again = log(np.linspace(0.25, 0.9, 9), 0.02, seed=5)
    u, v = again["upper_rpm"] / 6685.0, again["lower_rpm"] / 6685.0
    loads = found.model.loads(u, v)
    for load in Load:
        missed = float(np.sqrt(np.mean((loads[load] - again[load.column]) ** 2)))
        reported = found.channels[load.channel].rmse
        assert 0.5 * reported < missed < 1.5 * reported, load.key


def test_rows_that_contradict_physics_are_left_as_measured_and_it_is_said():
    """A stand whose upper thrust falls again at the top: a stall, and no noise that could make it."""
    stalled = log(np.linspace(0.1, 1.0, 10), 0.002)
    u = stalled["upper_rpm"] / 6685.0
    stalled = stalled.with_columns(upper_thrust_N=stalled["upper_thrust_N"] * (1.25 - u))
    result = identify(stalled, "crm", speed_max_rpm=6685.0, compare=False)
    assert any("contradict" in line and "upper.thrust_N" in line for line in result.warnings)
    top = result.model.upper_thrust(np.array([0.8, 1.0]), np.zeros(2))
    assert top[1] < top[0]
    assert not any("contradict" in line for line in identify(stand(0), "crm", compare=False).warnings)


def test_a_fit_that_keeps_to_physics_is_not_touched():
    data = stand_data(log(np.linspace(0.1, 1.0, 6), 0.0))
    rows = data.rows("upper.thrust_N")

    def fit(**terms):
        return LoadFit(tuple(terms), np.array(list(terms.values())), LOWEST, Intervals({}, {}))

    rising, falling = fit(u_u=1.0), fit(u_u=-1.0)
    assert keeps_to_physics(Load.UPPER_THRUST, rising, rows, 0.0)
    assert held_to_physics(Load.UPPER_THRUST, rising, rows, 0.0) is rising
    assert not keeps_to_physics(Load.UPPER_THRUST, falling, rows, 0.0)
    held = held_to_physics(Load.UPPER_THRUST, falling, rows, 0.0)
    assert keeps_to_physics(Load.UPPER_THRUST, held, rows, 0.0)


def test_the_file_says_where_the_rows_were(found, tmp_path):
    determined = measured(found.data)
    assert determined["upper"] == pytest.approx([0.25, 0.9]) and determined["lower"] == pytest.approx(
        [0.25, 0.9]
    )
    assert determined["ratio_least"] == pytest.approx(0.25 / 0.9)
    u, v = found.data.speeds.upper, found.data.speeds.lower
    turned = pair(u, v)[3] < 0.0
    assert determined["windmilling"] == pytest.approx((v / u)[turned].max(), abs=0.1)
    path = tmp_path / "rotor.toml"
    save_rotor_model(path, found.model)
    read = load_rotor_model(path).identified["measured"]
    assert {key: pytest.approx(value) for key, value in determined.items()} == read
    assert any("extrapolated" in note for note in found.notes)


def test_a_log_without_throttle_says_what_it_takes_for_full_speed():
    guessed = identify(log(np.linspace(0.25, 0.9, 6), 0.02), "rcrm", compare=False)
    assert any("without throttle" in line for line in guessed.warnings)
    given = identify(log(np.linspace(0.25, 0.9, 6), 0.02), "rcrm", speed_max_rpm=6685.0, compare=False)
    assert not given.warnings
