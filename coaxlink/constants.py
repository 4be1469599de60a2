"""Physical constants, once."""

GRAVITY_M_S2 = 9.80665  # standard gravity (ISO 80000-3)
GAS_CONSTANT_J_KG_K = 287.05  # of dry air (ICAO standard atmosphere)
ZERO_CELSIUS_K = 273.15
STANDARD_PRESSURE_PA, STANDARD_TEMPERATURE_K = 101325.0, 288.15  # ICAO standard atmosphere at sea level
