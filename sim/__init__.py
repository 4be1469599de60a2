"""The world: rotors, airframe, sensors, battery, hidden effects, stand-in autopilots. No coaxlink in it."""
