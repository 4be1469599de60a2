"""Whether measured rotor speeds can be true, from a steady hover: there the thrust is the weight.

Steady: for HOVER_S of the vehicle's clock it was armed and off the ground, tilted by less than TILT_RAD, and
its vertical speed stayed below SPEED_M_S and changed by less than PULL_M_S2 on average.

What ESCs tell is passed over when the thrust at those speeds is more than SHARE off the weight and more than
SHARE off the thrust at the commands, and the commands are nearer to the weight. The commands need not be
right: with a low pack motors turn slower than asked, and then the ESCs are nearer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from coaxlink.constants import GRAVITY_M_S2
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.state.speeds import SpeedSource, commanded_speeds, measured_speeds
from coaxlink.monitor.state.vehicle import on_ground
from coaxlink.vehicle import Vehicle

HOVER_S = 2.0  # several periods of a height loop (0.2 to 1 Hz), so that its swings average out
TILT_RAD = math.radians(8.0)  # 1 % of the lift
SPEED_M_S = 0.5  # a rotor's induced speed in hover is ten times that: some per cent of thrust
PULL_M_S2 = 0.3  # 3 % of the weight
# A stand's rotor model is good to 3 %, a hover as above to 5 %, a declared mass to a few per cent. Beyond
# 10 % of thrust, 5 % of speed, none of them explains it.
SHARE = 0.10
LEAST_SAMPLES = 3


@dataclass(frozen=True)
class Sample:
    """One moment: when it was, how it moved, and thrust over weight by either source (None: not known)."""

    clock_s: float
    sinking_m_s: float
    measured: float | None
    commanded: float | None


@dataclass(frozen=True)
class HoverWatch:
    """The last samples of a steady hover, oldest first, and what it said; extended at every look."""

    samples: tuple[Sample, ...] = ()
    distrusted: Mapping[str, str] = field(default_factory=dict)  # source that was contradicted: how

    def extended(self, heard: Heard, vehicle: Vehicle) -> HoverWatch:
        """With the present; a clock that jumps begins anew."""
        steady = _steady(heard)
        if steady is None:
            return HoverWatch((), self.distrusted)
        clock, sinking = steady
        samples = self.samples
        if samples and clock == samples[-1].clock_s:
            return self
        if samples and not 0.0 < clock - samples[-1].clock_s <= HOVER_S:
            samples = ()
        commanded = commanded_speeds(heard, len(vehicle.airframe.rotors))
        measured, _ = measured_speeds(heard, vehicle, commanded)
        weight = vehicle.airframe.mass_kg * GRAVITY_M_S2
        thrusts = (_thrust(s, vehicle, heard.now()) for s in (measured, commanded))
        samples = (*samples, Sample(clock, sinking, *(None if t is None else t / weight for t in thrusts)))
        span = clock - samples[0].clock_s
        if span < HOVER_S:
            return HoverWatch(samples, self.distrusted)
        pull = (samples[-1].sinking_m_s - samples[0].sinking_m_s) / span
        both = [(s.measured, s.commanded) for s in samples if None not in (s.measured, s.commanded)]
        kept = tuple(s for s in samples if s.clock_s > clock - HOVER_S)
        if abs(pull) >= PULL_M_S2 or len(both) < LEAST_SAMPLES:
            return HoverWatch(kept, self.distrusted)
        a, c = np.median(np.array(both, float), axis=0)
        contradicted = abs(a - 1.0) > SHARE and abs(a / c - 1.0) > SHARE and abs(a - 1.0) > abs(c - 1.0)
        why = (
            f"in hover it means {a * weight:.0f} N, the commands {c * weight:.0f} N, "
            f"the weight is {weight:.0f} N"
        )
        return HoverWatch(kept, {measured.name: why} if contradicted else {})


def _steady(heard: Heard) -> tuple[float, float] | None:
    """The vehicle's clock and its vertical speed (m/s, down) while it hovers, else None."""
    telemetry = heard.telemetry
    clock, attitude, sinking = telemetry.clock_s, telemetry.get("attitude"), telemetry.get("sinking")
    if clock is None or attitude is None or sinking is None or not telemetry.armed or on_ground(telemetry):
        return None
    tilt = math.acos(max(min(math.cos(attitude[0]) * math.cos(attitude[1]), 1.0), -1.0))
    return (clock, sinking) if tilt <= TILT_RAD and abs(sinking) <= SPEED_M_S else None


def _thrust(source: SpeedSource, vehicle: Vehicle, now_s: float) -> float | None:
    if not source.fresh(now_s) or any(u is None for u in source.u):
        return None
    model = vehicle.speed_model if source.basis == "measured" else vehicle.model
    thrust, torque = vehicle.airframe.loads(model, np.array(source.u, float))
    total = float(vehicle.airframe.wrench(thrust, torque)[0])
    return total if math.isfinite(total) and total > 0.0 else None
