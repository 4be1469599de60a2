"""Fly a PX4 or ArduCopter vehicle through a session: arm, take off, follow set-points, land.

Set-points are flown in PX4's offboard mode and in ArduCopter's guided mode.

Everything is paced by the vehicle's own stamps (`time_boot_ms`), so the same code flies a real aircraft and
a simulator that runs faster than real time. Wall time only bounds how long silence is borne.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, LinkError, SafetyRefusal
from coaxlink.fly.trajectory import Plan, Setpoint
from coaxlink.mavlink.requests import Inbox
from coaxlink.mavlink.session import Session

OFFBOARD, AUTO, LOITER = 6, 4, 3  # PX4 main modes, and a sub mode
GUIDED = 4  # ArduCopter mode
READY_S = 15.0  # how long a vehicle that has just started may take until its own checks let it arm
SILENCE_S = 15.0  # wall time without a position before the link counts as lost; a busy machine may stall
_TYPE_MASK = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE


class PlanAbandoned(CheckFailed):
    """The vehicle left the mode in which it follows set-points, before the plan was flown."""


@dataclass(frozen=True)
class Track:
    """What was commanded and where the vehicle was, one row a set-point (rows, ...)."""

    time_s: tuple[float, ...]  # the vehicle's own clock
    segment: tuple[str, ...]
    wanted_m: tuple[tuple[float, float, float], ...]  # NED
    flown_m: tuple[tuple[float, float, float], ...]  # NED


class Vehicle:
    """Commands of one flight. Raises SafetyRefusal when the autopilot says no, LinkError on silence."""

    def __init__(self, session: Session) -> None:
        self.session = session
        if session.identity.is_ardupilot:  # it streams what it is asked for
            session.request_stream(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 50.0)
            session.request_stream(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5.0)

    def now_s(self) -> float:
        """The vehicle's own clock at its next position message."""
        return float(self._position().time_boot_ms) / 1e3

    def height_m(self) -> float:
        """Height above the place of take-off."""
        return -float(self._position().z)

    def arm(self) -> None:
        """Arm the motors: an ArduCopter in guided mode, where it may be told to take off, a PX4 in hold."""
        if self.session.identity.is_ardupilot:
            self._mode(GUIDED)
        else:  # after a flight it is in offboard mode again, where without set-points it does not arm
            self._mode(AUTO, LOITER)
        self._wait_ready()
        self._command("arming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self._until(lambda: self.session.armed, 5.0, "it said yes to arming but did not arm")

    def take_off(self, height_m: float, timeout_s: float = 30.0) -> None:
        """Climb to `height_m` and wait until there (vehicle's time)."""
        heard = self.session
        ground = heard.latest("GLOBAL_POSITION_INT") or heard.wait("GLOBAL_POSITION_INT", SILENCE_S)
        if ground is None:
            raise LinkError(self.session.address, f"no global position for {SILENCE_S:.0f} s")
        if heard.identity.is_ardupilot:  # above home, and no NaN is taken
            self._command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        else:
            nan, altitude = math.nan, ground.alt / 1e3 + height_m
            self._command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, altitude)
        start = self.now_s()
        while self.height_m() < 0.9 * height_m:
            if self.now_s() - start > timeout_s:
                raise CheckFailed(f"take-off: {height_m} m not reached in {timeout_s} s")

    def follow(self, plan: Plan, watch: Callable[[str, float], None] | None = None) -> Track:
        """Fly `plan`; `watch(segment, seconds)` hears of every set-point sent.

        The stream starts before PX4's mode changes, as it asks. Raises LinkError when positions stop, and
        PlanAbandoned when the vehicle leaves the mode.
        """
        rows: list[tuple[float, str, tuple[float, float, float], tuple[float, float, float]]] = []
        start: float | None = None
        following = False
        # one queue for all of it: no position passes between two looks, each gets its set-point
        with self.session.listen(("LOCAL_POSITION_NED",)) as inbox:
            if not self.session.identity.is_ardupilot:
                for _ in range(15):
                    self._send(self._newest(inbox).time_boot_ms, plan.at(0.0)[1])
                self._mode(OFFBOARD)
            while True:
                position = self._newest(inbox)
                now = position.time_boot_ms / 1e3
                start = now if start is None else start
                t = now - start
                was, following = following, self._follows()
                if was and not following:
                    problem = f"the vehicle gave the plan up at {t:.0f} of {plan.duration_s:.0f} s"
                    raise PlanAbandoned(f"{problem}: set-points came too late, or its pilot took over")
                if t > plan.duration_s:
                    return Track(*(tuple(column) for column in zip(*rows, strict=True)))
                segment, setpoint = plan.at(t)
                self._send(position.time_boot_ms, setpoint)
                rows.append((now, segment, setpoint.position_m, (position.x, position.y, position.z)))
                if watch:
                    watch(segment, t)

    def land(self, timeout_s: float = 60.0) -> None:
        """Land and wait until the motors are disarmed (vehicle's time)."""
        self._command("landing", mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, math.nan, math.nan, math.nan, 0.0)
        start = self.now_s()
        while self.session.armed:
            if self.now_s() - start > timeout_s:
                raise CheckFailed(f"landing: still armed after {timeout_s} s")

    def _wait_ready(self) -> None:
        """Until its pre-arm checks pass, where it sends them; its answer to arming says the rest."""
        checks = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        target = self.session.identity
        ask = mavlink.MAVLink_command_long_message(
            target.system,
            target.component,
            mavlink.MAV_CMD_REQUEST_MESSAGE,
            0,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS,
            *[0.0] * 6,
        )
        clock = self.session.clock
        end = clock.monotonic() + READY_S
        while True:
            status, _ = self.session.exchange(ask, "SYS_STATUS")
            if status is None or not status.onboard_control_sensors_present & checks:
                return
            if status.onboard_control_sensors_health & checks or clock.monotonic() > end:
                return
            clock.sleep(0.2)

    def _follows(self) -> bool:
        """Whether its last heartbeat says that it follows set-points."""
        heartbeat = self.session.latest("HEARTBEAT")
        if heartbeat is None:
            return False
        if self.session.identity.is_ardupilot:
            return int(heartbeat.custom_mode) == GUIDED
        return int(heartbeat.custom_mode) >> 16 & 0xFF == OFFBOARD

    def _position(self) -> mavlink.MAVLink_local_position_ned_message:
        message = self.session.wait("LOCAL_POSITION_NED", SILENCE_S)
        if message is None:
            raise LinkError(self.session.address, f"no position for {SILENCE_S:.0f} s")
        return message

    def _newest(self, inbox: Inbox) -> mavlink.MAVLink_local_position_ned_message:
        """The newest position that waits, or the next."""
        message: Any = self.session.take(inbox, SILENCE_S)
        while message is not None and inbox:
            message = self.session.take(inbox, 0.0) or message
        if message is None:
            raise LinkError(self.session.address, f"no position for {SILENCE_S:.0f} s")
        return message

    def _command(self, what: str, command: int, *parameters: float) -> None:
        result = self.session.command(command, *parameters)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            name = mavlink.enums["MAV_RESULT"].get(result)
            raise SafetyRefusal(f"{what}: the autopilot answered {name.name if name else result}")

    def _mode(self, main: int, sub: int = 0) -> None:
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self._command("mode change", mavlink.MAV_CMD_DO_SET_MODE, custom, main, sub)

    def _until(self, met: Callable[[], bool], timeout_s: float, otherwise: str) -> None:
        clock = self.session.clock
        end = clock.monotonic() + timeout_s
        while not met():
            if clock.monotonic() > end:
                raise CheckFailed(otherwise)
            self.session.wait("HEARTBEAT", 1.0)

    def _send(self, time_boot_ms: int, setpoint: Setpoint) -> None:
        identity = self.session.identity
        self.session.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                time_boot_ms,
                identity.system,
                identity.component,
                mavlink.MAV_FRAME_LOCAL_NED,
                _TYPE_MASK,
                *setpoint.position_m,
                *setpoint.velocity_m_s,
                *setpoint.acceleration_m_s2,
                setpoint.yaw_rad,
                0.0,
            )
        )
