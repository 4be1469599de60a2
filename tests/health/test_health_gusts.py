"""What wind and sensors do to a model that flights tell: it is kept out of the rotors' coefficients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from case_table import case_table

from coaxlink.channels.flight import flight_frame
from coaxlink.data import read_flight_log
from coaxlink.files import example
from coaxlink.health.accelerometer import USUAL_M_S2, vertical_zero
from coaxlink.health.columns import passing
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor_update import regressors
from coaxlink.rotor_update.coefficients import coefficients_from_flights
from coaxlink.rotor_update.instrumental_variables import explained
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

FRAME, ROTORS = example("x8_demo.toml"), example("rotor_paper.toml")
BREEZE = (
    HiddenEffect("wind", 4.0, 0.0, {"direction_deg": 70.0}, "dryden"),
    HiddenEffect("axial_inflow", 0.5),
)


@pytest.fixture(scope="module")
def windy(tmp_path_factory):
    """(vehicle, logs of a hover, a circle and a wandering in gusts that take lift)."""
    vehicle, folder = load_vehicle(FRAME, ROTORS), tmp_path_factory.mktemp("windy")
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)
    logs = []
    for seed, plan in enumerate(("hover", "circle", "hover", "wander")):
        path = folder / f"{seed}.csv"
        write_flight(path, fly_quick(made, FlightWorld(BREEZE, seed, plan, 55.0), 8)[1])
        logs.append(read_flight_log(path))
    return vehicle, logs


def lift(model, speeds):
    """Of a pair, N."""
    terms = {k: v for k, v in model.terms().items() if "thrust" in k}
    u = np.array(speeds, float)
    return sum(
        c * design_matrix([t], u[:, 0], u[:, 1])[:, 0] for own in terms.values() for t, c in own.items()
    )


@pytest.mark.slow
def test_a_gust_that_is_answered_is_not_the_rotors_slope(windy, monkeypatch):
    vehicle, logs = windy
    hover = np.array(coefficients_from_flights(logs, vehicle.declared, vehicle.rotors).hover)
    speeds = [hover * np.sqrt(share) for share in (0.8, 1.2)]

    def slope():
        """Error of the lift's change between 0.8 and 1.2 of the weight, as a share of it."""
        model = coefficients_from_flights(logs, vehicle.declared, vehicle.rotors).model
        found, true = (np.diff(lift(m, speeds))[0] for m in (model, vehicle.rotors))
        return abs(found / true - 1.0)

    with_instruments = slope()
    monkeypatch.setattr(regressors, "explained", lambda columns, known: columns)
    assert with_instruments < 0.03 < slope()


def test_each_channel_is_seen_through_its_own_instruments():
    random = np.random.default_rng(0)
    known = [random.standard_normal((200, 3 + channel)) for channel in range(4)]
    columns = random.standard_normal((200, 4, 2)) + 1.0
    seen = explained(columns, known)
    for channel, own in enumerate(known):
        assert np.allclose(own.T @ (columns - seen)[:, channel], 0.0, atol=1e-9)
        assert np.linalg.matrix_rank(np.column_stack([own, seen[:, channel]])) == own.shape[1]


def test_the_last_digit_of_a_command_is_not_seen_in_the_torques(windy):
    """What a log rounds moves no rotor: the coefficients' torques stay as they are without it."""
    vehicle, logs = windy
    names = [(load, term) for load, own in vehicle.rotors.terms().items() for term in own]
    random = np.random.default_rng(2)
    motors = [f"motor{r.number}" for r in vehicle.declared.rotors]
    rounded = logs[0].with_columns(
        **{m: logs[0][m] + random.uniform(-1e-3, 1e-3, logs[0].rows) for m in motors}
    )
    frames = [flight_frame([log], vehicle.declared, vehicle.rotors) for log in (logs[0], rounded)]
    raw, seen = zip(*(regressors.regressors(f, names, True, 0.01)[:2] for f in frames), strict=True)
    upper, lower = names.index(("upper.thrust_N", "u_u^2")), names.index(("lower.thrust_N", "u_l^2"))

    def apart(columns):
        """Share of the roll that the upper rotors have and the lower ones have not."""
        a, b = (columns[0][:, 1, k] - columns[0][:, 1, k].mean() for k in (upper, lower))
        return float(np.std(a - b * (a @ b) / (b @ b)) / np.std(a))

    assert apart(raw[1]) > 2.0 * apart(raw[0])
    assert apart(seen[1]) < 0.3 * apart(raw[1])


def test_the_accelerometers_zero_is_read_from_the_velocity(windy):
    with case_table() as case:
        for zero in (0.0, 0.08, -0.08):
            with case(f"{zero}"):
                vehicle, logs = windy
                frame = flight_frame([logs[0]], vehicle.declared, vehicle.rotors)
                force = frame.specific_force + np.array([0.0, 0.0, zero])
                found, sd = vertical_zero(replace(frame, specific_force=force))
                assert sd < 0.01
                assert found == pytest.approx(zero, abs=3.0 * sd)


def test_an_accelerometer_that_is_at_odds_with_the_velocity_says_nothing(windy):
    vehicle, logs = windy
    frame = flight_frame([logs[0]], vehicle.declared, vehicle.rotors)
    assert vertical_zero(replace(frame, specific_force=1.05 * frame.specific_force)) == (0.0, USUAL_M_S2)


def test_the_ground_is_a_part_only_of_flights_that_feel_it(windy):
    vehicle, logs = windy
    frame = flight_frame([logs[0]], vehicle.declared, vehicle.rotors)
    low = replace(frame, height=frame.height - np.min(frame.height) + 0.5)
    names = [{c.name for c in passing(f)} for f in (frame, low)]
    assert names[1] - names[0] == {"ground"} and not names[0] - names[1]
