"""ArduPilot (ArduCopter): what its tables can say, and the mix it will make of them."""

from firmware_params.ardupilot.param_file import param_text, write_param_file
from firmware_params.ardupilot.parameters import PARAMETERS, as_stored, out_of_range, servo_function
from firmware_params.ardupilot.realise import ApMix, Demand, Output, realise
from firmware_params.ardupilot.table import ApTable, MotorParameters, motor_test_sequence, used_factors

__all__ = [
    "PARAMETERS",
    "ApMix",
    "ApTable",
    "Demand",
    "MotorParameters",
    "Output",
    "as_stored",
    "motor_test_sequence",
    "out_of_range",
    "param_text",
    "realise",
    "servo_function",
    "used_factors",
    "write_param_file",
]
