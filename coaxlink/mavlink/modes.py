"""Names for what a HEARTBEAT says: the firmware and its flight mode.

PX4: main mode in bits 16-23 of custom_mode, sub mode in bits 24-31 (px4_custom_mode.h); ArduCopter:
the number of the mode (mode.h).
"""

from __future__ import annotations

FIRMWARE = {3: "ArduPilot", 12: "PX4"}
NO_MODE = 0xFFFFFFFF  # no autopilot's: the mode is not known

_PX4_MAIN = {
    1: "Manual",
    2: "Altitude",
    3: "Position",
    4: "Auto",
    5: "Acro",
    6: "Offboard",
    7: "Stabilized",
    8: "Rattitude",
    10: "Termination",
}
_PX4_AUTO = {
    1: "Ready",
    2: "Takeoff",
    3: "Hold",
    4: "Mission",
    5: "Return",
    6: "Land",
    8: "Follow me",
    9: "Precision land",
    10: "VTOL takeoff",
}
_COPTER = {
    0: "Stabilize",
    1: "Acro",
    2: "AltHold",
    3: "Auto",
    4: "Guided",
    5: "Loiter",
    6: "RTL",
    7: "Circle",
    9: "Land",
    11: "Drift",
    13: "Sport",
    14: "Flip",
    15: "AutoTune",
    16: "PosHold",
    17: "Brake",
    18: "Throw",
    20: "Guided no GPS",
    21: "Smart RTL",
    22: "FlowHold",
    23: "Follow",
    24: "ZigZag",
    25: "SystemID",
    27: "Auto RTL",
}


def firmware_name(autopilot: int) -> str:
    """Name of a MAV_AUTOPILOT."""
    return FIRMWARE.get(autopilot, f"autopilot {autopilot}")


def mode_name(autopilot: int, custom_mode: int) -> str:
    """Flight mode in the firmware's own words; an unknown one by its number, "" where it was not reported."""
    if custom_mode == NO_MODE:
        return ""
    if autopilot == 12:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = _PX4_AUTO.get(sub) if main == 4 else _PX4_MAIN.get(main)
        return name or f"mode {main}.{sub}"
    if autopilot == 3:
        return _COPTER.get(custom_mode, f"mode {custom_mode}")
    return f"mode {custom_mode}"
