"""The world: rotors, airframe, sensors, battery, hidden effects, and stand-in autopilots. Never imports coaxlink."""
