"""Live mixing: the autopilot's wrench demand in, motor commands out, and what happens on silence."""
