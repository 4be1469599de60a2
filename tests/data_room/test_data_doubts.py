"""What a log leaves open is said: pulses, units of another quantity, turns of the field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stand_files import SIDES, Pair, grid, readings, table, write

from coaxlink.data import read_stand_log
from coaxlink.data.headings import recognise
from coaxlink.data.unit_check import electrical_turns, other_units
from coaxlink.errors import InputError
from coaxlink.rotor.identification import identify
from coaxlink.rotor.plausible import poor_errors

TRUE = readings(Pair(0.4, 0.09, 0.65, 6000.0), *grid(), 1)
UNITS = {"speed": "rpm", "thrust": "N", "torque": "N m", "current": "A", "voltage": "V"}


def log(folder: Path, quantities: str = "speed thrust torque current voltage", **factors: float) -> Path:
    columns = {
        f"{side} {q} ({UNITS[q]})": TRUE[f"{side}_{q}"] * factors.get(q, 1.0)
        for side in SIDES
        for q in quantities.split()
    }
    return write(folder / "log.csv", table(columns))


@pytest.mark.parametrize(
    ("heading", "label"),
    [
        ("ESC signal (µs)", ""),
        ("Signal A (us)", "a"),
        ("Motor 1 (µs)", "1"),
        ("Upper pulse width [us]", "upper"),
        ("lower_us", "lower"),
        ("upper command (us)", "upper"),
    ],
)
def test_pulses_in_microseconds_are_throttles(heading: str, label: str) -> None:
    found = recognise(0, heading)
    assert found is not None and (found.quantity, found.label) == ("throttle", label)
    assert found.unit is not None and found.unit.name == "us"


@pytest.mark.parametrize("heading", ["us", "A (us)", "Servo 1 (µs)", "loop duration (us)", "Motor 1 (%)"])
def test_what_else_is_counted_in_microseconds_is_no_throttle(heading: str) -> None:
    found = recognise(0, heading)
    assert found is None or found.quantity != "throttle"


def test_other_units_are_told_by_their_quantity(tmp_path: Path) -> None:
    path = log(tmp_path, "speed thrust torque", thrust=1 / 9.80665)
    with pytest.raises(InputError, match=r"the thrust in kgf or lbf would be, or the torque in kgf cm"):
        read_stand_log(path, trust_units=False)


def test_the_line_for_a_map_is_of_the_column_that_is_refused(tmp_path: Path) -> None:
    columns = {
        f"{s} {q} ({u})": TRUE[f"{s}_{q}"] for s in SIDES for q, u in (("speed", "rpm"), ("thrust", "N"))
    }
    columns |= {f"{s} torque (kgf)": TRUE[f"{s}_torque"] for s in SIDES}
    with pytest.raises(InputError, match=r"upper_torque_Nm = .* unit = \"N m\""):
        read_stand_log(write(tmp_path / "log.csv", table(columns)))


def test_electrical_turns_under_rpm_are_refused_or_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"electrical turns \(`poles`\)"):
        read_stand_log(log(tmp_path, speed=7.0), trust_units=False)
    silent = read_stand_log(log(tmp_path, "speed thrust torque", speed=7.0), trust_units=False)
    assert "electrical turns" in electrical_turns(silent)
    right = read_stand_log(log(tmp_path, "speed thrust torque"), trust_units=False)
    assert electrical_turns(right) == "" and other_units(right) == ""
    with pytest.raises(InputError):  # its size tells
        read_stand_log(log(tmp_path, "speed thrust torque", speed=7.0), trust_units=False, diameter_m=0.4)


def test_a_log_without_speeds_says_which_units_fit_as_well(tmp_path: Path) -> None:
    path = log(tmp_path, "thrust torque", thrust=1 / 9.80665)
    rows = path.read_text().splitlines()
    share = {s: TRUE[f"{s}_speed"] / TRUE[f"{s}_speed"].max() for s in SIDES}
    added = [
        f"{row},{u:.4f},{v:.4f}" for row, u, v in zip(rows[1:], share["upper"], share["lower"], strict=True)
    ]
    write(path, "\n".join([f"{rows[0]},upper throttle,lower throttle", *added]) + "\n")
    found = read_stand_log(path, trust_units=False)
    assert "thrust in kgf" in other_units(found)
    with pytest.raises(InputError, match="kgf"):
        read_stand_log(path, trust_units=False, diameter_m=0.4)


@pytest.mark.parametrize(("scatter", "poor"), [(0.005, False), (0.15, True)])
def test_a_rotor_alone_whose_model_misses_what_it_has_not_seen(
    tmp_path: Path, scatter: float, poor: bool
) -> None:
    random = np.random.default_rng(3)
    u = np.linspace(0.2, 1.0, 60)
    noise = 1 + scatter * random.standard_normal((2, 60))
    columns = {
        "Speed (rpm)": 6000 * u,
        "Thrust (N)": 25 * u**2 * noise[0],
        "Torque (N m)": 0.4 * u**2 * noise[1],
    }
    found = identify(read_stand_log(write(tmp_path / "alone.csv", table(columns))), "srm")
    assert any("upper_thrust" in line for line in poor_errors(found)) == poor
