"""Rows that a model's own stand did not measure, wakes that turn a rotor, drifts that are a map's.

Loads are of blades in an inflow (a square root), motors bend with a power: nothing here is a polynomial.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples, read_stand_log
from coaxlink.effects import NotShown, stand_effects
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand
from coaxlink.rotor import identify

FULL_RPM = 6400.0
REAL = Path(__file__).parents[3] / "shared" / "data" / "coax"


def raster(*, upper: tuple[float, float] = (0.1, 0.95), lower: tuple[float, float] = (0.1, 0.95)) -> Samples:
    """Eight throttles of the upper rotor on each of eight of the lower one, three seconds apart."""
    a, b = (x.ravel() for x in np.meshgrid(np.linspace(*upper, 8), np.linspace(*lower, 8)))
    random = np.random.default_rng(11)
    u = a**0.8
    v = np.maximum(b**0.8 * (b > 0.0), 0.45 * u * (b > 0.0))  # the wake turns a slow one
    inflow = np.sqrt(0.3 * u**2 + 0.05 * v**2)
    drag = 0.95 * v**2 - 0.5 * u**2 * (v <= 0.451 * u)
    clean = {
        "upper_thrust_N": 25.0 * u**2,
        "upper_torque_Nm": 0.5 * u**2,
        "lower_thrust_N": 26.0 * v * (v - 0.4 * inflow),
        "lower_torque_Nm": 0.5 * drag,
    }
    log = {
        "time_s": 3.0 * np.arange(len(a)),
        "upper_throttle": a,
        "lower_throttle": b,
        "upper_rpm": FULL_RPM * u * (1.0 + 2e-3 * random.standard_normal(len(a))),
        "lower_rpm": FULL_RPM * v * (1.0 + 2e-3 * random.standard_normal(len(a))),
    }
    noise = {n: 0.006 * y.max() * random.standard_normal(len(a)) for n, y in clean.items()}
    return Samples(log | {n: y + noise[n] for n, y in clean.items()}, "raster")


@pytest.mark.slow
def test_a_map_holds_nothing_against_its_own_model() -> None:
    log = raster()
    answer = refine_stand(log, identify(log).model)
    assert [e.name for e in answer.effects] == []
    assert any("the wake turns the lower rotor, not its throttle" in note for note in answer.notes)


def test_a_rotor_that_never_stood_on_the_model_s_stand_is_not_judged_at_rest() -> None:
    model = identify(raster()).model
    assert model.identified["measured"]["rested"] == []
    alone = raster(lower=(0.0, 0.0))
    with pytest.raises(InputError, match="turn as they did not on the model's stand"):
        stand_frame(alone.without("upper_thrust_N", "upper_torque_Nm"), model)
    # its upper loads are of their own speed alone, so these are judged
    assert not any(b for _, b in (*model.upper_thrust.exponents, *model.upper_torque.exponents))
    assert set(stand_frame(alone, model).present) & {0, 1, 2, 3} == {0, 1}
    assert model.measured_at([[0.5, 0.5], [0.5, 0.0], [0.02, 0.5], [1.2, 0.5]]).tolist() == [
        [True, True], [True, False], [False, True], [False, True],
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="the public stand maps are not beside this checkout")
def test_a_public_map_against_its_own_model_and_against_one_rotor_alone() -> None:
    """It had `dead_band`, 0.87; the rotor alone had `blade_speed_law`, 0.94."""
    log = read_stand_log(REAL / "u5_16in_zD05.csv", upper="left")
    model = identify(log).model
    assert refine_stand(log, model).effects == ()
    with pytest.raises(InputError, match="turn as they did not on the model's stand"):
        refine_stand(read_stand_log(REAL / "u5_16in_single.csv", upper="left"), model)


def test_a_map_in_one_pass_tells_no_drift_from_its_lower_rotor_s_speed() -> None:
    (drift,) = [e for e in stand_effects() if e.name == "sensor_drift"]
    one_pass = raster()
    with pytest.raises(NotShown, match="the lower rotor went through its speeds once"):
        drift.starts(stand_frame(one_pass, None))
    again = one_pass.take(np.concatenate([np.arange(0, 64, 2), np.arange(1, 64, 2)]))
    again = again.with_columns(time_s=3.0 * np.arange(64))
    assert drift.starts(stand_frame(again, None))
    assert drift.starts(stand_frame(one_pass, identify(one_pass).model))
