"""The world: rotors, airframe, sensors, battery, hidden effects, stand-in autopilots. Never imports coaxlink."""
