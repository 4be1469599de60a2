"""The laws by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.mixer import coaxial, linear
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.mixer.law import Law
from coaxlink.rotor import RotorModel

LAWS = ("standard", "standard-printed", "reduced", "coaxial", "coaxial-printed", "exact", "fitted")


def make_law(name: str, airframe: Airframe, model: RotorModel, **options: Any) -> Law:
    """The law `name` for this airframe and rotor model; `options` are the law's own.

    Raises InputError on an unknown name and on an airframe that the law cannot serve.
    """
    makers: dict[str, Callable[..., Law]] = {
        "standard": linear.standard,
        "standard-printed": linear.standard_printed,
        "reduced": linear.reduced,
        "coaxial": coaxial.coaxial,
        "coaxial-printed": coaxial.coaxial_printed,
        "exact": ExactLaw,
        "fitted": FittedLaw,
    }
    if name not in makers:
        raise InputError("--law", name, f"no such law; expected one of {', '.join(LAWS)}")
    return makers[name](airframe, model, **options)
