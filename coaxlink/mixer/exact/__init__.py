"""The exact law: the wrench on any identified rotors, at least power, within bounds."""

from coaxlink.mixer.exact.law import PRIORITY, Certificate, ExactLaw

__all__ = ["PRIORITY", "Certificate", "ExactLaw"]
