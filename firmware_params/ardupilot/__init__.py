"""ArduPilot (ArduCopter): what its tables can say, and the mix it will make of them."""

from firmware_params.ardupilot.realise import ApMix, Demand, Output, realise
from firmware_params.ardupilot.table import ApTable, MotorParameters, used_factors

__all__ = ["ApMix", "ApTable", "Demand", "MotorParameters", "Output", "realise", "used_factors"]
