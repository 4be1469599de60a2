"""Mixers: laws that turn a wrench into rotor speeds, all with the same call."""

from coaxlink.mixer.coefficients import (
    ReducedCoefficients,
    StandardCoefficients,
    reduced_coefficients,
    standard_coefficients,
)
from coaxlink.mixer.comparison import compare
from coaxlink.mixer.law import Allocation, Law, allocate
from coaxlink.mixer.registry import LAWS, make_law

__all__ = [
    "LAWS",
    "Allocation",
    "Law",
    "ReducedCoefficients",
    "StandardCoefficients",
    "allocate",
    "compare",
    "make_law",
    "reduced_coefficients",
    "standard_coefficients",
]
