"""u = 1 is full throttle, where rpm go with throttle by a curve and the log stops before it."""

import numpy as np
import pytest

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.mixer import make_law
from coaxlink.rotor import save_rotor_model
from coaxlink.rotor.identification import identify
from coaxlink.rotor.stand_data import normalised_speeds
from coaxlink.rotor.throttle_curve import throttle_curve
from coaxlink.vehicle import load_vehicle
from sim.physics.rotors import read_pair
from sim.vehicle import read_vehicle


def stand(top, law, noise=5.0):
    throttle = np.linspace(0.1, top, 40)
    rpm = law(throttle) + noise * np.random.default_rng(1).standard_normal(40)
    loads = {"upper_thrust_N": 60 * throttle**2, "upper_torque_Nm": throttle**2}
    return Samples({"upper_throttle": throttle, "upper_rpm": rpm, **loads}, "rig")


def test_full_throttle_is_read_off_the_curve():
    speeds = normalised_speeds(stand(0.85, lambda t: 7000 * t - 2000 * t**2))
    assert speeds.speed_max_rpm == pytest.approx(5000, rel=0.01)
    assert "by their curve over throttles up to 0.85" in speeds.source


def test_what_was_measured_or_is_not_told_stays_the_fastest_row():
    measured = normalised_speeds(stand(1.0, lambda t: 7000 * t - 2000 * t**2))
    untold = normalised_speeds(stand(0.6, lambda t: 7000 * t - 2000 * t**2, noise=400.0))
    for speeds in (measured, untold):
        assert speeds.source == "fastest rpm in the log"


def test_few_rows_or_one_level_tell_no_curve():
    assert throttle_curve(np.linspace(0.1, 0.9, 5), np.linspace(500, 4000, 5)) is None
    assert throttle_curve(np.full(40, 0.5), np.full(40, 2500.0)) is None


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


def test_laws_command_by_the_curve(bent):
    vehicle = load_vehicle(example("x8_paper.toml"), bent)
    throttle = np.linspace(0.15, 1.0, 8)
    loads = vehicle.model.loads(throttle, throttle)
    assert loads.upper_thrust == pytest.approx(55 * esc(throttle) ** 2, abs=0.3)
    assert loads.lower_thrust == pytest.approx(40 * esc(throttle) ** 2, abs=0.3)
    speeds = esc(make_law("exact", vehicle).speeds(np.array([196.0, 0.0, 0.0, 0.0])))
    upper = [rotor.level == "upper" for rotor in vehicle.airframe.rotors]
    assert np.sum(np.where(upper, 55.0, 40.0) * speeds**2) == pytest.approx(196.0, rel=0.01)


def test_a_flight_is_predicted_by_the_curve(bent):
    vehicle = load_vehicle(example("x8_paper.toml"), bent)
    turned = vehicle.airframe.turned(vehicle.rotors, np.full(8, 0.5))
    assert turned == pytest.approx(np.full(8, esc(0.5)), abs=2e-3)


def test_the_world_flies_the_files_that_init_and_identify_write(bent, tmp_path):
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
def test_a_curve_that_tells_nothing_is_refused(bent, tmp_path, line, says):
    head, _, rest = bent.read_text().partition("[identified]\n")
    rest = rest.replace("[identified.rpm_over_throttle]", "[identified.other]")
    path = tmp_path / "rotor.toml"
    path.write_text(f"{head}[identified]\n{line}\n{rest}")
    with pytest.raises(InputError, match=says):
        load_vehicle(example("x8_paper.toml"), path)
