"""A drive between commands and speeds: what tables turn, what laws are told, and what that takes."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import allocate, make_law
from coaxlink.mixer.worth import weigh
from coaxlink.rotor.drive import BatteryPower, Drive, SideDrive
from coaxlink.rotor.model import load_rotor_model, save_rotor_model
from coaxlink.tables.px4 import px4_commands, report_px4
from coaxlink.vehicle import Conditions, Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
BENT = SideDrive((0.0, 0.62, 0.0), 0.22, range=(0.05, 1.0))
DRIVEN = dataclasses.replace(CRM, drive=Drive(BENT, BENT, 22.0))
VEHICLE = Vehicle(X8, DRIVEN)
RAD_S = CRM.speed_max_rpm * math.pi / 30.0


def turns(upper_command, lower_command):
    """Speeds of both rotors, one root after the other."""
    u = v = 0.5
    for _ in range(40):
        u = brentq(lambda x, v=v: 0.62 * x + 0.22 * float(CRM.upper_torque(x, v)) - upper_command, 0.0, 2.0)
        v = brentq(lambda x, u=u: 0.62 * x + 0.22 * float(CRM.lower_torque(u, x)) - lower_command, 0.0, 2.0)
    return u, v


def test_commands_turn_what_back_emf_and_torque_leave():
    for commands in ((0.5, 0.5), (0.9, 0.6), (0.3, 0.8)):
        assert np.array(DRIVEN.turned(*commands)) == pytest.approx(turns(*commands), abs=2e-4)
    # the wake takes torque off the lower rotor: it turns faster at the same command
    assert DRIVEN.turned(0.9, 0.5)[1] > DRIVEN.turned(0.1, 0.5)[1] + 0.01


def test_what_is_commanded_is_what_turns():
    commands = np.random.default_rng(1).uniform(0.2, 1.0, (50, 8))
    assert VEHICLE.commanded(VEHICLE.turned(commands)) == pytest.approx(commands, abs=2e-3)
    assert VEHICLE.turned(np.zeros(8)) == pytest.approx(np.zeros(8), abs=1e-6)
    assert VEHICLE.commanded(np.zeros(8)) == pytest.approx(np.zeros(8), abs=1e-9)
    assert np.isnan(VEHICLE.turned(np.full(8, np.nan))).all()


def test_a_command_counts_for_the_supply_that_is_there():
    low = Vehicle(X8, DRIVEN, Conditions(voltage_V=0.8 * 22.0))
    assert low.turned(np.full(8, 0.9)) == pytest.approx(VEHICLE.turned(np.full(8, 0.72)), abs=1e-9)
    volts = np.array([22.0, math.nan, 0.0])
    row = DRIVEN.turned(np.full(3, 0.5), np.full(3, 0.5), volts)[0]
    assert row == pytest.approx(np.full(3, row[0]))  # a voltage that is not known changes nothing


def test_a_table_s_power_is_torque_times_the_speed_that_its_commands_turn():
    flown = px4_commands(report_px4(VEHICLE, "standard").mix)
    worth = weigh(VEHICLE, flown)
    u, v = turns(*flown(0.0, 0.0, 0.0, worth.hover_demand)[[0, 5]])
    loads = CRM.loads(u, v)
    assert 4 * float(loads.upper_thrust + loads.lower_thrust) == pytest.approx(20 * 9.80665, rel=1e-3)
    shaft = 4 * RAD_S * float(loads.upper_torque * u + loads.lower_torque * v)
    assert worth.hover_W == pytest.approx(shaft, rel=2e-3)
    assert math.isnan(worth.battery_W) and worth.minutes(100.0, 0.8) == pytest.approx(4800.0 / worth.hover_W)


def test_battery_watts_are_those_of_the_sides():
    power = {"upper": BatteryPower(5.0, 0.01, 0.0, 4.0, 1.0), "lower": BatteryPower(2.0, 0.0, 1e-4, 8.0, 1.1)}
    vehicle = Vehicle(X8, dataclasses.replace(DRIVEN, battery_power=power))
    a = allocate(make_law("fitted", vehicle), vehicle, [196.1, 0.0, 0.0, 0.0])
    w, q = a.speeds * RAD_S, a.torque_Nm
    upper, lower = [0, 1, 2, 3], [4, 5, 6, 7]
    drawn = np.sum(5.0 + 0.01 * w[upper] + 4.0 * q[upper] ** 2 + q[upper] * w[upper])
    drawn += np.sum(2.0 + 1e-4 * w[lower] ** 2 + 8.0 * q[lower] ** 2 + 1.1 * q[lower] * w[lower])
    assert a.battery_W == pytest.approx(drawn) and a.power_W == pytest.approx(float(q @ w))
    assert vehicle.turned(a.commands) == pytest.approx(a.speeds, abs=1e-3)


def test_a_rotor_file_keeps_its_drive(tmp_path):
    model = dataclasses.replace(DRIVEN, battery_power={s: BatteryPower(1.0) for s in ("upper", "lower")})
    save_rotor_model(tmp_path / "r.toml", model)
    read = load_rotor_model(tmp_path / "r.toml")
    assert read.drive == model.drive and read.battery_power == model.battery_power


def test_an_older_file_s_curve_is_read_as_a_drive(tmp_path):
    save_rotor_model(tmp_path / "new.toml", CRM)
    text = (tmp_path / "new.toml").read_text()
    curve = "[identified.rpm_over_throttle]\nupper = [0.0, 7560.0, -2160.0]\n"
    (tmp_path / "old.toml").write_text(text + curve)
    old = load_rotor_model(tmp_path / "old.toml")
    throttle = np.array([0.2, 0.5, 0.8, 1.0])
    for speeds in old.turned(throttle, throttle):
        assert speeds == pytest.approx(1.4 * throttle - 0.4 * throttle**2, abs=2e-3)


@pytest.mark.parametrize(
    ("side", "words"),
    [
        ("command = [0.0, -0.5, 0.0]", "does not grow"),
        ("command = [0.0, 1.0]\nrange = [0.9, 0.2]", "low < high"),
        ("command = [0.0]", "command"),
        ('command = [0.0, 1.0]\ntorque_per_Nm = "much"', "torque_per_Nm"),
    ],
)
def test_a_drive_that_turns_nothing_is_refused_by_its_key(tmp_path, side, words):
    save_rotor_model(tmp_path / "r.toml", CRM)
    path = tmp_path / "bad.toml"
    path.write_text((tmp_path / "r.toml").read_text() + f"\n[drive.upper]\n{side}\n")
    with pytest.raises(InputError, match=words):
        load_rotor_model(path)
