"""Mixers: laws that turn a wrench into rotor speeds, all with the same call."""

from coaxlink.mixer.coefficients import (
    ReducedCoefficients,
    StandardCoefficients,
    reduced_coefficients,
    standard_coefficients,
)
from coaxlink.mixer.law import Allocation, Law, allocate
from coaxlink.mixer.registry import LAWS, make_law
from coaxlink.mixer.seen import Conditions, Seen, see

__all__ = [
    "LAWS",
    "Allocation",
    "Conditions",
    "Law",
    "ReducedCoefficients",
    "Seen",
    "StandardCoefficients",
    "allocate",
    "make_law",
    "reduced_coefficients",
    "see",
    "standard_coefficients",
]
