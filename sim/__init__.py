"""The world: rotors, airframe, sensors, battery, hidden effects, stand-in autopilots; never imports coaxlink."""
