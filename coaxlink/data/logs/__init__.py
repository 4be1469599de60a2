"""Logs of flights: PX4's ULog, ArduPilot's DataFlash, tlogs of a ground station, onto one time base."""
