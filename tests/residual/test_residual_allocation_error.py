"""Meant against delivered, on a hover whose shortfall is known."""

import numpy as np
import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual.allocation_error import allocation_errors
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle

UPPER, LOWER = 0.441, 0.648
UPPER_N = 55.9517 * UPPER**2 + 22.4464 * UPPER  # eq. 17 by hand
LOWER_N = 2.755 * UPPER**2 * LOWER**2 + 64.721 * LOWER**2 - 2.547 * UPPER * LOWER + 12.402 * LOWER
LOWER_N += -37.502 * UPPER**2 + 0.801


def hover(shortfall_N):
    rows = 2000
    rng = np.random.default_rng(3)
    columns = {"time_s": np.arange(rows) * 0.01}
    for name in ("gyro_x", "gyro_y", "gyro_z"):
        columns[f"{name}_rad_s"] = np.zeros(rows)
    for name in ("accel_x", "accel_y"):
        columns[f"{name}_m_s2"] = 0.01 * rng.standard_normal(rows)
    lift = 4 * (UPPER_N + LOWER_N) - shortfall_N
    columns["accel_z_m_s2"] = -lift / 20.0 + 0.01 * rng.standard_normal(rows)
    for name in ("roll_rad", "pitch_rad", "yaw_rad", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s"):
        columns[name] = np.zeros(rows)
    columns["height_m"] = np.full(rows, 3.0)
    for n in range(8):
        columns[f"motor{n + 1}"] = np.full(rows, UPPER if n < 4 else LOWER)
    return Samples(columns, "hover", ())


@pytest.mark.parametrize("shortfall_N", [0.0, 5.0])
def test_the_shortfall_and_the_split_are_what_was_put_in(shortfall_N):
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(airframe.rotor_model)
    full = 4 * (UPPER_N + LOWER_N)
    result = allocation_errors(
        hover(shortfall_N), Vehicle(airframe, model), lambda t, u: np.tile([full, 0.0, 0.0, 0.3], (len(t), 1))
    )
    assert result.thrust_error_N == pytest.approx(shortfall_N, abs=0.1)
    assert result.torque_error_Nm == pytest.approx((0.0, 0.0, 0.3), abs=1e-3)
    assert [(s.upper, s.lower) for s in result.split] == [(1, 6), (2, 5), (3, 8), (4, 7)]
    assert result.split[0].upper_N == pytest.approx(UPPER_N, rel=1e-6)
    assert result.split[0].lower_share == pytest.approx(LOWER_N / (UPPER_N + LOWER_N), rel=1e-6)


def test_the_best_constant_gain_takes_off_what_is_constant_and_no_more():
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(airframe.rotor_model)
    full = 4 * (UPPER_N + LOWER_N)

    def flown(meant):
        return allocation_errors(
            hover(0.0), Vehicle(airframe, model), lambda t, u: np.tile(meant(t)[:, None], (1, 4))
        )

    constant = flown(lambda t: np.full(len(t), full / 0.8))
    assert constant.gain[0] == pytest.approx(0.8, abs=1e-3)
    assert constant.thrust_error_N == pytest.approx(0.25 * full, rel=1e-3)
    assert constant.after_gain[0] < 0.1

    # delivered is constant where a wave of 0.2 Hz is meant: no gain can mend that (its last period is cut)
    waves = flown(lambda t: full * (1.0 + 0.2 * np.sin(2 * np.pi * 0.2 * t)))
    best = 1.0 / (1.0 + 0.5 * 0.2**2)
    assert waves.gain[0] == pytest.approx(best, abs=0.01)
    wave = 0.2 * np.sin(np.linspace(0.0, 2 * np.pi, 1000, endpoint=False))
    expected = full * np.abs(best * (1.0 + wave) - 1.0).mean()
    assert waves.after_gain[0] == pytest.approx(expected, rel=0.05)
