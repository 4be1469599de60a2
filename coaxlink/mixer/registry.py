"""The laws by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

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

    Raises InputError on an unknown name, on what is no Vehicle, and on an airframe that the law cannot serve.

    >>> from coaxlink.files import example
    >>> from coaxlink.vehicle import load_vehicle
    >>> law = make_law("exact", load_vehicle(example("x8_paper.toml")))
    >>> law.speeds([196.1, 0.0, 0.0, 0.0]).round(3).tolist()  # N, N m; normalised speeds of rotors 1 to 8
    [0.441, 0.441, 0.441, 0.441, 0.648, 0.648, 0.648, 0.648]
    """
    if name not in _MAKERS:
        raise InputError("`law`", name, f"no such law; expected one of {', '.join(LAWS)}")
    return _MAKERS[name](vehicle_of(vehicle), **options)
