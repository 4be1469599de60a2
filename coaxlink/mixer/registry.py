"""The laws by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.errors import InputError
from coaxlink.mixer import coaxial, linear
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.mixer.law import Law
from coaxlink.vehicle import Vehicle, vehicle_of

_MAKERS: dict[str, Callable[..., Law]] = {
    "standard": linear.standard,
    "reduced": linear.reduced,
    "coaxial": coaxial.coaxial,
    "exact": ExactLaw,
    "fitted": FittedLaw,
}
LAWS = tuple(_MAKERS)


def make_law(name: str, vehicle: Vehicle | str | Path, **options: Any) -> Law:
    """The law `name` for this vehicle or airframe file; `options` are the law's own.

    Raises InputError on an unknown name, on what is no Vehicle, on one whose rotors at full throttle do not
    carry it, and on an airframe that the law cannot serve.

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> law = make_law("exact", load_vehicle(example("x8_paper.toml")))
    >>> law.speeds([196.1, 0.0, 0.0, 0.0]).round(3).tolist()  # N, N m; normalised speeds of rotors 1 to 8
    [0.441, 0.441, 0.441, 0.441, 0.648, 0.648, 0.648, 0.648]
    """
    if name not in _MAKERS:
        raise InputError("`law`", name, f"no such law; expected one of {', '.join(LAWS)}")
    flown = vehicle_of(vehicle)
    _refuse_no_flight(flown)
    return _MAKERS[name](flown, **options)


def _refuse_no_flight(vehicle: Vehicle) -> None:
    """Raises InputError on a vehicle that its rotors do not lift."""
    airframe = vehicle.airframe
    weight = airframe.mass_kg * GRAVITY_M_S2
    most = float(airframe.wrench(*airframe.loads(vehicle.model, vehicle.full))[0])
    if most < weight:
        problem = f"cannot fly: its rotors give {most:.1f} N at full throttle, {weight:.1f} N hang on them"
        raise InputError(airframe.name, "mass_kg", f"{problem}; check mass, motors and `speed_max_rpm`")
