"""What runs on the autopilot: the module for PX4 with the exact law, the script for ArduPilot."""
