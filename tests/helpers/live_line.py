"""A vehicle in the test's own hands: bytes by pymavlink to a live mixer, what it answers kept; no link."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.airframe import load_airframe
from coaxlink.files import example
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.mavlink.clock import VirtualClock
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

X8 = load_airframe(example("x8_paper.toml"))
CRM = load_rotor_model(example("rotor_paper.toml"))
HOVER = [0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0]
# answers whatever the pace
QUICK = Timing(settle=1, fade_s=0.0, hold_after_s=30.0, ramp_after_s=60.0, sync_s=0.0)
RIVAL = mavlink.MAVLink_set_actuator_control_target_message(1500, 0, 1, 1, [0.3] * 8)


class Session:
    """What a live mixer needs of one; `say` is the vehicle's side, `sent` what it was sent."""

    loss = 0.0
    source = (245, 191)

    def __init__(
        self,
        version: tuple[int, ...] | None = (1, 13, 3),
        autopilot: int = mavlink.MAV_AUTOPILOT_PX4,
        takes_requests: bool = True,
    ) -> None:
        self.clock = VirtualClock()
        self.identity = SimpleNamespace(
            system=1, component=1, autopilot=autopilot, version=version, is_px4=True,
            is_ardupilot=autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        )  # fmt: skip
        self.bound = SimpleNamespace(strangers=SimpleNamespace(datagrams=0))
        self.takes_requests, self.armed, self.tap = takes_requests, True, None
        self.latest_messages: dict[str, Any] = {"EXTENDED_SYS_STATE": SimpleNamespace(landed_state=2)}
        self.sent: list[Any] = []
        self.texts: list[Any] = []  # what else it was sent, but TIMESYNC
        self.requests: list[tuple[int, float]] = []
        self.listeners: list[Any] = []
        self.booted_s: float | None = None  # zero of the vehicle's clock, by ours; None: no TIMESYNC
        self.signed_with: bytes | None = None  # frames that end so are believed; None: all
        self._packer, self._parser = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None)

    def subscribe(self, callback: Any, *, whole_system: bool = False) -> Any:
        self.listeners.append(callback)
        return lambda: self.listeners.remove(callback)

    def request_stream(self, message_id: int, rate_hz: float) -> bool:
        self.requests.append((message_id, rate_hz))
        return self.takes_requests

    def listen(self, names: Any) -> Any:
        return nullcontext()

    def take(self, heard: Any, timeout_s: float) -> None:
        self.clock.sleep(timeout_s)

    def wait(self, names: Any, timeout_s: float) -> None:
        self.clock.sleep(timeout_s)

    def latest(self, name: str) -> Any:
        return self.latest_messages.get(name)

    def genuine(self, frame: bytes) -> bool:
        return self.signed_with is None or frame.endswith(self.signed_with)

    def send(self, message: Any) -> None:
        if message.get_type() != "TIMESYNC":
            self.texts.append(message)
        elif self.booted_s is not None and message.tc1 == 0:
            vehicle_ns = round((self.clock.now - self.booted_s) * 1e9)
            self.hear(mavlink.MAVLink_timesync_message(vehicle_ns, message.ts1))

    def send_frame(self, pack: Any, seed: bytes) -> None:
        self.sent += self._parser.parse_buffer(pack(len(self.sent) % 256, 245, 191)) or []

    # -- the vehicle's side ----------------------------------------------------------------------------------

    def frame(self, message: Any, system: int = 1, component: int = 1) -> bytes:
        self._packer.srcSystem, self._packer.srcComponent = system, component
        return bytes(message.pack(self._packer))

    def hear(self, message: Any, system: int = 1, component: int = 1) -> list[Any]:
        """Say a message; what was answered."""
        before = len(self.sent)
        if self.tap is not None:
            self.tap.take([self.frame(message, system, component)])
        for listener in list(self.listeners):
            listener(message)
        return self.sent[before:]

    def demand(self, time_usec: int, controls: list[float] = HOVER, group: int = 0, **who: int) -> list[Any]:
        message = mavlink.MAVLink_actuator_control_target_message(time_usec, group, controls)
        return self.hear(message, **who)


def mixer_on(session: Session, law: Any = "coaxial", **options: Any) -> LiveMixer:
    """One that has begun and answers the first demand already."""
    mixer = LiveMixer(session, Vehicle(X8, CRM), law, **{"timing": QUICK, **options})  # type: ignore[arg-type]
    mixer.start()
    return mixer
