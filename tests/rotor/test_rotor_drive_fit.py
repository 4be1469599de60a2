"""What throttles, volts and amps of a stand say: the drive, full throttle, battery watts."""

from pathlib import Path

import numpy as np
import pytest

from coaxlink.data import Samples, read_stand_log
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.mixer import make_law
from coaxlink.rotor import save_rotor_model
from coaxlink.rotor.drive_fit import drive_fits, watts_fits
from coaxlink.rotor.identification import identify
from coaxlink.rotor.log_checks import unusual
from coaxlink.rotor.stand_data import normalised_speeds, stand_data
from coaxlink.vehicle import load_vehicle
from sim.physics.rotors import read_pair
from sim.vehicle import read_vehicle


def stand(top, law, noise=5.0):
    throttle = np.linspace(0.1, top, 40)
    rpm = law(throttle) + noise * np.random.default_rng(1).standard_normal(40)
    turns = law(throttle) / 5000
    loads = {"upper_thrust_N": 60 * turns**2, "upper_torque_Nm": turns**2}
    return Samples({"upper_throttle": throttle, "upper_rpm": rpm, **loads}, "rig")


def test_full_throttle_is_read_off_the_drive():
    speeds = normalised_speeds(stand(0.85, lambda t: 7000 * t - 2000 * t**2))
    assert speeds.speed_max_rpm == pytest.approx(5000, rel=0.01)
    assert "by their drive over throttles up to 0.85" in speeds.source


def test_what_is_not_told_stays_the_fastest_row():
    untold = normalised_speeds(stand(0.6, lambda t: 7000 * t - 2000 * t**2, noise=400.0))
    assert untold.source == "fastest rpm in the log"


def test_few_rows_or_one_level_tell_no_drive():
    five, one = np.linspace(0.1, 0.9, 5), np.full(40, 0.5)
    assert not drive_fits(Samples({"upper_throttle": five, "upper_rpm": 4000 * five}, "rig"))
    assert not drive_fits(Samples({"upper_throttle": one, "upper_rpm": 4000 * one}, "rig"))


KV, OHM, FRICTION, SUPPLY, SOURCE, IDLE_A = (
    42.0,
    0.09,
    0.006,
    22.4,
    0.02,
    0.15,
)  # rad/s/V, ohm, N m, V, ohm, A


def motors(seed=1, amps_scale=1.0):
    """A pair with two brushless motors at a supply that sags; the wake takes torque off the lower one."""
    random = np.random.default_rng(seed)
    columns = {}
    t, s = (g.ravel() for g in np.meshgrid(np.linspace(0.1, 0.95, 10), np.linspace(0.1, 0.95, 10)))
    w, v = np.zeros(100), np.zeros(100)
    drawn = [np.zeros(100), np.zeros(100)]
    for _ in range(3000):
        torques = 1.1e-6 * w**2, 1.1e-6 * np.maximum(v**2 - 0.45 * w * v, 0.0)
        for k, (duty, speed, torque) in enumerate(zip((t, s), (w, v), torques, strict=True)):
            volts = SUPPLY - SOURCE * drawn[k]
            current = (duty * volts - speed / KV) / OHM
            speed += 8.0 * np.clip(current / KV - torque - FRICTION, -0.5, 0.5)
            np.maximum(speed, 0.0, out=speed)
            drawn[k] = np.maximum(current, 0.0) * duty
    for side, duty, speed, torque, amps in zip(
        ("upper", "lower"), (t, s), (w, v), torques, drawn, strict=True
    ):
        columns |= {
            f"{side}_throttle": duty,
            f"{side}_rpm": speed * 30 / np.pi + 4.0 * random.standard_normal(100),
            f"{side}_torque_Nm": torque + 1e-3 * random.standard_normal(100),
            f"{side}_thrust_N": 55.0 * torque,
            f"{side}_voltage_V": SUPPLY - SOURCE * amps,
            f"{side}_current_A": amps_scale * amps + IDLE_A,
        }
    return Samples(columns, "rig")


