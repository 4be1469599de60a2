"""Yaw doublets of `fly --plan identify`, flown by the world's own PX4 on tables of models that are off."""

from __future__ import annotations

import numpy as np
import pytest

from coaxlink.constants import FULL, TURNING
from coaxlink.files import example
from coaxlink.fly.plans import CAUTIOUS_RAD_S2, plan_of
from coaxlink.mixer.authority import HIGH, LOW, MOST_DEG, doublet_acceleration, doublet_deg, yaw_authority
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.rotor.model import RotorModel
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Vehicle, load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.quick.plans import PLANS
from sim.vehicle import read_vehicle

ROTORS = example("rotor_paper.toml")
GUSTS = (
    HiddenEffect("wind", 4.0, 0.0, {"direction_deg": 30.0}, "dryden"),
    HiddenEffect("battery_voltage", 0.3),
)
# upper and lower thrust and torque of the prior over the true pair's; the first two yaw least
OFF = ((1.15, 1.15, 1.15, 0.85), (0.85, 1.15, 0.85, 0.85), (1.0, 1.0, 1.0, 1.0))


def believed(name, factors):
    """The vehicle with a model whose loads are off as a whole."""
    vehicle = load_vehicle(example(name), ROTORS)
    true = vehicle.rotors
    terms = {
        load: {term: f * c for term, c in own.items()}
        for (load, own), f in zip(true.terms().items(), factors, strict=True)
    }
    return Vehicle(vehicle.declared, RotorModel.from_terms(true.form, true.speed_max_rpm, terms))


def commands(name, vehicle, acceleration, monkeypatch):
    """(rows, N) what the motors were told in the plan's doublets."""
    plan = plan_of("identify", 4.0, 2.0, acceleration)

    def goals(times, seed):
        rows = []
        for t in times:
            p = plan.at(max(float(t), 0.0))[1]
            rows.append([*p.position_m, *p.velocity_m_s, *p.acceleration_m_s2, p.yaw_rad, 0.0])
        return np.array(rows)

    monkeypatch.setitem(PLANS, "given", goals)
    table = report_px4(vehicle, "fitted").params
    made = make_design(read_vehicle(example(name)), read_pair(ROTORS), table)
    world = FlightWorld(GUSTS, 5, "given", plan.duration_s)
    log = fly_quick(made, world, 8)[1]
    time = log["time_s"] - log["time_s"][0] - world.settle_s
    rows = np.array([t > 0.0 and plan.at(float(t))[0] == "yaw doublets" for t in time])
    return np.stack([log[f"motor{r.number}"] for r in vehicle.airframe.rotors], axis=1)[rows]


@pytest.mark.slow
@pytest.mark.parametrize("factors", OFF[:1])
@pytest.mark.parametrize("name", ["x8_demo.toml", "y6.toml"])
def test_doublets_keep_every_motor_inside_its_range(name, factors, monkeypatch):
    vehicle = believed(name, factors)
    determined = commands(name, vehicle, doublet_acceleration(vehicle), monkeypatch)
    assert len(determined) > 500
    assert determined.min() > TURNING and determined.max() < FULL
    unsized = commands(name, vehicle, np.inf, monkeypatch)
    assert np.ptp(unsized, axis=0).max() > 1.2 * np.ptp(determined, axis=0).max()


@pytest.mark.slow
def test_unsized_doublets_stop_motors(monkeypatch):
    determined = commands("y6.toml", believed("y6.toml", OFF[0]), np.inf, monkeypatch)
    assert (determined.min(axis=1) < TURNING).mean() > 0.05


@pytest.mark.parametrize("name", ["x8_demo.toml", "y6.toml"])
def test_authority_is_the_yaw_at_which_the_first_rotor_leaves_its_range(name):
    vehicle = load_vehicle(example(name), ROTORS)
    yaw, law = yaw_authority(vehicle), FittedLaw(vehicle)
    weight = vehicle.airframe.mass_kg * 9.80665

    def ends(share):
        speeds = np.array([law.speeds([weight, 0.0, 0.0, way * share * yaw]) for way in (-1.0, 1.0)])
        return speeds.min() < LOW or speeds.max() > HIGH

    assert not ends(0.99) and ends(1.02)


def test_a_doublets_angle_is_its_accelerations():
    plan = plan_of("identify", 4.0, 2.0, 1.0)
    times = np.arange(0.0, plan.duration_s, 0.01)
    yaw = np.array([plan.at(float(t))[1].yaw_rad for t in times])
    assert np.degrees(np.ptp(yaw)) == pytest.approx(doublet_deg(1.0, 12.0, 4), rel=1e-3)
    inside = np.abs(np.gradient(np.gradient(yaw, times), times))
    assert np.quantile(inside[inside > 1e-6], 0.98) == pytest.approx(1.0, rel=0.02)
    assert doublet_deg(100.0, 12.0, 4) == MOST_DEG
    gentle = plan_of("identify", 4.0, 2.0)
    assert max(gentle.at(float(t))[1].yaw_rad for t in times) == pytest.approx(
        np.radians(doublet_deg(CAUTIOUS_RAD_S2, 12.0, 4)), rel=1e-3
    )
