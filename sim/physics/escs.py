"""What ESCs tell the autopilot: measured speeds, nothing, or what the autopilots' simulations make up.

PX4's simulation says 6000 rpm times the command, 1 A and 15 A times the command (SimulatorMavlink,
`send_esc_telemetry`); ArduPilot's says 0 rpm (SIM_VIB_MOT_MAX is 0), 16.8 V and 0.8 A (AP_ESC_Telem_SITL).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

MEASURED, SITL, NONE = "measured", "sitl", "none"
KINDS = (MEASURED, SITL, NONE)
PX4_SITL_RPM = 6000.0


@dataclass(frozen=True)
class EscReport:
    """All ESCs of one vehicle at one moment, each list a value an ESC."""

    rpm: list[float]
    volts: list[float]
    amps: list[float]


def reported_escs(a: Any) -> EscReport | None:
    """By the autopilot `a` and its way (`a.escs`); None where no ESC has a wire."""
    if a.escs == NONE:
        return None
    r, count = a.reading, a.rotors
    if a.escs == MEASURED:
        rpm = [a.plant.pair.speed_max_rpm * u for u in r.speeds.tolist()]
        amps = a.plant.rotor_watts() / max(r.voltage, 1.0)
        return EscReport(rpm, [r.voltage] * count, amps.tolist())
    if a.id_parameter == "MAV_SYSID":  # an ArduPilot
        return EscReport([0.0] * count, [16.8] * count, [0.8] * count)
    commands = a.command.tolist() if a.armed else [0.0] * count
    amps = [1.0 + 15.0 * abs(u) if a.armed else 0.0 for u in commands]
    return EscReport([PX4_SITL_RPM * u for u in commands], [r.voltage] * count, amps)
