"""Hand-made MAVLink messages for the monitor's tests, as an autopilot of system 1 would send them."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

HOVER_PULSES = (1441, 1441, 1441, 1441, 1648, 1648, 1648, 1648)  # the exact split of 196.2 N


class EscStatus:
    """ESC_STATUS (291), which the bundled dialect may lack: the fields the monitor reads."""

    def __init__(self, index: int, rpm: list[int], time_usec: int = 0) -> None:
        self.index, self.rpm, self.time_usec = index, rpm, time_usec
        self.voltage, self.current = [15.0] * 4, [5.0] * 4

    def get_type(self) -> str:
        return "ESC_STATUS"


class Sender:
    """Stamps messages with a system, a component and running sequence numbers."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.system, self.component, self.sequence = system, component, 0

    def __call__(self, message: Any, skip: int = 0) -> Any:
        sequence = (self.sequence + skip) % 256
        self.sequence = sequence + 1
        message.get_srcSystem = lambda: self.system
        message.get_srcComponent = lambda: self.component
        message.get_seq = lambda: sequence
        return message


def heartbeat(armed: bool = True, custom_mode: int = 3 << 16, autopilot: int = 12) -> Any:
    return mavlink.MAVLink_heartbeat_message(14, autopilot, 128 if armed else 0, custom_mode, 4, 3)


def servo(pulses: tuple[int, ...] = HOVER_PULSES, port: int = 0) -> Any:
    padded = [*pulses, *[0] * (16 - len(pulses))]
    return mavlink.MAVLink_servo_output_raw_message(1000, port, *padded)


def attitude(roll: float = 0.02, pitch: float = -0.01, yaw: float = 1.5708, boot_ms: int = 1000) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms, roll, pitch, yaw, 0.0, 0.0, 0.0)


def position(down: float = -3.02, boot_ms: int = 1000, sinking: float = 0.0) -> Any:
    return mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, down, 0.0, 0.0, sinking)


def battery(millivolts: int = 24800, remaining: int = 83) -> Any:
    cells = [millivolts, *[65535] * 9]
    return mavlink.MAVLink_battery_status_message(0, 0, 1, 32767, cells, 3150, -1, -1, remaining)


def parameter(name: str, value: float, kind: int = 9) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), value, kind, 900, 1)
