"""A stand-in for ArduCopter: its parameters, scripts, files, modes and telemetry on the world's plant."""
