"""Rotors' health in the air, from the messages of one vehicle: who listens, and what is called.

Rates and acceleration come as HIGHRES_IMU, else as ATTITUDE or ATTITUDE_QUATERNION with the newest of RAW_IMU
and SCALED_IMU; commands from whoever knows them, stamped with the vehicle's clock. Judged is flight only:
armed and in the air by the vehicle's own word (EXTENDED_SYS_STATE); on the ground, where legs push too, all
but calls, and reasons against any, is forgotten. A call is never taken back; after REFINED_S, when its size
is settled, the test goes on with that loss in the model. What hangs on a guess is no call (`weighed`).
Where either side comes too slowly for the test no word is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.constants import GRAVITY_M_S2, MICROSECONDS_WRAP_S
from coaxlink.health.priors import TORQUE_WITH_THRUST
from coaxlink.health.sequential import HOURS, Suspicion, Verdict
from coaxlink.health.stream import STALE_S
from coaxlink.live.weighed import Weighed
from coaxlink.premises.answer import CANNOT_JUDGE, NOT_THIS_VEHICLE, NotJudged, OtherVehicle, Reason
from coaxlink.vehicle import Vehicle

REFINED_S = 1.0  # from a call until its size is taken over: the first blocks hold a part of the loss
RIVAL_S = 1.0  # a better source that was heard within this is the one that counts
ACCEL_S = 0.2  # an acceleration older than this is not the rates'
LEAST_HZ = 3.0 / STALE_S  # of rates and commands: slower, a late message is a gap
PACE_S = 2.0  # over which their rate is a mean
APART_S = 2.0  # commands further than this from the rates have another clock
NEEDS = "needs ATTITUDE or HIGHRES_IMU, the motor commands and EXTENDED_SYS_STATE"


@dataclass(frozen=True)
class Call:
    """A rotor that lost thrust in the air."""

    rotor: int  # number
    time_s: float  # the vehicle's clock
    probability: float
    loss: float  # share of its thrust at the commanded speed
    loss_sd: float
    slower: bool  # its motor turns slower, by how the wake under it changed
    settled: bool = False  # its size is that of REFINED_S, not of the first blocks

    @property
    def text(self) -> str:
        """At most 50 bytes, for STATUSTEXT."""
        if self.settled:
            return f"rotor {self.rotor} lost {100 * self.loss:.0f}% of its thrust: land"
        return f"rotor {self.rotor} loses thrust, p {self.probability:.2f}: land"

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return dict(vars(self))


@dataclass(frozen=True)
class RotorsInAir:
    """What is believed now."""

    word: str  # sound, watch, called, cannot judge, not this vehicle; "" while nothing can be reported
    why: str  # there is no verdict
    suspicions: tuple[Suspicion, ...] = ()
    calls: tuple[Call, ...] = ()
    reasons: tuple[Reason, ...] = ()  # why there is none and will be none

    @property
    def worst(self) -> float | None:
        """Probability that the most suspected rotor lost thrust; None while nothing can be reported."""
        if self.calls:
            return max(c.probability for c in self.calls)
        if not self.word or self.reasons:
            return None
        return self.suspicions[0].probability if self.suspicions else 0.0

    def mark(self, rotor: int) -> str:
        """`x` for a rotor that was called, `?` for one to be watched, else nothing."""
        if any(c.rotor == rotor for c in self.calls):
            return "x"
        watched = self.word == "watch" and self.suspicions and self.suspicions[0].rotor == rotor
        return "?" if watched else ""

    def on(self, reasons: Sequence[Reason]) -> RotorsInAir:
        """What is left of it where there is a reason against any verdict."""
        if not reasons:
            return self
        other = any(isinstance(r, OtherVehicle) for r in reasons)
        word = NOT_THIS_VEHICLE if other else "called" if self.calls else CANNOT_JUDGE
        return replace(self, word=word, why=reasons[0].line(), reasons=tuple(reasons))


NOTHING_HEARD = RotorsInAir("", NEEDS)


class _Pace:
    """How often something comes, by its own stamps."""

    def __init__(self) -> None:
        self._last_s, self._mean_s = -RIVAL_S, 0.0

    def came(self, time_s: float) -> None:
        step, self._last_s = time_s - self._last_s, time_s
        if not 0.0 < step < RIVAL_S:
            self._mean_s = 0.0  # it begins, or begins again
        elif self._mean_s == 0.0:
            self._mean_s = step
        else:
            self._mean_s += (step - self._mean_s) * min(step / PACE_S, 1.0)

    @property
    def slow_hz(self) -> float | None:
        """Its rate where that is too slow; None while nothing is known."""
        return 1.0 / self._mean_s if self._mean_s * LEAST_HZ > 1.05 else None  # stamps jitter


def short(reason: Reason) -> str:
    """A reason in at most 50 bytes, for STATUSTEXT."""
    if isinstance(reason, NotJudged):
        return f"rotors: {CANNOT_JUDGE}, measure {reason.premise}"
    return f"rotors: {NOT_THIS_VEHICLE} ({reason.check})"


class InAir:
    """Fed by one thread: `heard` with every message, `commanded` with the motors' commands."""

    def __init__(self, vehicle: Vehicle, hours: float = HOURS) -> None:
        self._hours = hours
        self.calls: tuple[Call, ...] = ()
        self._armed = self._flying = False
        self._settling: Call | None = None
        self._weighed = Weighed(vehicle, hours)
        self._begin(vehicle)
        self._time_s = 0.0  # of the newest rates
        self._imu_s = -RIVAL_S
        self._kind = ""
        self._paces = {"rates": _Pace(), "motor commands": _Pace()}
        self._accel = (-ACCEL_S, float("nan"))

    @property
    def now(self) -> RotorsInAir:
        """As of the last block."""
        return self._believed.on(self.reasons)

    @property
    def _believed(self) -> RotorsInAir:
        if not self._flying:
            return RotorsInAir("", "judged in the air only", (), self.calls)
        if self._verdict is None:
            return RotorsInAir("", NEEDS, (), self.calls)
        if self.slow:
            return RotorsInAir("", f"cannot judge: {self.slow}", (), self.calls)
        if not self._verdict.ready:
            return RotorsInAir("", "not enough flown", (), self.calls)
        word = "called" if self.calls else self._verdict.word
        return RotorsInAir(word, "", self._verdict.suspicions, self.calls)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why nothing can be reported; of the last flight, until another one says otherwise."""
        return (*self._weighed.differs, *self._weighed.doubts.values())

    @property
    def slow(self) -> str:
        """What comes too slowly to judge by, in words; "" where nothing does."""
        found = {name: hz for name, pace in self._paces.items() if (hz := pace.slow_hz) is not None}
        shown = " and ".join(f"{name} at {hz:.2g} Hz" for name, hz in found.items())
        return f"{shown}, {LEAST_HZ:.0f} Hz and more are needed" if shown else ""

    def heard(self, message: Any) -> Call | None:
        """A message of the autopilot; a call that it brought, and the same again once its size is settled."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._fly(bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED), self._flying)
        elif kind == "EXTENDED_SYS_STATE":
            self._fly(self._armed, message.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR)
        elif kind == "SYS_STATUS" and 0 <= message.battery_remaining <= 100:
            self._weighed.charge = message.battery_remaining / 100
        elif kind in ("RAW_IMU", "SCALED_IMU"):
            self._accel = self._time_s, message.zacc * 1e-3 * GRAVITY_M_S2
        elif kind == "HIGHRES_IMU":
            self._imu_s = message.time_usec * 1e-6
            return self._read(self._imu_s, (message.xgyro, message.ygyro, message.zgyro), message.zacc)
        elif kind in ("ATTITUDE", "ATTITUDE_QUATERNION"):
            time_s = message.time_boot_ms * 1e-3
            if abs(time_s - self._imu_s) < RIVAL_S or (self._kind and kind != self._kind):
                return None
            self._kind = kind
            at, accel = self._accel
            accel = accel if abs(time_s - at) < ACCEL_S else float("nan")
            return self._read(time_s, (message.rollspeed, message.pitchspeed, message.yawspeed), accel)
        return None

    def commanded(self, time_s: float, commands: Sequence[float | None]) -> None:
        """Normalised commands (N,) at that time of the vehicle's clock (a 32 bit one may have wrapped)."""
        turns = round((self._time_s - time_s) / MICROSECONDS_WRAP_S)
        time_s += turns * MICROSECONDS_WRAP_S
        known = [u for u in commands if u is not None]
        if self._flying and len(known) == len(commands) and abs(time_s - self._time_s) < APART_S:
            self._paces["motor commands"].came(time_s)
            self._weighed.command(time_s, known)

    def _fly(self, armed: bool, flying: bool) -> None:
        if self._armed and self._flying and not (armed and flying):
            self._settling = None  # landed: the next flight, or another clock, settles nothing of this one
            self._begin(self._made_for)
        self._armed, self._flying = armed, flying and armed

    def _begin(self, vehicle: Vehicle) -> None:
        self._made_for = vehicle
        self._weighed = Weighed(vehicle, self._hours, self._weighed)
        self._verdict: Verdict | None = None

    def _read(self, time_s: float, rates: Sequence[float], accel_z: float) -> Call | None:
        self._time_s = time_s
        if not self._flying:
            return None
        self._paces["rates"].came(time_s)
        new = None
        for verdict, agreed in self._weighed.reading(time_s, rates, accel_z):
            self._verdict = verdict
            new = self._judged(verdict, agreed) or new
        return new

    def _judged(self, verdict: Verdict, s: Suspicion | None) -> Call | None:
        settling = self._settling
        if settling is None:
            if s is None:
                return None
            call = Call(s.rotor, verdict.time_s, s.probability, s.loss, s.loss_sd, s.slower)
            self._settling, self.calls = call, (*self.calls, call)
            return call
        for s in verdict.suspicions:
            if s.rotor == settling.rotor and s.probability >= 0.5:
                settling = replace(settling, loss=s.loss, loss_sd=s.loss_sd, slower=s.slower)
        done = verdict.time_s - settling.time_s >= REFINED_S
        settling = replace(settling, settled=done)
        self._settling, self.calls = settling, (*self.calls[:-1], settling)
        if not done:
            return None
        self._settling = None
        self._begin(weakened(self._made_for, settling.rotor, settling.loss))
        return settling


def weakened(vehicle: Vehicle, rotor: int, loss: float) -> Vehicle:
    """The vehicle with that share of one rotor's thrust gone, and of its torque in the usual proportion."""
    gains = max(1.0 - loss, 0.0), max(1.0 - TORQUE_WITH_THRUST * loss, 0.0)
    rotors = tuple(
        replace(r, thrust_gain=r.thrust_gain * gains[0], torque_gain=r.torque_gain * gains[1])
        if r.number == rotor
        else r
        for r in vehicle.declared.rotors
    )
    return replace(vehicle, declared=replace(vehicle.declared, rotors=rotors))
