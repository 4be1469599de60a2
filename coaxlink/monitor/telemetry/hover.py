"""Whether measured rotor speeds can be true, from a steady hover: there the thrust is the weight.

Steady: for HOVER_S of the vehicle's clock it was armed and off the ground, tilted by less than TILT_RAD, and
its vertical speed stayed below SPEED_M_S and changed by less than PULL_M_S2 on average.

What ESCs tell is passed over when the thrust at those speeds is more than SHARE off the weight and more than
SHARE off the thrust at the commands, and the commands are nearer to the weight. The commands need not be
right: with a low pack motors turn slower than asked, and then the ESCs are nearer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.monitor.telemetry.readings import Readings
from coaxlink.monitor.telemetry.sources import Source, commanded_speeds, measured_speeds
from coaxlink.monitor.telemetry.vehicle import on_ground, vehicle_of, vertical_speed
from coaxlink.vehicle import Vehicle

HOVER_S = 2.0  # several periods of a height loop (0.2 to 1 Hz), so that its swings average out
TILT_RAD = math.radians(8.0)  # 1 % of the lift
SPEED_M_S = 0.5  # a rotor's induced speed in hover is ten times that: some per cent of thrust
PULL_M_S2 = 0.3  # 3 % of the weight
# A stand's rotor model is good to 3 %, a hover as above to 5 %, a declared mass to a few per cent. Beyond
# 10 % of thrust, 5 % of speed, none of them explains it.
SHARE = 0.10
LEAST_LOOKS = 3


@dataclass(frozen=True)
class Look:
    """One moment: where it stood, and thrust over weight by either source (None: not known)."""

    clock_s: float
    sinking_m_s: float
    measured: float | None
    commanded: float | None


@dataclass(frozen=True)
class Verdict:
    """What the last steady hover said of the measured speeds; thrusts in N."""

    source: str
    measured_N: float
    commanded_N: float
    weight_N: float

    @property
    def contradicted(self) -> bool:
        """Off the weight and off the command, and the command is nearer to the weight."""
        a, c, w = self.measured_N, self.commanded_N, self.weight_N
        return abs(a / w - 1.0) > SHARE and abs(a / c - 1.0) > SHARE and abs(a - w) > abs(c - w)

    def believes(self, source: str) -> bool:
        """Whether that source's speeds are to be used."""
        return source != self.source or not self.contradicted

    def why_not(self, instead: str) -> str:
        """One line for the screen."""
        return (
            f"{self.source} passed over, {instead} used: in hover it means {self.measured_N:.0f} N, "
            f"the commands {self.commanded_N:.0f} N, the weight is {self.weight_N:.0f} N"
        )


@dataclass(frozen=True)
class Hover:
    """The last looks at a steady hover, oldest first, and what it said; extended by every look."""

    looks: tuple[Look, ...] = ()
    verdict: Verdict | None = None

    def extended(self, readings: Readings, vehicle: Vehicle, now_s: float) -> Hover:
        """With the present; another source of measured speeds, or a clock that jumps, begins anew."""
        rotors = len(vehicle.airframe.rotors)
        commanded = commanded_speeds(readings, rotors, now_s)
        measured, _ = measured_speeds(readings, rotors, vehicle.speed_model.speed_max_rpm, commanded, now_s)
        clock, sinking = _steady(readings, now_s)
        verdict = self.verdict if self.verdict is None or self.verdict.source == measured.name else None
        if clock is None or sinking is None:
            return Hover((), verdict)
        looks = self.looks
        if looks and clock == looks[-1].clock_s:
            return self
        if looks and not 0.0 < clock - looks[-1].clock_s <= HOVER_S:
            looks = ()
        weight = vehicle.airframe.mass_kg * GRAVITY_M_S2
        thrusts = (_thrust(s, vehicle, now_s) for s in (measured, commanded))
        looks = (*looks, Look(clock, sinking, *(None if t is None else t / weight for t in thrusts)))
        span = clock - looks[0].clock_s
        pull = (looks[-1].sinking_m_s - looks[0].sinking_m_s) / max(span, 0.1)
        if span < HOVER_S:
            return Hover(looks, verdict)
        comparable = [
            (a.measured, a.commanded) for a in looks if a.measured is not None and a.commanded is not None
        ]
        if abs(pull) < PULL_M_S2 and len(comparable) >= LEAST_LOOKS:
            a, c = (float(np.median(side)) * weight for side in zip(*comparable, strict=True))
            verdict = Verdict(measured.name, a, c, weight)
        return Hover(tuple(a for a in looks if a.clock_s > clock - HOVER_S), verdict)


def _steady(readings: Readings, now_s: float) -> tuple[float | None, float | None]:
    """The vehicle's clock and its vertical speed (m/s, down) while it hovers, else None."""
    vehicle, sinking = vehicle_of(readings, now_s), vertical_speed(readings, now_s)
    if vehicle is None or sinking is None or vehicle.roll_rad is None or vehicle.pitch_rad is None:
        return None, None
    tilt = math.acos(max(min(math.cos(vehicle.roll_rad) * math.cos(vehicle.pitch_rad), 1.0), -1.0))
    airborne = vehicle.armed and not vehicle.attitude_stale and not on_ground(readings, now_s)
    if not airborne or tilt > TILT_RAD or abs(sinking) > SPEED_M_S:
        return None, None
    return vehicle.clock_s, sinking


def _thrust(source: Source, vehicle: Vehicle, now_s: float) -> float | None:
    if not source.fresh(now_s) or any(u is None for u in source.u):
        return None
    model = vehicle.speed_model if source.basis == "measured" else vehicle.model
    thrust, torque = vehicle.airframe.loads(model, np.array(source.u, float))
    total = float(vehicle.airframe.wrench(thrust, torque)[0])
    return total if math.isfinite(total) and total > 0.0 else None
