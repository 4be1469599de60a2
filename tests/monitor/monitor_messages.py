"""Hand-made MAVLink messages, as an autopilot of system 1 would send them, and a watch that hears them."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.files import example
from coaxlink.mavlink.clock import VirtualClock
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.state.moment import Moment
from coaxlink.monitor.state.watch import Watch
from coaxlink.vehicle import Vehicle, load_vehicle
from firmware_params.px4.messages import MAVLink_esc_status_message

X8 = load_vehicle(example("x8_paper.toml"))
INTEGERS = ("CA_ROTOR_COUNT", "CA_AIRFRAME", "CA_METHOD")
HOVER_PULSES = (1441, 1441, 1441, 1441, 1648, 1648, 1648, 1648)  # the exact split of 196.2 N


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


def escs(first: int, rpm: list[float], current_A: float = 5.0) -> Any:
    return MAVLink_esc_status_message(first, 0, rpm, [15.0] * 4, [current_A] * 4)


def hover(boot_ms: int = 1000, upper_rpm: int = 2381) -> list[Any]:
    """All that a hovering PX4 sends at one moment."""
    here = [heartbeat(), servo(), attitude(boot_ms=boot_ms), position(boot_ms=boot_ms), battery()]
    return [*here, escs(0, [upper_rpm] * 4), escs(4, [3499] * 4)]


def px4_table(
    upper: float, lower: float, fac: float = 1.0, km: float = 0.03, arm: float = 0.1807
) -> dict[str, float]:
    """The parameters of an X8's table as an upload leaves them."""
    places = [(1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    values: dict[str, float] = {"CA_AIRFRAME": 0, "CA_METHOD": 2, "CA_ROTOR_COUNT": 8, "THR_MDL_FAC": fac}
    for n, (x, y) in enumerate(places):
        spin = 1 if n % 2 == 0 else -1  # the paper's odd numbers turn ccw
        row = {"PX": x * arm, "PY": y * arm, "PZ": 0, "AX": 0, "AY": 0, "AZ": -1}
        row |= {"CT": upper if n < 4 else lower, "KM": km * spin}
        values |= {f"CA_ROTOR{n}_{field}": value for field, value in row.items()}
    return values


class Scene:
    """A watch of system 1 on a clock that stands still until it is turned."""

    def __init__(self, vehicle: Vehicle = X8) -> None:
        self.clock, self.send = VirtualClock(), Sender()
        self.heard = Heard(self.clock.monotonic)
        self.heard.follow(1, 1)
        self.watch = Watch(self.heard, vehicle, "udpin:0.0.0.0:14550")

    def hear(self, *messages: Any) -> None:
        for message in messages:
            self.heard.take(self.send(message))

    def look(self, *messages: Any, later_s: float = 0.0) -> Moment:
        """What is seen so long after these messages came; an ArduPilot's table is judged first."""
        self.hear(*messages)
        self.clock.sleep(later_s)
        return self.watch.look()


def look(*messages: Any, later_s: float = 0.0, vehicle: Vehicle = X8, **parameters: float) -> Moment:
    """What a new watch sees of these messages and parameters."""
    scene = Scene(vehicle)
    scene.heard.put_parameters(parameters)
    return scene.look(*messages, later_s=later_s)
