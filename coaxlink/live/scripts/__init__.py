"""Lua for an ArduPilot: the bridge to a companion that mixes, and the exact law without one."""
