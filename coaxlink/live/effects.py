"""The effects of the rotor file ([[effects]]), compensated live from the vehicle's own telemetry.

What each effect does stands in its own module of `coaxlink.effects`: a speed per command divides every
command, a wrench that it adds at the last speeds is taken off the demand before the law. An input that is
missing or older than STALE_S compensates nothing (speed per command: holds its last), so that telemetry
cannot throw the vehicle.

What is taken off now acts when the motors have followed: speed, turning and height are carried forward by the
telemetry's age and the motors' lag, with the acceleration that the wrench of now makes (rigid body, the
airframe's own mass and inertia; no difference of noisy readings).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.effects import LeftOut, effect
from coaxlink.effects.live import Part, SpeedPart
from coaxlink.errors import InputError
from coaxlink.mavlink.clock import SYSTEM
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.mixer.plain import PlainRotors
from coaxlink.rotor.model import EffectEntry
from coaxlink.vehicle import Vehicle, usual_lift

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

SPEED_TAU_S = 0.5  # of the speed per command: a battery does not jump, its reading does
FACTOR = (0.75, 1.15)  # of speed; what asks for more is taken for a broken sensor
MOST_AHEAD_S = 0.15  # a reading is carried forward by no more than this
Wrench = NDArray[np.float64]


class LiveEffects:
    """`factor` and `wrench` for `MixCore`; `left_out` names the effects nothing is done about, and why.

    `air_temperature_C` is the air's, which a barometer does not know.
    """

    def __init__(
        self,
        session: Session | None,
        vehicle: Vehicle,
        telemetry: Telemetry | None = None,
        *,
        air_temperature_C: float | None = None,
    ) -> None:
        airframe, model = vehicle.airframe, vehicle.model
        self.telemetry = telemetry or Telemetry(session.clock.monotonic if session else SYSTEM.monotonic)
        self.left_out: dict[str, str] = {}
        self.names: list[str] = []
        self._rotors = PlainRotors.of(vehicle)
        self.airframe, self.model = airframe, model
        self._lag_s = airframe.motor_lag_s
        self._mass = airframe.mass_kg
        self._inertia = airframe.inertia_kg_m2
        self._total = [0.0] * 4  # delivered at the last speeds, effects and all
        self.air_temperature_C = air_temperature_C
        self._speeds: Sequence[float] = ()
        self._speed_parts: list[SpeedPart] = []
        self._raw = 1.0  # speed per command as it would be now, smoothed
        self._heard_at: float | None = None
        self.factor = 1.0  # speed per command
        self._parts: list[Part] = []
        for named in vehicle.live_effects:
            reason = self._take(named)
            if reason:
                self.left_out[named.name] = reason
            else:
                self.names.append(named.name)
        if session is not None:
            session.subscribe(self.telemetry.hear)
            for message_id, rate_hz in wanted_streams(self.names).items():
                session.request_stream(message_id, rate_hz)

    def _take(self, named: EffectEntry) -> str:
        """Start to compensate an effect; or why nothing is done about it."""
        known = effect(named.name)
        if named.name == "mass_change":
            self._mass = named.parameters.get("mass_kg", self._mass)
        if known is None:
            return "not known here"
        if not known.is_live:
            return known.no_live
        try:
            known.check(named.parameters)
            if known.live_speed is not None:
                self._speed_parts.append(known.live_speed(self, named.parameters))
            if known.live is not None:
                self._parts.append(known.live(self, named.parameters))
        except InputError as error:
            return f"{error.where}: {error.problem}"
        except LeftOut as reason:
            return str(reason)
        return ""

    def wrench(self, speeds: Sequence[float]) -> Wrench:
        """(4,) what the effects add at these normalised speeds (N,), N and N m."""
        self._speeds = speeds
        self._refresh()
        total = np.zeros(4)
        for part in self._parts:
            total += part(speeds)
        self._total = [m + e for m, e in zip(self._rotors.plain_wrench(speeds), total.tolist(), strict=True)]
        return total

    def _refresh(self) -> None:
        found = [part() for part in self._speed_parts]
        known = [factor for factor in found if factor is not None]
        if not known:
            return
        now, raw = self.telemetry.now(), math.prod(known)
        share = 1.0 if self._heard_at is None else 1.0 - math.exp(-(now - self._heard_at) / SPEED_TAU_S)
        self._raw, self._heard_at = self._raw + share * (raw - self._raw), now
        self.factor = min(max(self._raw, FACTOR[0]), FACTOR[1])

    # -- what the effects see (effects.live.LiveView) --------------------------------------------------

    @cached_property
    def usual_lift(self) -> float:
        """Thrust over speed squared of the middle one of the rotors in hover, N."""
        return usual_lift(self.airframe, self.model)

    @property
    def usual_speed(self) -> float:
        """Normalised speed of the middle one of the rotors at the last answer."""
        return float(np.median(self._speeds)) if len(self._speeds) else 0.0

    def reading(self, name: str) -> Any:
        """The newest value of a kind, None when there is none or it is stale."""
        return self.telemetry.get(name)

    def ahead(self, name: str) -> float:
        """From the time of a reading to when the motors have followed what is told them now (s)."""
        return min(self.telemetry.age(name) + self._lag_s, MOST_AHEAD_S)

    def rates(self) -> list[float] | None:
        """(3,) body rates then, rad/s."""
        known = self.telemetry.get("rates")
        if known is None:
            return None
        (p, q, r), (ix, iy, iz), ahead = known, self._inertia, self.ahead("rates")
        _, roll, pitch, yaw = self._total
        return [  # Euler's equations
            p + ahead * (roll - (iz - iy) * q * r) / ix,
            q + ahead * (pitch - (ix - iz) * r * p) / iy,
            r + ahead * (yaw - (iy - ix) * p * q) / iz,
        ]

    def velocity(self) -> list[float] | None:
        """(3,) speed over ground then, in body axes, m/s; air that moves is not known here."""
        velocity, attitude = self.telemetry.get("velocity"), self.telemetry.get("attitude")
        if velocity is None or attitude is None:
            return None
        rows = body_axes(*attitude)
        ahead, pull = self.ahead("velocity"), self._total[0] / self._mass
        if pull > 0.0:  # something has been answered
            weight = (0.0, 0.0, GRAVITY_M_S2)
            velocity = [v + ahead * (g - pull * z) for v, g, z in zip(velocity, weight, rows[2], strict=True)]
        return [sum(a * v for a, v in zip(row, velocity, strict=True)) for row in rows]

    def loads(self, speeds: Sequence[float]) -> tuple[Wrench, Wrench]:
        """(N,) thrust in N and (N,) torque in N m of the rotor model."""
        loads, n = np.array(self._rotors.loads(speeds)), len(speeds)
        return loads[:n], loads[n:]

    def wrench_of(self, thrust: Wrench, torque: Wrench | None = None) -> Wrench:
        """(4,) wrench of rotor loads."""
        n = len(thrust)
        out = self._rotors.per_load[:, :n] @ thrust
        return out if torque is None else out + self._rotors.per_load[:, n:] @ torque


def body_axes(roll: float, pitch: float, yaw: float) -> list[list[float]]:
    """(3, 3) rotation from NED to body (FRD) for the angles yaw, pitch, roll (z, y, x)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]


def wanted_streams(names: Sequence[str]) -> dict[int, float]:
    """Message id -> rate in Hz of what these effects read."""
    rates: dict[int, float] = {}
    for name in names:
        known = effect(name)
        for message, rate_hz in (known.messages if known else {}).items():
            message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{message}")
            rates[message_id] = max(rate_hz, rates.get(message_id, 0.0))
    return rates
