"""Physical constants, once."""

import math

GRAVITY_M_S2 = 9.80665  # standard gravity (ISO 80000-3)
GAS_CONSTANT_J_KG_K = 287.05  # of dry air (ICAO standard atmosphere)
ZERO_CELSIUS_K = 273.15
STANDARD_DENSITY_KG_M3 = 1.225  # ICAO standard atmosphere at sea level
RAD_S_PER_RPM = math.pi / 30.0
SIGMA_PER_MAD = 1.4826  # of a normal distribution: 1 / 0.67449, its quartile
ONE_IN_A_THOUSAND = 1e-3  # of chance, a statistical level: a test that is asked a few times of a log
NORMAL_95 = 1.96  # of a normal distribution: standard deviations of half its 95 %
NORMAL_999 = 3.29  # of its 99.9 %
STANDARD_PRESSURE_PA, STANDARD_TEMPERATURE_K = 101325.0, 288.15  # ICAO standard atmosphere at sea level
MICROSECONDS_WRAP_S = 2**32 / 1e6  # a clock of 32 bits of microseconds comes round every 71 minutes
HALF_A_PWM_STEP = 5e-4  # of a normalised command: outputs have 1000 steps, so this near a bound is at it
TURNING, FULL = (
    0.1,
    0.98,
)  # of full speed: beyond, an ESC starts, stops or has nothing left, and no model holds