def test_a_motor_s_back_emf_and_resistance_are_found():
    log = motors()
    fits = drive_fits(log)
    for side, fit in fits.items():
        assert fit.known and fit.error < 0.004, side
    model = identify(log, "crm", compare=False).model
    drive = model.drive
    assert drive is not None
    # of back-EMF: command per rad/s is 1 / (Kv V); of the winding: R Kv / V per N m
    slope = (drive.lower.command_at(0.9, 0.0) - drive.lower.command_at(0.3, 0.0)) / 0.6
    assert slope == pytest.approx(model.speed_max_rpm * np.pi / 30 / (KV * drive.voltage_V), rel=0.03)
    resistance = drive.lower.torque_per_Nm + 0.6 * drive.lower.torque_speed_per_Nm
    assert resistance == pytest.approx(OHM * KV / drive.voltage_V, rel=0.1)
    # what it turns at commands between the rows, both at once
    again = motors(seed=2)
    u, v = model.turned(again["upper_throttle"], again["lower_throttle"], again["lower_voltage_V"])
    flying = (again["upper_throttle"] > 0.3) & (again["lower_throttle"] > 0.6 * again["upper_throttle"])
    for side, speeds in (("upper", u), ("lower", v)):
        off = speeds * model.speed_max_rpm - again[f"{side}_rpm"]
        assert np.abs(off[flying]).max() < 0.02 * model.speed_max_rpm, side


def test_battery_watts_are_found_and_their_efficiency_is_a_drive_s():
    log = motors()
    for side, fit in watts_fits(log).items():
        drawn = log[f"{side}_voltage_V"] * log[f"{side}_current_A"]
        rad_s, torque = log[f"{side}_rpm"] * np.pi / 30, log[f"{side}_torque_Nm"]
        flying = torque > 0.1
        off = fit.power.watts(rad_s, torque)[flying] / drawn[flying] - 1.0
        assert np.abs(off).max() < 0.05 and 0.7 < fit.efficiency < 0.95, side


@pytest.mark.parametrize("share", [0.09, 0.0, -0.06])
def test_a_current_sensor_that_reads_some_of_the_other_side_s_current_is_put_right(share):
    true, pairs = motors(), (("upper", "lower"), ("lower", "upper"))
    read = {
        f"{own}_current_A": np.maximum(true[f"{own}_current_A"] - share * true[f"{other}_current_A"], 0.1)
        for own, other in pairs
    }
    log = true.with_columns(**read)
    for side, fit in watts_fits(log).items():
        drawn = true[f"{side}_voltage_V"] * true[f"{side}_current_A"]
        rad_s, torque = log[f"{side}_rpm"] * np.pi / 30, log[f"{side}_torque_Nm"]
        flying = torque > 0.1
        off = fit.power.watts(rad_s, torque)[flying] / drawn[flying] - 1.0
        assert np.abs(off).max() < 0.06 and fit.crosstalk == pytest.approx(share, abs=0.015), side
    assert any("on one ground" in line for line in unusual(stand_data(log), "crm")) == bool(share)


def test_speeds_and_torques_that_come_back_exactly_are_no_fault():
    """As of a stand that regulates speed and a log that rounds."""
    log = motors()
    rounded = {f"{side}_rpm": 200.0 * np.round(log[f"{side}_rpm"] / 200.0) for side in ("upper", "lower")}
    rounded |= {
        f"{side}_torque_Nm": 0.2 * np.round(log[f"{side}_torque_Nm"] / 0.2) for side in ("upper", "lower")
    }
    assert set(watts_fits(log.with_columns(**rounded))) == {"upper", "lower"}


COAX = Path(__file__).parents[3] / "shared" / "data" / "coax"


@pytest.mark.shared_data
@pytest.mark.skipif(not COAX.is_dir(), reason="needs the real stand data beside the repository")
def test_on_a_public_stand_motors_gave_more_than_they_took_until_its_sensors_were_put_right():
    log = read_stand_log(COAX / "mn4014_16in_zD055.csv", upper="left")
    for side, fit in watts_fits(log).items():
        rad_s, torque = log[f"{side}_rpm"] * np.pi / 30, log[f"{side}_torque_Nm"]
        read = log[f"{side}_voltage_V"] * log[f"{side}_current_A"]
        loaded = torque * rad_s > 20.0
        assert fit.crosstalk == pytest.approx(0.09, abs=0.02) and fit.power.error < 5.0
        assert (fit.power.watts(rad_s, torque) > 1.05 * torque * rad_s)[loaded].all()
        if side == "upper":
            assert np.sum(read[loaded] < (torque * rad_s)[loaded]) > 5


