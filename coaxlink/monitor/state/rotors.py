"""Rotors and arms: loads by the rotor model, what is at its bound, what ESCs tell, the split and its ideal.

Thrusts are the rotor model's (Berra, Trujillo and Heredia 2024, eq. 1-3) at the reported speeds. The ideal
split is that of the exact allocation for the wrench that the rotors make at this moment: the same thrust and
moments at the least power. Where the table on board is a good one the two agree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.constants import HALF_A_PWM_STEP
from coaxlink.errors import CoaxlinkError
from coaxlink.live.in_air import RotorsInAir
from coaxlink.mavlink.telemetry import Timed
from coaxlink.mixer.law import Law
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.state.speeds import STALE_S, RotorSpeeds, Values, motor_outputs
from coaxlink.vehicle import Vehicle

STANDING = 0.005  # normalised speed below which a rotor stands still
INFO_STALE_S = 5.0  # ESC_INFO comes about once a second
_SPLIT_N = 1.0  # a pair with less thrust idles and its split means nothing


@dataclass(frozen=True)
class RotorView:
    """One rotor; `number` is the airframe's."""

    number: int
    level: str  # upper, lower, single
    speed: float | None  # normalised, 0..1
    rpm: float | None
    throttle: float | None  # commanded, 0..1
    thrust_N: float | None
    torque_Nm: float | None
    full_N: float  # the most thrust it has, alone at full speed
    bound: str = ""  # max, or (in the air) min, when its command is at that end of its range
    current_A: float | None = None
    temperature_C: float | None = None
    health: str = ""  # x: lost thrust in the air, ?: may have


@dataclass(frozen=True)
class ArmView:
    """One arm: a coaxial pair, or a single rotor (then `lower` is None)."""

    name: str  # "front right"
    upper: RotorView
    lower: RotorView | None
    thrust_N: float | None  # of the arm
    upper_share: float | None  # upper thrust over the pair's, 0..1
    ideal_share: float | None = None  # by the exact allocation for the wrench of this moment


@dataclass(frozen=True)
class EscReadings:
    """(N,) by rotor; None where it is not reported."""

    current_A: Values
    temperature_C: Values
    stale: bool = False


def esc_readings(heard: Heard, rotors: int) -> EscReadings:
    """What the ESCs of `rotors` rotors say. A current of 0 is taken for none when no ESC tells any."""
    outputs = motor_outputs(heard.parameters, rotors)
    current, temperature = heard.telemetry.each("esc_current"), heard.telemetry.each("esc_temperature")
    limits = [t.received_s + STALE_S for t in current.values()]
    limits += [t.received_s + INFO_STALE_S for t in temperature.values() if t.kind == "ESC_INFO"]
    known = any(t.value for t in current.values())
    return EscReadings(
        _by_rotor(current if known else {}, outputs),
        _by_rotor(temperature, outputs),
        bool(limits) and heard.now() > min(limits),
    )


def rotors_of(
    vehicle: Vehicle,
    speeds: RotorSpeeds,
    escs: EscReadings,
    health: RotorsInAir,
    *,
    flying: bool = False,
    least: float = 0.0,
) -> tuple[RotorView, ...]:
    """(N,) rotors; `least` is the normalised command at which motors run slowest in flight."""
    airframe = vehicle.airframe
    model = vehicle.model
    u = np.array([np.nan if s is None else s for s in speeds.u])
    # an unknown speed makes NaN of just those loads that depend on it
    thrust, torque = airframe.loads(model, u)
    for group in (*airframe.pairs, *((i,) for i in airframe.singles)):
        if all(u[i] < STANDING for i in group):
            thrust[list(group)], torque[list(group)] = 0.0, 0.0  # a fit's constant is no thrust at rest
    alone = float(model.upper_thrust(1.0, 0.0))
    full = {"upper": alone, "single": alone, "lower": float(model.lower_thrust(0.0, 1.0))}
    return tuple(
        RotorView(
            rotor.number,
            rotor.level,
            speeds.u[i],
            speeds.rpm[i],
            speeds.throttle[i],
            _finite(thrust[i]),
            _finite(torque[i]),
            full[rotor.level],
            _bound(speeds.throttle[i], least, flying),
            escs.current_A[i],
            escs.temperature_C[i],
            health.mark(rotor.number),
        )
        for i, rotor in enumerate(airframe.rotors)
    )


def arms_of(
    airframe: Airframe, rotors: tuple[RotorView, ...], ideal: Mapping[int, float]
) -> tuple[ArmView, ...]:
    """The arms in the order of their upper rotors; `ideal` is the upper share by index of that rotor."""
    arms = []
    for i, rotor in enumerate(airframe.rotors):
        if rotor.level == "lower":
            continue
        lower = rotors[rotor.pair - 1] if rotor.pair is not None else None
        upper_N, lower_N = rotors[i].thrust_N, lower.thrust_N if lower else 0.0
        total = None if upper_N is None or lower_N is None else upper_N + lower_N
        split = share_of(upper_N, lower_N) if lower else None
        best = ideal.get(i) if split is not None else None
        arms.append(ArmView(arm_name(*rotor.position_m[:2]), rotors[i], lower, total, split, best))
    return tuple(arms)


def ideal_shares(law: Law | None, vehicle: Vehicle, wrench: tuple[float, ...] | None) -> dict[int, float]:
    """Upper share of thrust (0..1) of each pair under `law` for this wrench, by index of the upper rotor."""
    airframe = vehicle.airframe
    if law is None or wrench is None or wrench[0] < _SPLIT_N or not all(map(math.isfinite, wrench)):
        return {}
    try:
        thrust, _ = airframe.loads(vehicle.model, law.speeds(wrench))
    except CoaxlinkError:
        return {}
    shares = {a: share_of(float(thrust[a]), float(thrust[b])) for a, b in airframe.pairs}
    return {a: share for a, share in shares.items() if share is not None}


def share_of(upper: float | None, lower: float | None) -> float | None:
    """Upper thrust over that of both; None below 1 N."""
    if upper is None or lower is None or upper + lower < _SPLIT_N:
        return None
    return upper / (upper + lower)


def arm_name(x_m: float, y_m: float) -> str:
    """Where an arm points, in words, from its rotor's place in FRD."""
    reach = math.hypot(x_m, y_m)
    if reach < 1e-3:
        return "centre"
    # within about 20 degrees of an axis an arm is simply front or right
    along = "front" if x_m > 0.35 * reach else "rear" if x_m < -0.35 * reach else ""
    across = "right" if y_m > 0.35 * reach else "left" if y_m < -0.35 * reach else ""
    return " ".join(filter(None, (along, across)))


def _by_rotor(by_output: Mapping[int, Timed], outputs: tuple[int | None, ...]) -> Values:
    found = (None if output is None else by_output.get(output) for output in outputs)
    return tuple(None if timed is None else timed.value for timed in found)


def _bound(throttle: float | None, least: float, flying: bool) -> str:
    if throttle is None:
        return ""
    if throttle >= 1.0 - HALF_A_PWM_STEP:
        return "max"
    return "min" if flying and throttle <= least + HALF_A_PWM_STEP else ""


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
