"""Fly a PX4 or ArduCopter vehicle through a session: arm, take off, follow set-points, land.

Set-points are flown in PX4's offboard mode and in ArduCopter's guided mode. Everything is paced by the
vehicle's own stamps (`time_boot_ms`), so the same code flies a real aircraft and a simulator that runs faster
than real time. The session's clock only bounds how long silence is borne. A change of mode by somebody else
ends it at once: nothing is sent any more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal
from coaxlink.fly.trajectory import FlightPlan, Setpoint
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.telemetry import Telemetry

PX4_OFFBOARD, PX4_AUTO, PX4_LOITER = 6, 4, 3  # main modes, and a sub mode
AP_GUIDED, AP_LAND = 4, 9  # ArduCopter's modes
READY_S = 15.0  # how long a vehicle that has just started may take until its own checks let it arm
WORDS_S = 0.3  # after a refusal, for its reasons
SILENCE_S = 15.0  # without a position before the link counts as lost; a busy machine may stall
REACHED = 0.9  # of the height of a take-off
FLYING_M = 0.5  # above where it took off: less is no fall, judgement
OVERTURNED_DEG = 90.0  # of tilt in flight: its thrust points at the ground
LYING_DEG = 45.0  # of tilt after a landing: no slope that one lands on
_LEAD = 15  # set-points before PX4 lets its mode change
_ASKED = 5  # times, as a busy machine or radio may hold up set-points for longer than COM_OF_LOSS_T
_CHECKS = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_TYPE_MASK = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
# a position of the vehicle (LOCAL_POSITION_NED), what it is doing, for how many seconds, and its set-point
Held = Callable[[Any, str, float, Setpoint | None], None]


class PlanAbandoned(CheckFailed):
    """The vehicle left the mode that it was commanded to: its pilot or its failsafe has it."""


class Crashed(CheckFailed):
    """Its motors stopped in the air, or it lies where no landing leaves a vehicle."""


class NotReached(CheckFailed):
    """The height of a take-off was not reached in time."""


@dataclass(frozen=True)
class Start:
    """Where a plan's origin is in the vehicle's local frame (NED), and its heading there."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_rad: float = 0.0


@dataclass(frozen=True)
class Track:
    """What was commanded and where the vehicle was, one row a set-point (rows, ...)."""

    time_s: tuple[float, ...]  # the vehicle's own clock
    segment: tuple[str, ...]
    wanted_m: tuple[tuple[float, float, float], ...]  # NED
    flown_m: tuple[tuple[float, float, float], ...]  # NED


class ModeWatch:
    """Whether the vehicle is still in the mode that was requested, heartbeat by heartbeat.

    Once it was seen there a single heartbeat of another mode ends it; before, two in a row: one may have been
    under way when the mode was acknowledged.
    """

    def __init__(self) -> None:
        self.entered, self._missed = False, 0

    def left(self, ours: bool) -> bool:
        """Whether, after a heartbeat of our mode or of another, somebody else has it."""
        self._missed = 0 if ours else self._missed + 1
        self.entered = self.entered or ours
        return self._missed > (0 if self.entered else 1)


