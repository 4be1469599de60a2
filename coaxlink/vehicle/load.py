"""A vehicle from its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coaxlink.airframe import load_airframe
from coaxlink.effects import effect, effects
from coaxlink.effects.base import FORMERLY
from coaxlink.effects.static import Conditions
from coaxlink.errors import InputError
from coaxlink.load import Load
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.vehicle.vehicle import Vehicle, require_vehicle
from firmware_params.keys import misspelt, unknown_key

DRIVEN = np.linspace(0.3, 1.0, 8)  # of full speed: what flies; slower, a fit has its own zero


def vehicle_of(given: Vehicle | str | Path) -> Vehicle:
    """A vehicle, or that of an airframe file which names its rotor model. Raises InputError for all else."""
    if isinstance(given, (str, Path)):
        return load_vehicle(given)
    require_vehicle(given)
    return given


def load_vehicle(
    airframe: str | Path,
    rotors: str | Path | None = None,
    conditions: Conditions | None = None,
    *,
    measured_live: bool = False,
) -> Vehicle:
    """The vehicle of an airframe file and a rotor model file (the airframe's own if not given).

    Raises InputError naming the file and the key, also for rotors that do not lift, that turn by themselves,
    or that lack an axis.

    >>> from coaxlink.files import example
    >>> load_vehicle(example("x8_paper.toml"))
    Vehicle('paper-x8', 8 rotors, 20 kg, effects in: none, left out: none)
    """
    frame = load_airframe(Path(airframe))
    path = Path(rotors) if rotors else frame.rotor_model
    if path is None:
        raise InputError(airframe, "rotor_model", "names no rotor model, and no other is given (rotor)")
    model = load_rotors(path)
    if lost := ", ".join(frame.lost_axes()):
        problem = f"these rotors cannot make {lost}, whatever their thrusts"
        raise InputError(airframe, "rotors", f"{problem}: are their positions (metres) and spins right?")
    if (top := model.identified.get("throttle_to")) is not None:
        problem = (
            f"throttles went to {top:.2f}, and rpm do not tell what they are at 1: commands mean nothing"
        )
        raise InputError(path, "identified.throttle_to", f"{problem}; measure there, or give `speed_max_rpm`")
    if frame.pairs and not model.lower_thrust.coefficients:
        problem = "none: a rotor alone was identified, and this airframe has pairs; measure both at once"
        raise InputError(path, Load.LOWER_THRUST.key, problem)
    return Vehicle(frame, model, conditions or Conditions(), measured_live)


def load_rotors(path: Path) -> RotorModel:
    """Read a rotor file. Raises InputError naming the file and the key, also for those of its effects.

    An effect of another name is no fault: its number may be measured by others. One that is spelt nearly as
    one of ours is, and so is a number that the effect does not have: both would be left out in silence.
    """
    model = load_rotor_model(path)
    refuse_no_rotor(model, path)
    for count, named in enumerate(model.effects, start=1):
        if meant := misspelt(named.name, [e.name for e in effects()]):
            raise InputError(path, f"effects[{count}].name", f"{named.name}: unknown; {meant}?")
        known = effect(named.name)
        odd = unknown_key(named.parameters, known.units.keys() | FORMERLY) if known else None
        if odd is not None:
            raise InputError(path, f"effects[{count}].parameters.{odd[0]}", odd[1])
    return model


def refuse_no_rotor(model: RotorModel, path: Path) -> None:
    """Raise InputError for what is no rotor: at full speed it lifts, from a third of it a torque turns it."""
    alone = float(model.upper_thrust(1.0, 0.0))
    if not alone > 0.0:
        problem = f"an upper rotor at full speed must lift, found {alone:.4g} N"
        raise InputError(path, Load.UPPER_THRUST.key, problem)
    both = model.loads(1.0, 1.0)
    pair = float(both.upper_thrust + both.lower_thrust)
    if not pair > 0.0:
        raise InputError(path, Load.LOWER_THRUST.key, f"a pair at full speed must lift, found {pair:.4g} N")
    turned = {"an upper rotor alone": (Load.UPPER_TORQUE, model.upper_torque(DRIVEN, 0.0 * DRIVEN))}
    if model.lower_thrust.coefficients:
        turned["a lower rotor as fast as the upper"] = Load.LOWER_TORQUE, model.lower_torque(DRIVEN, DRIVEN)
    for who, (load, torque) in turned.items():
        if not (torque > 0.0).all():
            worst = int(np.argmin(torque))
            found = f"found {torque[worst]:.4g} N m at u = {DRIVEN[worst]:.2f}"
            raise InputError(path, load.key, f"{who} takes more than 0 N m to turn, {found}")
