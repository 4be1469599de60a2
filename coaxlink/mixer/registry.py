"""The laws by name."""

from __future__ import annotations

from typing import Any

from coaxlink.airframe import Airframe
from coaxlink.errors import InputError
from coaxlink.mixer import linear
from coaxlink.mixer.law import Law
from coaxlink.rotor import RotorModel

LAWS = ("standard", "standard-printed", "reduced")


def make_law(name: str, airframe: Airframe, model: RotorModel, **options: Any) -> Law:
    """The law `name` for this airframe and rotor model; `options` are the law's own.

    Raises InputError on an unknown name and on an airframe that the law cannot serve.
    """
    if name == "standard":
        return linear.standard(airframe, model, **options)
    if name == "standard-printed":
        return linear.standard_printed(airframe, model, **options)
    if name == "reduced":
        return linear.reduced(airframe, model, **options)
    raise InputError("--law", name, f"no such law; expected one of {', '.join(LAWS)}")
