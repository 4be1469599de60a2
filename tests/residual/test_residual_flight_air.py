"""Air that moves: a wind is told from a drag, and what the effects add follows the physics it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.channels.flight import flight_frame
from coaxlink.data import Samples
from coaxlink.effects import axial_inflow, ground_effect, wind
from coaxlink.rotor import load_rotor_model

HIDDEN = {"drag": {"drag": 0.05}, "against": {"drag": 0.05, "wind": (-4.5, 0.4)}}


@pytest.fixture(scope="module")
def airframe():
    return replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)


@pytest.fixture(scope="module")
def flights():
    return {
        n: Samples(log, n)
        for n, log in zip(HIDDEN, fly(list(HIDDEN.values()), seconds=48.0, seed=8), strict=True)
    }


@pytest.fixture(scope="module")
def frame(flights, airframe):
    return flight_frame([flights["drag"]], airframe, load_rotor_model(files.example("rotor_paper.toml")))


@pytest.mark.slow
def test_less_wind_near_the_ground(frame):
    numbers = {
        "drag_per_speed_N_s_m": 0.0, "moment_N_s_m": 0.0, "body_drag_kg_m": 0.0, "body_drag_kg_s": 2.0,
        "wind_north_m_s": 5.0, "wind_east_m_s": 0.0, "shear_power": 0.25,
    }  # fmt: skip
    pushed = wind.FLIGHT.contribution(frame, numbers)[:, :3] + 2.0 * frame.velocity
    middle = np.median(frame.height[frame.keep])
    blows = 5.0 * (np.maximum(frame.height, 0.2) / middle) ** 0.25
    assert np.linalg.norm(pushed, axis=1) == pytest.approx(2.0 * blows, rel=1e-9)
    shape, values = wind.FLIGHT.inverse(frame, numbers)
    assert wind.FLIGHT.parameters(frame, shape, values) == pytest.approx(numbers | {"wind_m_s": 5.0})


@pytest.mark.parametrize("bend", [-1.0, 0.5])
def test_a_gain_that_bends_near_the_ground(frame, bend):
    numbers = {"effective_radius_m": 0.6, "height_power": 2.0, "levelling": bend}
    gained = ground_effect.FLIGHT.acting(frame, numbers).thrust / frame.thrust - 1.0
    first = (0.6 / 4.0 / ground_effect.disc_heights(frame)) ** 2
    rows = frame.keep
    assert gained[rows] == pytest.approx((first / (1.0 + bend * first))[rows], rel=1e-6)


def test_a_gain_that_ends_where_its_law_does(frame):
    height = ground_effect.disc_heights(frame)[frame.keep]
    flat = float(np.median(height))
    numbers = {"effective_radius_m": 0.6, "height_power": 2.0, "levelling": -1.0, "flat_below_m": flat}
    gained = ground_effect.FLIGHT.acting(frame, numbers).thrust / frame.thrust - 1.0
    law = 1.0 / (1.0 - (0.15 / np.maximum(height, flat)) ** 2) - 1.0
    assert gained[frame.keep] == pytest.approx(law, rel=1e-6)
    shape, values = ground_effect.FLIGHT.inverse(frame, numbers)
    assert ground_effect.FLIGHT.parameters(frame, shape, values) == pytest.approx(numbers)


def test_what_a_climb_takes_bends_with_the_inflows_ratio(frame):
    numbers = {"thrust_per_climb_N_s_m": 2.0, "levelling_s_m": 0.04}
    lost = frame.thrust - axial_inflow.FLIGHT.acting(frame, numbers).thrust
    ratio = axial_inflow.hub_climb(frame) / frame.speeds
    expected = 2.0 * frame.speeds**2 * ratio / (1.0 + 0.04 * np.abs(ratio))
    assert lost[frame.keep] == pytest.approx(expected[frame.keep], abs=1e-9)
