"""What verbs that mix share about the effects of a rotor file: the conditions' options, and what is said."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.shell import say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.vehicle import Vehicle

DENSITY = (0.3, 1.8)  # of air that anyone flies in, kg/m3

VoltageOption = Annotated[
    float | None, typer.Option(metavar="V", help="Supply to be right at, for a rotor file that knows it.")
]
HeightOption = Annotated[float | None, typer.Option(metavar="M", help="Height above ground to be right at.")]
ClimbOption = Annotated[float | None, typer.Option(metavar="M/S", help="Climb speed to be right at.")]
DensityOption = Annotated[
    float | None, typer.Option(metavar="KG/M3", help="Density of the air to be right in.")
]


def vehicle_of(
    airframe: Path,
    rotor: Path | None,
    *,
    voltage: float | None = None,
    height: float | None = None,
    climb: float | None = None,
    density: float | None = None,
    measured_live: bool = False,
) -> tuple[Vehicle, Path]:
    """The vehicle of the files and options, and its rotor file's path.

    Raises InputError, also for rotors that do not lift.
    """
    from coaxlink.premises.rotation import MEASURE, turned_otherwise
    from coaxlink.vehicle import Conditions, load_vehicle

    for name, value in (("--voltage", voltage), ("--height", height), ("--climb", climb)):
        if value is not None and not math.isfinite(value):
            raise InputError(name, f"{value:g}", "a finite number expected")
    for name, value in (("--voltage", voltage), ("--height", height)):
        if value is not None and value < 0:
            raise InputError(name, f"{value:g}", "0 or more expected")
    if density is not None and not DENSITY[0] <= density <= DENSITY[1]:
        raise InputError("--density", f"{density:g}", f"{DENSITY[0]} to {DENSITY[1]} kg/m3 expected")
    at = Conditions(voltage, height, climb, air_density_kg_m3=density)
    vehicle = load_vehicle(airframe, rotor, at, measured_live=measured_live)
    _say_unused(vehicle)
    if premise := turned_otherwise(vehicle.declared, vehicle.rotors):
        say(f"not measured: {premise}: measure {MEASURE}")
    path = rotor or vehicle.declared.rotor_model
    assert path is not None
    return vehicle, path


def _say_unused(vehicle: Vehicle) -> None:
    """A condition that no effect of the rotor file depends on changes nothing: reported, not passed over."""
    from dataclasses import replace

    from coaxlink.vehicle import Vehicle

    for name, value in vars(vehicle.conditions).items():
        if value is None:
            continue
        without = Vehicle(vehicle.declared, vehicle.rotors, replace(vehicle.conditions, **{name: None}))
        if without.compensated == vehicle.compensated:
            say(f"`{name}` {value:g} changes nothing: no effect of the rotor file depends on it")


def say_effects(vehicle: Vehicle) -> None:
    """One line an effect on stderr: what was done about it, or why nothing was."""
    for name, what in vehicle.compensated.items():
        say(f"compensated: {name}: {what}")
    for name, why in vehicle.left_out.items():
        say(f"not compensated: {name}: {why}")
