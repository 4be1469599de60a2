"""Flights whose ESCs tell how fast the rotors turned: the drive's doing, and what only looks like it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coaxlink.channels.flight import flight_frame
from coaxlink.channels.logged_speeds import by_logged_speeds
from coaxlink.data import read_flight_log
from coaxlink.files import example
from coaxlink.residual.refine import at_bounds, refine
from coaxlink.residual.result import Refinement
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

FRAME, ROTORS = example("x8_demo.toml"), example("rotor_paper.toml")
RPM = [f"rpm{n}" for n in range(1, 9)]
SAG = HiddenEffect("battery_voltage", 0.6)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """(vehicle, a way to fly it and read its log)."""
    vehicle = load_vehicle(FRAME, ROTORS)
    made = make_design(read_vehicle(FRAME), read_pair(ROTORS), report_px4(vehicle, "fitted").params)

    def fly(*effects):
        path = tmp_path_factory.mktemp("flights") / "flight.csv"
        write_flight(path, fly_quick(made, FlightWorld(effects, 3, "wander", 45.0), 8)[1])
        return read_flight_log(path)

    return vehicle, fly


def answered(vehicle, log):
    return refine(log, vehicle.declared, vehicle.rotors)


def test_speeds_of_a_sagging_pack_predict_its_flight(flown):
    vehicle, fly = flown
    log = fly(SAG)
    given = flight_frame([log], vehicle.declared, vehicle.rotors)
    turned = by_logged_speeds(given, [log])
    lift = [float(np.mean((f.measured - f.predicted)[f.keep, 2])) for f in (given, turned)]
    assert abs(lift[0]) > 10.0 > 1.0 > abs(lift[1])
    # once a second, and one ESC silent
    rare = log.with_columns(**{n: np.where(np.arange(log.rows) % 50 == 7, log[n], np.nan) for n in RPM})
    for less in (rare, log.without("rpm4")):
        again = by_logged_speeds(given, [less])
        assert np.median(np.abs(again.speeds - turned.speeds)) < 2e-3
    assert by_logged_speeds(given, [log.without(*RPM)]) is None
    assert by_logged_speeds(given, [log.without(*RPM[:4])]) is None


def test_one_motors_own_warming_is_told_and_noise_is_not(flown):
    vehicle, fly = flown
    log = fly()
    given = flight_frame([log], vehicle.declared, vehicle.rotors)
    warm = 1.0 - 0.03 * (1.0 - np.exp(-log["time_s"] / 30.0))
    turned = by_logged_speeds(given, [log.with_columns(rpm5=warm * log["rpm5"])])
    ratio = (turned.speeds / np.maximum(given.speeds, 1e-9))[given.keep]
    at = np.interp(given.time_s[given.keep], log["time_s"], warm)
    assert np.abs(ratio[:, 4] - at)[200:-200].max() < 3e-3
    assert np.abs(ratio[:, [0, 1, 2, 3, 5, 6, 7]] - 1.0).max() < 2e-3


def test_a_pack_that_sags_without_a_voltmeter_is_the_drive_and_no_mass(flown):
    vehicle, fly = flown
    log = fly(SAG).without("voltage_V")
    found = answered(vehicle, log)
    assert found.verdict == "open" and not found.effects and not found.ambiguous
    drive = next(u for u in found.unexplained if u.depends_on == ("rpm",))
    assert drive.channel == "force_z" and "identify the drive again" in drive.where


def test_a_supply_is_named_where_the_rpm_bear_it_out_and_not_where_they_deny_it(flown):
    vehicle, fly = flown
    log = fly(SAG)
    assert answered(vehicle, log).names == {"battery_voltage"}
    sound = fly()
    noise = np.random.default_rng(1).normal(0.0, 15.0, (8, log.rows))
    # at these commands, speeds as the motors of the sound flight had them for theirs
    ratio = np.median(sound["rpm1"][500:-500] / sound["motor1"][500:-500])
    denying = log.with_columns(**{f"rpm{n}": ratio * log[f"motor{n}"] + noise[n - 1] for n in range(1, 9)})
    found = answered(vehicle, denying)
    assert "battery_voltage" not in found.names.union(*(a.names for a in found.ambiguous))
    assert any(r.name == "battery_voltage" and "deny" in r.why for r in found.rejected)


def test_an_rpm_that_the_loads_contradict_is_named(flown):
    vehicle, fly = flown
    log = fly()
    found = answered(vehicle, log.with_columns(rpm3=1.05 * log["rpm3"]))
    assert [s.column for s in found.suspect_data] == ["rpm3"] and not found.effects
    assert "1.05" in found.suspect_data[0].why


def test_motors_that_all_turn_a_little_faster_than_the_file_says_are_no_finding(flown):
    vehicle, fly = flown
    log = fly()
    found = answered(vehicle, log.with_columns(**{n: 1.004 * log[n] for n in RPM}))
    assert (
        not found.suspect_data
        and not found.effects
        and not any("rpm" in u.depends_on for u in found.unexplained)
    )


@pytest.mark.parametrize(("mass", "asked"), [(1.0, False), (1.08, True)])
def test_a_lift_is_off_where_the_flight_says_so_and_not_where_levels_make_up_for_slopes(flown, mass, asked):
    vehicle, fly = flown
    body = replace(vehicle.declared, mass_kg=mass * vehicle.declared.mass_kg)
    frame = flight_frame([fly()], body, vehicle.rotors)
    levels = {"upper_thrust_level": 0.08, "lower_thrust_level": 0.08}
    nothing = Refinement("flight", {}, (), (), (), (), (), None, corrections=levels)
    assert [reason.premise for reason in at_bounds(nothing, frame)] == ["mass_kg"] * asked
