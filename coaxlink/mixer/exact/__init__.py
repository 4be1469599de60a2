"""The exact law: the wrench on any identified rotors, at least power, within bounds."""

from coaxlink.mixer.exact.law import Certificate, ExactLaw
from coaxlink.mixer.exact.problem import PRIORITY

__all__ = ["PRIORITY", "Certificate", "ExactLaw"]
