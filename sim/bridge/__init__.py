"""The world behind real autopilots' own simulator interfaces: PX4's HIL, ArduPilot's JSON."""