class Commander:
    """Commands of one flight. Raises SafetyRefusal when the autopilot says no, LinkError on silence, and
    PlanAbandoned when somebody else takes the vehicle."""

    def __init__(self, session: Session) -> None:
        self.session, self.telemetry = session, Telemetry(session.clock.monotonic)
        session.subscribe(self.telemetry.hear)
        self._ardupilot = session.identity.is_ardupilot
        self._ground_z: float | None = None  # m down, where it took off
        if self._ardupilot:  # it streams what it is asked for
            session.request_stream(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 50.0)
            session.request_stream(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5.0)

    def height_m(self) -> float:
        """Height above the origin of the vehicle's local frame, at its next position."""
        return -float(self._heard("LOCAL_POSITION_NED").z)

    def ready(self, patience_s: float = READY_S) -> bool:
        """Whether its own pre-arm checks pass, in that time; True for one that does not say."""
        target, clock = self.session.identity, self.session.clock
        ask = mavlink.MAVLink_command_long_message(
            target.system,
            target.component,
            mavlink.MAV_CMD_REQUEST_MESSAGE,
            0,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS,
            *[0.0] * 6,
        )
        end = clock.monotonic() + patience_s
        while True:
            status, _ = self.session.exchange(ask, "SYS_STATUS")
            if status is None or not status.onboard_control_sensors_present & _CHECKS:
                return True
            if status.onboard_control_sensors_health & _CHECKS:
                return True
            if clock.monotonic() > end:
                return False
            clock.sleep(0.2)

    def arm(self) -> None:
        """Arm the motors: an ArduCopter in guided mode, where it may be told to take off, a PX4 in hold."""
        if self._ardupilot:
            self._mode(AP_GUIDED)
        else:  # after a flight it is in offboard mode again, where without set-points it does not arm
            self._mode(PX4_AUTO, PX4_LOITER)
        self.ready()
        self._command("arming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        end = self.session.clock.monotonic() + 5.0
        while not self.session.armed:
            if self.session.clock.monotonic() > end:
                raise CheckFailed("it accepted the arming command but did not arm")
            self.session.wait("HEARTBEAT", 1.0)

    def take_off(self, height_m: float, timeout_s: float = 30.0, held: Held | None = None) -> None:
        """Climb by `height_m` and wait until there (vehicle's time). Raises NotReached."""
        ground = self._heard("GLOBAL_POSITION_INT", latest=True)
        start = self._heard("LOCAL_POSITION_NED")
        self._ground_z = start.z
        if self._ardupilot:  # above home, and no NaN is taken
            self._command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        else:
            nan, altitude = math.nan, ground.alt / 1e3 + height_m
            self._command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, altitude)
        for t, position, _ in self._positions("take-off", AP_GUIDED, PX4_AUTO):
            if held:
                held(position, "take-off", t, None)
            if start.z - position.z > REACHED * height_m:
                return
            if t > timeout_s:
                raise NotReached(f"take-off: {height_m:g} m not reached in {timeout_s:g} s")

    def follow(
        self,
        plan: FlightPlan,
        watch: Callable[[str, float], None] | None = None,
        *,
        start: Start = Start(),
        held: Held | None = None,
    ) -> Track:
        """Fly `plan` from `start`; `watch(segment, seconds)` hears of every set-point sent.

        `held` hears of every position and may raise to end it. The stream of set-points starts before PX4's
        mode changes, as it asks.
        """
        rows: list[tuple[float, str, tuple[float, float, float], tuple[float, float, float]]] = []
        if not self._ardupilot:
            self._offboard(plan.at(0.0)[1], start)
        doing = f"the plan of {plan.duration_s:.0f} s"
        for t, position, newest in self._positions(doing, AP_GUIDED, PX4_OFFBOARD):
            if t > plan.duration_s:
                break
            segment, setpoint = plan.at(t)
            if newest:  # of positions that waited only the newest gets its set-point
                self._send(position.time_boot_ms, setpoint, start)
                place = (position.x, position.y, position.z)
                rows.append((position.time_boot_ms / 1e3, segment, setpoint.position_m, place))
                if watch:
                    watch(segment, t)
            if held:
                held(position, segment, t, setpoint)
        return Track(*(tuple(column) for column in zip(*rows, strict=True)))

    def land(self, timeout_s: float = 60.0) -> None:
        """Land and wait until the motors are disarmed (vehicle's time)."""
        self._command("landing", mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, math.nan, math.nan, math.nan, 0.0)
        for t, _, _ in self._positions("the landing", AP_LAND, PX4_AUTO, landing=True):
            if not self.session.armed:
                if (tilt := self.tilt_deg()) > LYING_DEG:
                    raise Crashed(f"crashed: it lies tilted by {tilt:.0f} degrees{self._of_a_crash()}")
                return
            if t > timeout_s:
                raise CheckFailed(f"landing: still armed after {timeout_s:g} s; the pilot must take it")

    def tilt_deg(self) -> float:
        """Of the vehicle, by its last attitude; 0 without one."""
        attitude = self.telemetry.latest("attitude")
        if not attitude:
            return 0.0
        roll, pitch, _ = attitude.value
        return math.degrees(math.acos(max(-1.0, math.cos(roll) * math.cos(pitch))))

    # -- inside --------------------------------------------------------------------------------------------

    def _positions(
        self, doing: str, guided: int, main: int, *, landing: bool = False
    ) -> Iterator[tuple[float, Any, bool]]:
        """Seconds since the first, the position, whether none newer waits.

        For as long as the vehicle is in mode `guided` of ArduCopter or main mode `main` of PX4; one that is
        `landing` may leave it once it is disarmed.
        """
        mode_watch, began, t, height_m = ModeWatch(), 0.0, -1.0, 0.0
        with self.session.listen(("LOCAL_POSITION_NED", "HEARTBEAT", "HIGH_LATENCY2")) as inbox:
            while True:
                message = self.session.take(inbox, SILENCE_S)
                if message is None:
                    lost = "its own failsafe for a lost link has the vehicle now"
                    raise LinkError(self.session.address, f"silent for {SILENCE_S:.0f} s: {lost}")
                if message.get_type() != "LOCAL_POSITION_NED":
                    beat = message.get_type() == "HEARTBEAT"
                    if beat and not landing and height_m > FLYING_M and _stopped(message):
                        words = self._of_a_crash()
                        raise Crashed(f"crashed: its motors stopped {height_m:.1f} m high in {doing}{words}")
                    custom = int(message.custom_mode) << (0 if beat else 16)
                    ours = custom == guided if self._ardupilot else custom >> 16 & 0xFF == main
                    if not beat and (landing or not mode_watch.entered):
                        continue  # whether armed, and first in the mode, beats say; PX4 alone is asked
                    if mode_watch.left(ours) and not (landing and not self.session.armed):
                        raise PlanAbandoned(
                            f"the vehicle left {doing} after {max(t, 0.0):.0f} s: its pilot or its own "
                            "failsafe has it (as when set-points come too late), nothing is sent any more"
                        )
                    continue
                now = message.time_boot_ms / 1e3
                began = now if t < 0 else began
                t = now - began
                height_m = 0.0 if self._ground_z is None else self._ground_z - message.z
                if height_m > FLYING_M and (tilt := self.tilt_deg()) > OVERTURNED_DEG:
                    raise Crashed(f"crashed: tilted by {tilt:.0f} degrees in {doing}{self._of_a_crash()}")
                yield t, message, not inbox

    def _heard(self, name: str, *, latest: bool = False) -> Any:
        """The next message of this type, or the last."""
        message = self.session.latest(name) if latest else None
        message = message or self.session.wait(name, SILENCE_S)
        if message is None:
            raise LinkError(self.session.address, f"no {name} for {SILENCE_S:.0f} s")
        return message

    def reasons(self) -> str:
        """Why its own checks would not let it arm, in its words; PX4 says them when they are asked to run."""
        asked_s = self.session.clock.monotonic()
        with suppress(LinkError):
            self.session.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS, timeout_s=WORDS_S, tries=2)
        return self._texts_since(asked_s)

    def _of_a_crash(self) -> str:
        """What it says of it."""
        words = self._texts_since(self.session.clock.monotonic() - SILENCE_S)
        return f"; it says: {words}" if words else ""

    def _texts_since(self, asked_s: float) -> str:
        self.session.clock.sleep(WORDS_S)  # it may come after the answer, in several pieces
        texts = (text.text for text in self.telemetry.texts if text.received_s >= asked_s)
        return ", ".join(dict.fromkeys(texts))

    def _command(self, what: str, command: int, *parameters: float) -> None:
        asked_s = self.session.clock.monotonic()
        result = self.session.command(command, *parameters)
        if result == mavlink.MAV_RESULT_ACCEPTED:
            return
        arming = command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        reported = [self._texts_since(asked_s), self.reasons() if arming else ""]
        words = f"; it says: {', '.join(filter(None, reported))}" if any(reported) else ""
        known = mavlink.enums["MAV_RESULT"].get(result)
        raise SafetyRefusal(f"{what}: the autopilot refused ({known.name if known else result}){words}")

    def _offboard(self, setpoint: Setpoint, start: Start) -> None:
        """PX4 changes its mode while set-points come; where they came late it is asked again."""
        for left in reversed(range(_ASKED)):
            for _ in range(_LEAD):
                self._send(self._heard("LOCAL_POSITION_NED").time_boot_ms, setpoint, start)
            try:
                self._mode(PX4_OFFBOARD)
                return
            except SafetyRefusal:
                if not left:
                    raise

    def _mode(self, main: int, sub: int = 0) -> None:
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self._command("mode change", mavlink.MAV_CMD_DO_SET_MODE, custom, main, sub)

    def _send(self, time_boot_ms: int, setpoint: Setpoint, start: Start) -> None:
        identity = self.session.identity
        place = [a + b for a, b in zip(setpoint.position_m, start.position_m, strict=True)]
        self.session.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                time_boot_ms,
                identity.system,
                identity.component,
                mavlink.MAV_FRAME_LOCAL_NED,
                _TYPE_MASK,
                *place,
                *setpoint.velocity_m_s,
                *setpoint.acceleration_m_s2,
                setpoint.yaw_rad + start.heading_rad,
                0.0,
            )
        )


def _stopped(heartbeat: Any) -> bool:
    """Whether its motors are off, or its failure detector ended the flight."""
    armed = heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    return not armed or heartbeat.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION
