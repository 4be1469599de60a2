"""What verbs that mix share about the effects of a rotor file: the conditions' options, and what is said."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli._shell import say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.mixer import Seen

DENSITY = (0.3, 1.8)  # of air that anyone flies in, kg/m3

VoltageOption = Annotated[
    float | None, typer.Option(metavar="V", help="Supply to be right at, for a rotor file that knows it.")
]
HeightOption = Annotated[float | None, typer.Option(metavar="M", help="Height above ground to be right at.")]
ClimbOption = Annotated[float | None, typer.Option(metavar="M/S", help="Climb speed to be right at.")]
DensityOption = Annotated[
    float | None, typer.Option(metavar="KG/M3", help="Density of the air to be right in.")
]


def load_seen(
    airframe: Path,
    rotor: Path | None,
    *,
    voltage: float | None = None,
    height: float | None = None,
    climb: float | None = None,
    density: float | None = None,
) -> tuple[Seen, Path]:
    """The airframe and its rotors with the effects of the rotor file in them, and that file's path.

    Raises InputError, also for rotors that do not lift.
    """
    from coaxlink.airframe import load_airframe
    from coaxlink.mixer import Conditions, see
    from coaxlink.rotor.model import load_rotor_model

    for name, value in (("--voltage", voltage), ("--height", height), ("--climb", climb)):
        if value is not None and not math.isfinite(value):
            raise InputError(name, f"{value:g}", "a finite number expected")
    if density is not None and not DENSITY[0] <= density <= DENSITY[1]:
        raise InputError("--density", f"{density:g}", f"{DENSITY[0]} to {DENSITY[1]} kg/m3 expected")
    frame = load_airframe(airframe)
    path = rotor_path(frame.rotor_model, rotor, airframe)
    model = load_rotor_model(path)
    refuse_no_lift(model, path)
    at = Conditions(voltage, height, climb, air_density_kg_m3=density)
    return see(frame, model, at), path


def rotor_path(own: Path | None, option: Path | None, airframe: Path) -> Path:
    """The rotor model to use: the option, or the airframe's own. Raises InputError when there is neither."""
    path = option or own
    if path is None:
        raise InputError(airframe, "rotor_model", "names no rotor model; give one with --rotor")
    return path


def refuse_no_lift(model: object, path: Path) -> None:
    """Raise InputError when a lone upper rotor, or a pair, at full speed does not pull upward."""
    from coaxlink.rotor import RotorModel

    assert isinstance(model, RotorModel)
    alone = float(model.upper_thrust(1.0, 0.0))
    if not alone > 0.0:
        problem = f"an upper rotor at full speed must lift, found {alone:.4g} N"
        raise InputError(path, "upper.thrust_N", problem)
    both = model.loads(1.0, 1.0)
    pair = float(both.upper_thrust + both.lower_thrust)
    if not pair > 0.0:
        raise InputError(path, "lower.thrust_N", f"a pair at full speed must lift, found {pair:.4g} N")


def say_effects(seen: Seen) -> None:
    """One line an effect on stderr: what was done about it, or why nothing was."""
    for name, what in seen.done.items():
        say(f"compensated: {name}: {what}")
    for name, why in seen.cannot.items():
        say(f"not compensated: {name}: {why}")
