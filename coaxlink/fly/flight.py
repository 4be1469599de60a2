"""One flight within limits of our own: checks, arming, take-off, the plan, landing.

The pilot's mode change ends it at once; on a lost link the autopilot's own failsafe has the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CoaxlinkError, LinkError, SafetyRefusal
from coaxlink.fly.commands import SILENCE_S, Commander, Crashed, NotReached, PlanAbandoned, Start
from coaxlink.fly.limits import FlightLimits, PositionState, breach, plan_faults
from coaxlink.fly.sizing import MOST_SWING, first_swing, overshoot, sized
from coaxlink.fly.trajectory import FlightPlan, Setpoint
from coaxlink.mavlink import Session

# message id: rate in Hz; what the limits are held against
STREAMS = {32: 20.0, 30: 20.0, 33: 2.0, 1: 2.0, 147: 2.0, 245: 2.0}
READY_S = 20.0  # in which a vehicle must pass its own pre-arm checks
REPORTED_S = 10.0  # in which it must say what is left in the battery: twenty of its messages
CLIMB_S, LAND_S = 40.0, 120.0  # vehicle's time to the first height, and to the ground

Watch = Callable[[str, float, PositionState], None]
During = Callable[[], AbstractContextManager[object]]


class OverLimit(SafetyRefusal):
    """A limit was passed in flight; it was commanded to land."""


@dataclass
class Flown:
    """What a flight was, as far as it went."""

    plan_s: float
    flown_s: float = 0.0
    result: str = "not armed"  # flown, pilot, limit, link, interrupted, crash
    why: str = ""
    worst_m: float = 0.0  # off the set-point
    battery: tuple[float | None, float | None] = (None, None)  # before, after
    segments: list[str] = field(default_factory=list)
    swing: float | None = None  # times as far as asked that the first small swing went; None without one

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
            "first_swing_went": self.swing,
        }


class Pilot:
    """Flies one plan on a session within limits."""

    def __init__(self, session: Session, limits: FlightLimits) -> None:
        self.session, self.limits = session, limits
        self._commander = Commander(session)
        self._telemetry = self._commander.telemetry
        self._start = Start()
        for number, rate in STREAMS.items():
            session.request_stream(number, rate)

    def check(self, plan: FlightPlan) -> None:
        """Raises SafetyRefusal naming all that speaks against this flight."""
        faults, session = plan_faults(plan, self.limits), self.session
        if session.armed:
            faults.append("the vehicle is armed: it is flown from the ground up, by nobody else")
        if self._telemetry.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR:
            faults.append("the vehicle is in the air")
        if self.limits.battery > 0:
            left = self._reported()
            if left is None:
                faults.append("it does not report the battery's charge (`battery` 0 flies without)")
            elif left < self.limits.battery:
                faults.append(f"battery at {100 * left:.0f} %, {100 * self.limits.battery:.0f} is the limit")
        if session.wait("LOCAL_POSITION_NED", SILENCE_S) is None:
            faults.append("it sends no local position: no estimate, or no stream of it")
        if not self._commander.ready(READY_S):
            words = self._commander.reasons()
            faults.append("its own pre-arm checks do not pass" + (f": {words}" if words else ""))
        if faults:
            raise SafetyRefusal("; ".join(faults))

    def battery(self) -> float | None:
        """Share of the charge that is left, None where it is not reported."""
        found = self._telemetry.latest("remaining")
        return found.value if found else None

    def fly(
        self, plan: FlightPlan, flown: Flown, watch: Watch | None = None, during: During = nullcontext
    ) -> None:
        """Arm, climb to the plan's start, fly it, land; `flown` is filled in as it goes.

        `during` is entered for the plan alone and left before anything else is commanded.

        Raises Crashed, PlanAbandoned, OverLimit (after the landing), SafetyRefusal, LinkError.
        """
        session, commander = self.session, self._commander
        here = session.wait("LOCAL_POSITION_NED", SILENCE_S)
        if here is None:
            raise LinkError(session.address, f"no position for {SILENCE_S:.0f} s")
        session.wait("ATTITUDE", 2.0)
        attitude = self._telemetry.latest("attitude")
        self._start = Start((here.x, here.y, here.z), attitude.value[2] if attitude else 0.0)
        flown.battery = (self.battery(), None)

        def held(position: Any, segment: str, t: float, setpoint: Setpoint | None) -> None:
            state = self._state(position, setpoint)
            if setpoint is not None:
                flown.flown_s, flown.worst_m = t, max(flown.worst_m, state.off_plan_m)
                if not flown.segments or flown.segments[-1] != segment:
                    flown.segments.append(segment)
                if watch:
                    watch(segment, t, state)
            if (problem := breach(state, self.limits)) is not None:
                raise OverLimit(f"flight ended and landed: {problem}")

        try:
            commander.arm()
            commander.take_off(-plan.at(0.0)[1].position_m[2], CLIMB_S, held)
            if (small := first_swing(plan)) is not None:
                flown.swing = overshoot(small, commander.follow(small, start=self._start, held=held))
                if flown.swing > MOST_SWING:
                    far = f"the first small swing went {flown.swing:.1f} times as far as asked"
                    raise OverLimit(f"flight ended and landed: {far}: tune its position loops first")
                plan = sized(plan, flown.swing)
            with during():
                commander.follow(plan, start=self._start, held=held)
            commander.land(LAND_S)
            flown.result = "flown"
        except Crashed as error:
            self._crashed(flown, error)
            raise
        except (PlanAbandoned, LinkError) as error:
            flown.result, flown.why = "link" if isinstance(error, LinkError) else "pilot", str(error)
            raise
        except NotReached as error:
            flown.result, flown.why = "limit", str(error)
            self._land(flown)
            raise OverLimit(f"flight ended and landed: {error}") from error
        except (OverLimit, KeyboardInterrupt) as error:
            flown.result = "limit" if isinstance(error, OverLimit) else "interrupted"
            flown.why = str(error)
            self._land(flown)
            raise
        except Exception:  # also a fault of our own: nobody else would land it
            if session.armed:
                commander.land(LAND_S)
            raise
        finally:
            flown.battery = (flown.battery[0], self.battery())

    def _land(self, flown: Flown) -> None:
        """After a limit or an interrupt. Raises Crashed where that is how it ended."""
        try:
            self._commander.land(LAND_S)
        except Crashed as error:
            flown.result, flown.why = "crash", f"{flown.why}; {error}" if flown.why else str(error)
            raise Crashed(flown.why) from error

    def _crashed(self, flown: Flown, error: Crashed) -> None:
        """What still turns is told to land: nobody else would stop it."""
        flown.result, flown.why = "crash", str(error)
        if self.session.armed:
            with suppress(CoaxlinkError):
                self._commander.land(LAND_S)

    def _reported(self) -> float | None:
        """Share of the charge that is left, once it is reported; a busy link takes its time."""
        end = self.session.clock.monotonic() + REPORTED_S
        while (left := self.battery()) is None and self.session.clock.monotonic() < end:
            self.session.wait("BATTERY_STATUS", 1.0)
        return left

    def _state(self, position: Any, setpoint: Setpoint | None) -> PositionState:
        """Relative to the place of take-off."""
        origin = self._start.position_m
        here = (position.x - origin[0], position.y - origin[1], position.z - origin[2])
        off = math.dist(here, setpoint.position_m) if setpoint is not None else 0.0
        return PositionState(here[0], here[1], -here[2], off, self._commander.tilt_deg(), self.battery())
