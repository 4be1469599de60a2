"""One flight: checks, arming, take-off, the plan, landing; the pilot's mode change ends it at once.

Paced by the vehicle's own stamps, so that a real vehicle and a simulator at any speed fly the same. Wall time
only bounds how long silence is borne; then the autopilot's own loss-of-link failsafe has the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, CoaxlinkError, LinkError, SafetyRefusal
from coaxlink.fly.bridge import Bridge, command, request
from coaxlink.fly.limits import Limits, State, breach, plan_faults
from coaxlink.fly.trajectory import Plan, Setpoint
from coaxlink.mavlink import Session
from coaxlink.mavlink.requests import Inbox

# message id: rate in Hz; what the limits are held against
STREAMS = {32: 20.0, 30: 20.0, 33: 2.0, 1: 2.0, 147: 2.0, 245: 2.0}
READY_S = 20.0  # wall time in which a vehicle must pass its own pre-arm checks
REPORTED_S = 10.0  # wall time in which it must say what is left in the battery: twenty of its messages
SILENCE_S = 15.0  # wall time without a position
CLIMB_S = 40.0  # vehicle's time to the first height
LAND_S = 120.0  # vehicle's time to the ground
REACHED = 0.9  # of the height
PX4_AUTO, PX4_LOITER, PX4_OFFBOARD, AP_GUIDED, AP_LAND = 4, 3, 6, 4, 9
WANTED = ("LOCAL_POSITION_NED", "HEARTBEAT")
Watch = Callable[[str, float, State], None]


class PilotTookOver(CheckFailed):
    """The vehicle left the mode in which it follows us: nothing is sent any more."""


class OverLimit(SafetyRefusal):
    """A limit was passed in flight; it was commanded to land."""


@dataclass
class Flown:
    """What a flight was, as far as it went."""

    plan_s: float
    flown_s: float = 0.0
    result: str = "not armed"  # flown, pilot, limit, link, interrupted
    why: str = ""
    worst_m: float = 0.0  # off the set-point
    battery: tuple[float | None, float | None] = (None, None)  # before, after
    segments: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "result": self.result,
            "why": self.why,
            "plan_s": self.plan_s,
            "flown_s": self.flown_s,
            "worst_off_plan_m": self.worst_m,
            "battery_before": self.battery[0],
            "battery_after": self.battery[1],
            "segments": self.segments,
        }


class ModeWatch:
    """Whether the vehicle is still in the mode that was requested, heartbeat by heartbeat.

    Once it was seen there a single heartbeat of another mode ends it; before, two in a row: one may have been
    under way when the mode was acknowledged.
    """

    def __init__(self) -> None:
        self._entered, self._missed = False, 0

    def left(self, ours: bool) -> bool:
        """Whether, after a heartbeat of our mode or of another, somebody else has it."""
        self._missed = 0 if ours else self._missed + 1
        self._entered = self._entered or ours
        return self._missed > (0 if self._entered else 1)


class Pilot:
    """Flies one plan on a bridge within limits."""

    def __init__(self, bridge: Bridge, limits: Limits) -> None:
        from mavsdk.plugins.action import Action
        from mavsdk.plugins.offboard import Offboard

        self.session: Session = bridge.session
        self.bridge, self.limits = bridge, limits
        self.action, self.offboard = Action(bridge.system), Offboard(bridge.system)
        self._start: Any = None  # position on the ground
        self._heading = 0.0

    # -- before --------------------------------------------------------------------------------------------

    def check(self, plan: Plan) -> None:
        """Raises SafetyRefusal naming all that speaks against this flight."""
        faults = plan_faults(plan, self.limits)
        if self.session.armed:
            faults.append("the vehicle is armed: it is flown from the ground up, by nobody else")
        state = self._extended()
        if state == mavlink.MAV_LANDED_STATE_IN_AIR:
            faults.append("the vehicle is in the air")
        if self.limits.battery > 0:
            left = self._reported()
            if left is None:
                faults.append("it does not say what is left in the battery (`battery` 0 flies without)")
            elif left < self.limits.battery:
                faults.append(f"battery at {100 * left:.0f} %, {100 * self.limits.battery:.0f} is the limit")
        if self.session.latest("LOCAL_POSITION_NED") is None and self._position_or_none() is None:
            faults.append("it sends no local position: no estimate, or no stream of it")
        if not self._ready():
            said = self.session.latest("STATUSTEXT")
            words = f": {said.text}" if said is not None else ""
            faults.append(f"its own pre-arm checks do not pass{words}")
        if faults:
            raise SafetyRefusal("; ".join(faults))

    def battery(self) -> float | None:
        """Share of the charge that is left, None where it is not reported."""
        for name in ("BATTERY_STATUS", "SYS_STATUS"):
            message = self.session.latest(name)
            if message is not None and message.battery_remaining >= 0:
                return float(message.battery_remaining) / 100.0
        return None

    def _reported(self) -> float | None:
        """Share of the charge that is left, once it is reported; a busy link takes its time."""
        clock = self.session.clock
        end = clock.monotonic() + REPORTED_S
        while (left := self.battery()) is None and clock.monotonic() < end:
            self.session.wait("BATTERY_STATUS", 1.0)
        return left

    def _extended(self) -> int:
        message = self.session.latest("EXTENDED_SYS_STATE")
        return int(message.landed_state) if message is not None else mavlink.MAV_LANDED_STATE_UNDEFINED

    def _ready(self) -> bool:
        checks = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        clock = self.session.clock
        end = clock.monotonic() + READY_S
        while True:
            status = self.session.latest("SYS_STATUS") or self.session.wait("SYS_STATUS", 2.0)
            if status is None or not status.onboard_control_sensors_present & checks:
                return True  # it does not say; its answer to arming will
            if status.onboard_control_sensors_health & checks:
                return True
            if clock.monotonic() > end:
                return False
            self.session.wait("SYS_STATUS", 1.0)

    # -- the flight ----------------------------------------------------------------------------------------

    def fly(self, plan: Plan, flown: Flown, watch: Watch | None = None) -> None:
        """Arm, climb to the plan's start, fly it, land; `flown` is filled in as it goes.

        Raises PilotTookOver, OverLimit (after the landing), SafetyRefusal, LinkError.
        """
        start = self._position()
        attitude = self.session.latest("ATTITUDE") or self.session.wait("ATTITUDE", 2.0)
        self._start, self._heading = start, float(attitude.yaw) if attitude is not None else 0.0
        flown.battery = (self.battery(), None)
        with self.session.listen(WANTED) as inbox:
            try:
                self._take_off(-plan.at(0.0)[1].position_m[2], inbox)
                self._follow(plan, inbox, flown, watch)
                self._land(inbox)
                flown.result = "flown"
            except PilotTookOver as error:
                self.bridge.release()
                flown.result, flown.why = "pilot", str(error)
                raise
            except LinkError as error:
                self.bridge.release()
                flown.result, flown.why = "link", str(error)
                raise
            except (OverLimit, KeyboardInterrupt) as error:
                flown.result = "limit" if isinstance(error, OverLimit) else "interrupted"
                flown.why = str(error)
                self._land(inbox)
                raise
            except CoaxlinkError:
                if self.session.armed:
                    self._land(inbox)
                raise
            finally:
                flown.battery = (flown.battery[0], self.battery())

    def _take_off(self, height_m: float, inbox: Inbox) -> None:
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        if self.session.identity.is_ardupilot:
            # armed outside of guided mode it would not take off; a set-point before it is up calls that off
            command("guided mode", self.session, mavlink.MAV_CMD_DO_SET_MODE, custom, AP_GUIDED)
            how = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)  # above home; it takes no NaN
        else:
            # disarmed after a flight it is in offboard mode again, where without set-points it does not arm
            command("hold mode", self.session, mavlink.MAV_CMD_DO_SET_MODE, custom, PX4_AUTO, PX4_LOITER)
            how = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, self._altitude() + height_m)
        command("arming", self.session, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        command("take-off", self.session, mavlink.MAV_CMD_NAV_TAKEOFF, *how)
        inbox.clear()  # what was said before the command was acknowledged
        began: float | None = None
        mode_watch = ModeWatch()
        while True:
            message = self._next(inbox)
            if message.get_type() == "HEARTBEAT":
                if mode_watch.left(self._ours(message, climbing=True)):
                    raise PilotTookOver("the vehicle left take-off: its pilot or its own failsafe has it")
                continue
            now = message.time_boot_ms / 1e3
            began = now if began is None else began
            self._held(message, None)
            if self._height(message) > REACHED * height_m:
                return
            if now - began > CLIMB_S:
                raise OverLimit(f"flight ended: {height_m:g} m not reached in {CLIMB_S:.0f} s, landed")

    def _follow(self, plan: Plan, inbox: Inbox, flown: Flown, watch: Watch | None) -> None:
        self._aim(plan.at(0.0)[1])
        request("offboard mode", self.session, self.offboard.start)
        inbox.clear()  # what was said before the command was acknowledged
        began: float | None = None
        mode_watch = ModeWatch()
        while True:
            message = self._next(inbox)
            if message.get_type() == "HEARTBEAT":
                if mode_watch.left(self._ours(message)):
                    problem = f"the vehicle left our mode at {flown.flown_s:.0f} of {plan.duration_s:.0f} s"
                    raise PilotTookOver(
                        f"{problem}: its pilot or its own failsafe has it, nothing is sent any more"
                    )
                continue
            now = message.time_boot_ms / 1e3
            began = now if began is None else began
            t = now - began
            if t > plan.duration_s:
                return
            segment, setpoint = plan.at(t)
            if not inbox:  # of positions that waited only the newest gets its set-point
                self._aim(setpoint)
            state = self._held(message, setpoint)
            flown.flown_s, flown.worst_m = t, max(flown.worst_m, state.off_plan_m)
            if not flown.segments or flown.segments[-1] != segment:
                flown.segments.append(segment)
            if watch:
                watch(segment, t, state)

    def _land(self, inbox: Inbox) -> None:
        request("landing", self.session, self.action.land)
        inbox.clear()  # what was said before the command was acknowledged
        began: float | None = None
        mode_watch = ModeWatch()
        while self.session.armed:
            message = self._next(inbox)
            if message.get_type() == "HEARTBEAT":
                if mode_watch.left(self._ours(message, landing=True)) and self.session.armed:
                    raise PilotTookOver("the vehicle left the landing: its pilot or its own failsafe has it")
                continue
            now = message.time_boot_ms / 1e3
            began = now if began is None else began
            if now - began > LAND_S:
                raise CheckFailed(f"landing: still armed after {LAND_S:.0f} s; the pilot must take it")

    # -- small things --------------------------------------------------------------------------------------

    def _held(self, position: Any, setpoint: Setpoint | None) -> State:
        """The state at a position. Raises OverLimit."""
        here = (position.x - self._start.x, position.y - self._start.y, position.z - self._start.z)
        attitude = self.session.latest("ATTITUDE")
        tilt = 0.0
        if attitude is not None:
            tilt = math.degrees(math.acos(max(-1.0, math.cos(attitude.roll) * math.cos(attitude.pitch))))
        off = math.dist(here, setpoint.position_m) if setpoint is not None else 0.0
        state = State(here[0], here[1], -here[2], off, tilt, self.battery())
        if (problem := breach(state, self.limits)) is not None:
            raise OverLimit(f"flight ended and landed: {problem}")
        return state

    def _altitude(self) -> float:
        """Where the ground is above the sea, m, as PX4's take-off counts."""
        name = "GLOBAL_POSITION_INT"
        ground = self.session.latest(name) or self.session.wait(name, SILENCE_S)
        if ground is None:
            raise SafetyRefusal("take-off: it sends no global position, which a take-off to a height needs")
        return float(ground.alt) / 1e3

    def _height(self, position: Any) -> float:
        return float(self._start.z - position.z)

    def _aim(self, setpoint: Setpoint) -> None:
        """A set-point of the plan, from the place and the heading of take-off."""
        from mavsdk.plugins.offboard import AccelerationNed, PositionNedYaw, VelocityNedYaw

        north, east, down = setpoint.position_m
        yaw = math.degrees(setpoint.yaw_rad + self._heading)
        request(
            "set-point",
            self.session,
            lambda: self.offboard.set_position_velocity_acceleration_ned(
                PositionNedYaw(north + self._start.x, east + self._start.y, down + self._start.z, yaw),
                VelocityNedYaw(*setpoint.velocity_m_s, yaw),
                AccelerationNed(*setpoint.acceleration_m_s2),
            ),
        )

    def _ours(self, heartbeat: Any, *, climbing: bool = False, landing: bool = False) -> bool:
        """Whether a heartbeat's mode is one that we asked for."""
        if self.session.identity.is_ardupilot:
            return int(heartbeat.custom_mode) == (AP_LAND if landing else AP_GUIDED)
        main = int(heartbeat.custom_mode) >> 16 & 0xFF
        return main == (PX4_AUTO if climbing or landing else PX4_OFFBOARD)

    def _position_or_none(self) -> Any:
        return self.session.wait("LOCAL_POSITION_NED", SILENCE_S)

    def _position(self) -> Any:
        message = self._position_or_none()
        if message is None:
            raise LinkError(self.session.address, f"no position for {SILENCE_S:.0f} s")
        return message

    def _next(self, inbox: Inbox) -> Any:
        message = self.session.take(inbox, SILENCE_S)
        if message is None:
            lost = "its own failsafe for a lost link has the vehicle now"
            raise LinkError(self.session.address, f"silent for {SILENCE_S:.0f} s: {lost}")
        return message
