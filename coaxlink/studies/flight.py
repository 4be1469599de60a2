"""One flight of the demo and the loop: connect, fly the plan, record the tlog and the track."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from coaxlink.fly.commands import Commander, PlanAbandoned, Track
from coaxlink.fly.trajectory import FlightPlan
from coaxlink.mavlink import Session, connect
from coaxlink.mavlink.parameters import Parameters

# message id: rate in Hz of the vehicle's own time; what a flight log of the contract needs
STREAMS = {
    105: 125.0,  # HIGHRES_IMU
    375: 125.0,  # ACTUATOR_OUTPUT_STATUS
    31: 50.0,  # ATTITUDE_QUATERNION
    30: 50.0,  # ATTITUDE
    32: 50.0,  # LOCAL_POSITION_NED
    132: 50.0,  # DISTANCE_SENSOR
    147: 10.0,  # BATTERY_STATUS
    291: 50.0,  # ESC_STATUS
}
AP_STREAMS = {  # the same of an ArduPilot, which has neither HIGHRES_IMU nor ACTUATOR_OUTPUT_STATUS
    27: 50.0,  # RAW_IMU
    36: 50.0,  # SERVO_OUTPUT_RAW
    30: 50.0,  # ATTITUDE
    32: 50.0,  # LOCAL_POSITION_NED
    132: 10.0,  # DISTANCE_SENSOR
    147: 10.0,  # BATTERY_STATUS
    11030: 10.0,  # ESC_TELEMETRY_1_TO_4, and the others with it
}
FLOAT = 9  # MAV_PARAM_TYPE_REAL32
Watch = Callable[[str, float], None]  # segment, seconds into it
Tell = Callable[[str], None]  # a line for the user


def silent(*_: object) -> None:
    """Nobody watches, nobody is told."""


@dataclass
class PowerMeter:
    """What the vehicle says that its battery gives from the first set-point of a plan on.

    What it spends while it hovers and waits to be let into the mode (seconds of ours are minutes of a
    fast simulator's) is no part of the plan.
    """

    watts: list[float] = field(default_factory=list)
    begun: bool = False

    def hear(self, message: Any) -> None:
        """Session subscriber; a current that is not measured (-1) is none."""
        if self.begun and message.get_type() == "BATTERY_STATUS" and message.current_battery >= 0:
            volts = sum(v for v in message.voltages if 0 < v < 65535) / 1e3
            self.watts.append(volts * message.current_battery / 100.0)

    def mean(self) -> float | None:
        """Power over the plan, W; None where the vehicle did not report it."""
        return sum(self.watts) / len(self.watts) if self.watts else None


@dataclass(frozen=True)
class RecordedFlight:
    """A plan that was flown to its end."""

    name: str
    log: Path
    track: Track
    power_W: float | None  # mean over the plan; None where the vehicle did not report it


def fly(
    name: str,
    address: str,
    plan: FlightPlan,
    log: Path,
    *,
    watch: Watch = silent,
    tell: Tell = silent,
    mixing: Callable[[Session], AbstractContextManager[object]] = lambda session: nullcontext(),
    parameters: Mapping[str, float] = MappingProxyType({}),
) -> RecordedFlight:
    """Arm, take off to the plan's start, fly it, land; `mixing` may put the companion in the loop meanwhile.

    `parameters` (floats) are set on the ground.

    A simulator faster than real time outruns a machine that is busy for a moment: the plan is then flown
    again, once. Raises SafetyRefusal, CheckFailed or LinkError of the vehicle that flies.
    """

    def once() -> RecordedFlight:
        meter = PowerMeter()

        def seen(segment: str, t: float) -> None:
            meter.begun = True
            watch(f"{name}: {segment}", t)

        with connect(address, record=log, target_system=1) as session:
            for message_id, rate_hz in STREAMS.items():
                session.request_stream(message_id, rate_hz)
            for parameter, value in parameters.items():
                Parameters(session).write(parameter, value, FLOAT)
            vehicle = Commander(session)
            vehicle.arm()
            vehicle.take_off(-plan.at(0.0)[1].position_m[2])
            try:
                with mixing(session):
                    forget = session.subscribe(meter.hear)
                    track = vehicle.follow(plan, seen)
                    forget()
            except PlanAbandoned:
                vehicle.land()
                raise
            vehicle.land()
        return RecordedFlight(name, log, track, meter.mean())

    try:
        return once()
    except PlanAbandoned as error:
        tell(f"{name}: {error}; flying it again")
    try:
        return once()
    except PlanAbandoned as error:
        raise PlanAbandoned(f"{error}; try a lower --speed") from error
