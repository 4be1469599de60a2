"""A stand-in for PX4: parameters, modes, commands, control cascade and telemetry on the world's plant."""