@pytest.mark.parametrize("offset_A", [-0.3, 0.0])
def test_no_battery_gives_less_than_the_shaft_takes(offset_A):
    """A current sensor that reads low where little flows: an allocator would go where power is free."""
    log = motors()
    log = log.with_columns(upper_current_A=log["upper_current_A"] + offset_A)
    power = watts_fits(log)["upper"].power
    rad_s, share = np.meshgrid(np.linspace(50.0, 900.0, 20), np.linspace(0.3, 1.1, 9))
    torque = 1.1e-6 * share * rad_s**2
    assert (power.watts(rad_s, torque) >= torque * rad_s).all()


def test_more_shaft_than_battery_power_is_said_of_the_log():
    lines = list(unusual(stand_data(motors(amps_scale=0.6)), "crm"))
    assert any("battery's watts reach the shaft" in line for line in lines)
    assert not any("reach the shaft" in line for line in unusual(stand_data(motors()), "crm"))


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """A rotor file of a pair whose ESCs bend rpm over throttle, and what it was made of."""
    t, s = (grid.ravel() for grid in np.meshgrid(np.linspace(0.1, 1.0, 10), np.linspace(0.1, 1.0, 10)))
    columns = {}
    for side, throttle, thrust in (("upper", t, 55.0), ("lower", s, 40.0)):
        turns = esc(throttle)
        columns |= {f"{side}_throttle": throttle, f"{side}_rpm": 5000 * turns}
        columns |= {f"{side}_thrust_N": thrust * turns**2, f"{side}_torque_Nm": 1.2 * turns**2}
    path = tmp_path_factory.mktemp("bent") / "rotor.toml"
    save_rotor_model(path, identify(Samples(columns, "rig"), "rcrm").model)
    return path


def esc(throttle):
    """Share of full speed."""
    return 1.4 * throttle - 0.4 * throttle**2


def test_laws_know_speeds_and_command_by_the_drive(bent):
    vehicle = load_vehicle(example("x8_paper.toml"), bent)
    speeds = make_law("exact", vehicle).speeds(np.array([196.0, 0.0, 0.0, 0.0]))
    upper = np.array([rotor.level == "upper" for rotor in vehicle.airframe.rotors])
    assert np.sum(np.where(upper, 55.0, 40.0) * speeds**2) == pytest.approx(196.0, rel=0.01)
    assert esc(vehicle.commanded(speeds)) == pytest.approx(speeds, abs=5e-3)


def test_a_flight_is_predicted_by_the_drive(bent):
    vehicle = load_vehicle(example("x8_paper.toml"), bent)
    turned = vehicle.airframe.turned(vehicle.rotors, np.full(8, 0.5))
    assert turned == pytest.approx(np.full(8, esc(0.5)), abs=5e-3)


def test_the_world_reads_the_files_that_init_and_identify_write(bent, tmp_path):
    body = tmp_path / "x8.toml"
    text = example("x8_paper.toml").read_text()
    body.write_text(text + '\n[sources]\nmass_kg = "measured"\n')
    assert read_vehicle(body).rotors == 8
    assert read_pair(bent).speed_max_rpm == pytest.approx(5000, rel=0.01)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('rpm_over_throttle = { upper = ["a", 1, 2] }', "identified.rpm_over_throttle.upper"),
        ("throttle_to = 0.6", "throttles went to 0.60"),
    ],
)
def test_a_drive_that_tells_nothing_is_refused(bent, tmp_path, line, says):
    path = tmp_path / "rotor.toml"
    path.write_text(bent.read_text().replace("[identified]\n", f"[identified]\n{line}\n"))
    with pytest.raises(InputError, match=says):
        load_vehicle(example("x8_paper.toml"), path)


def test_a_governed_motor_has_no_drive():
    log = stand(0.9, lambda t: 6000 * t, noise=0.0)
    assert identify(log, "crm", compare=False).model.drive is None
    assert normalised_speeds(log).speed_max_rpm == pytest.approx(6000.0)
