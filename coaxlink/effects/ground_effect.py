"""Ground effect: near the ground the rotors' inflow falls and the thrust at given speed grows.

Source: Cheeseman and Bennett 1955, T / T_inf = 1 / (1 - (R / 4 h)^2), for which (R / 4 h)^2 is the first
term; for multirotors the effective radius is larger than one rotor's (Sanchez-Cuevas, Heredia and Ollero
2017), and an exponential in height fits flights as well (He, Lee and Leang 2019). Both are tried, the
power of height being free between limits; each rotor feels the height of its own disc, which rights a tilted
vehicle. Close to the ground the gain g grows faster than its first term (Cheeseman's 1 / (1 - g)) or levels
off (Hayden 1976, whose power falls short): g / (1 + b g), b free, is either. Both laws end where the disc is
nearer than half a radius: below a height the gain may stop growing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coaxlink.airframe import Airframe
from coaxlink.effects.base import Numbers, Parameter, PhysicalEffect, Stage
from coaxlink.effects.live import MOST_OF_THRUST, LiveView, Part, nothing
from coaxlink.effects.parameter import Linear
from coaxlink.effects.static import LeftOut, StaticVehicle
from coaxlink.effects.tracing import Array, NotShown, Tracing
from coaxlink.frames import FlightFrame

SCALES_M = (0.15, 0.2, 0.27, 0.36, 0.48, 0.6, 0.75, 0.95, 1.2, 1.6)
GROUND_FELT_M = 1.5  # a vehicle that stays above feels none
LOWEST_M = 0.08  # a disc is never nearer to the ground
OTHER_RADIUS_M = 0.316  # a start of the fit: Cheeseman's gain is then a tenth of 0.25 m's
LEAST_BEND = 0.3  # a gain that steepens near the ground ends at about three times its first term
BENDS = ("levelling", "flat_below_m")


def _height(frame: FlightFrame) -> Array:
    assert frame.height is not None
    return np.maximum(frame.height, LOWEST_M)


def _below(airframe: Airframe, roll: ArrayLike, pitch: ArrayLike) -> Array:
    """(..., N) how far every rotor is below the centre of mass of a tilted vehicle, m."""
    r, p = np.asarray(roll, float), np.asarray(pitch, float)
    down = np.stack([-np.sin(p), np.sin(r) * np.cos(p), np.cos(r) * np.cos(p)], axis=-1)
    return np.asarray(down @ np.array([rotor.position_m for rotor in airframe.rotors]).T)


def disc_heights(frame: FlightFrame) -> Array:
    """(rows, N) height of every rotor's disc above the ground, m."""
    roll, pitch = frame.attitude[:, 0], frame.attitude[:, 1]
    return np.maximum(_height(frame)[:, None] - _below(frame.airframe, roll, pitch), LOWEST_M)


def _missing(frame: FlightFrame) -> str | None:
    if frame.height is None:
        return "height_m is not in the log"
    lowest = float(np.min(frame.height[frame.keep]))
    return None if lowest < GROUND_FELT_M else f"never below {lowest:.1f} m"


def _starts(frame: FlightFrame) -> Sequence[Numbers]:
    if why := _missing(frame):
        raise NotShown(why)
    return [
        {"effective_radius_m": 0.3, "height_power": 2.0},
        *({"gain_at_ground": 0.2, "height_scale_m": s} for s in SCALES_M),
    ]


def _unit_gain(p: Numbers, height_m: ArrayLike) -> Array:
    """Share of thrust gained at a disc's height, for a unit coefficient and before it levels off."""
    h = np.maximum(np.asarray(height_m, float), max(p.get("flat_below_m", LOWEST_M), LOWEST_M))
    if "height_scale_m" in p:
        return np.asarray(np.exp(-h / p["height_scale_m"]))
    return np.asarray((0.25 / h) ** p.get("height_power", 2.0))


def thrust_gain(p: Numbers, height_m: ArrayLike) -> Array:
    """Share of thrust that the ground adds to rotors whose discs are this high (m)."""
    by_scale = "height_scale_m" in p
    most = p["gain_at_ground"] if by_scale else _first_term(None, p, p["effective_radius_m"])
    gain = most * _unit_gain(p, height_m)
    return np.asarray(gain / np.maximum(1.0 + p.get("levelling", 0.0) * gain, LEAST_BEND))


def _first_term(_: FlightFrame | None, p: Numbers, radius_m: float) -> float:
    return float(np.sign(radius_m) * abs(radius_m) ** p.get("height_power", 2.0))


def _radius(_: FlightFrame, p: Numbers, first: float) -> float:
    return float(np.sign(first) * abs(first) ** (1.0 / p.get("height_power", 2.0)))


def _changes(frame: FlightFrame, p: Numbers) -> FlightFrame:
    return frame.pulling(frame.thrust * (1.0 + thrust_gain(p, disc_heights(frame))), frame.torque)


def _further(_: FlightFrame, p: Numbers) -> Sequence[Numbers]:
    """The other law; closer to the ground steeper, or less steep, or level."""
    mine = {k: v for k, v in p.items() if k not in BENDS}
    sign = float(np.sign(p.get("gain_at_ground", p.get("effective_radius_m", 0.0))))
    out: list[Numbers] = [{"effective_radius_m": sign * OTHER_RADIUS_M, "height_power": 2.0}]
    if "height_power" in p:
        out = [{"gain_at_ground": sign * 0.2, "height_scale_m": 0.5}]
    if "levelling" not in p:
        out += [{**mine, "levelling": b} for b in (0.3, -0.3)]
    if "flat_below_m" not in p:
        level = p.get("levelling", -0.3)
        out += [{**mine, "levelling": level, "flat_below_m": h} for h in (0.35, 0.2, 0.12)]
    return out


FLIGHT: Tracing[FlightFrame] = Tracing(
    needs=("height_m",),
    channels=("force_z",),
    starts=_starts,
    further=_further,
    changes=_changes,
    cause=lambda frame, *_: ("height_m", _height(frame)),
)


def _static(vehicle: StaticVehicle, p: Numbers) -> str:
    height = vehicle.at.height_m
    if height is None:
        raise LeftOut(_NEEDS_HEIGHT)
    gains = thrust_gain(p, height - _below(vehicle.airframe, 0.0, 0.0))
    vehicle.thrust *= 1.0 + gains
    return f"thrust {100 * float(gains.mean()):+.1f} % at {height:.2f} m above ground"


def _live(view: LiveView, p: Numbers) -> Part:
    def part(speeds: Sequence[float]) -> Array:
        height = view.reading("height")
        if height is None:
            return nothing()
        roll, pitch, _ = view.reading("attitude") or (0.0, 0.0, 0.0)
        velocity = view.reading("velocity")
        if velocity is not None:
            height -= view.ahead("height") * velocity[2]
        gains = thrust_gain(p, height - _below(view.airframe, roll, pitch))
        return view.wrench_of(np.clip(gains, -MOST_OF_THRUST, MOST_OF_THRUST) * view.loads(speeds)[0])

    return part


_NEEDS_HEIGHT = (
    "thrust follows the height: a static mixer needs it stated (`height_m`), live mixing measures it"
)
EFFECT = PhysicalEffect(
    name="ground_effect",
    stage=Stage.AIR,
    place=1,
    physics="thrust at given speed grows near the ground",
    source="Cheeseman and Bennett 1955; Sanchez-Cuevas, Heredia and Ollero 2017; He, Lee and Leang 2019",
    parameters=(
        Parameter("gain_at_ground", "1", 0.0, 3.0, (0.2, 0.2), amount=True, nil=0.0,
            source="Cheeseman and Bennett 1955: 33 % half a radius above the ground, less for what levels "
                   "off"),
        Parameter("height_scale_m", "m", 0.075, 3.2, (0.5, 0.5), moves=True,
            source="assumed: about a rotor's diameter, 0.25 to 1 m on multirotors of 2 to 25 kg"),
        Parameter("effective_radius_m", "m", 0.0, 2.0, (0.4, 0.3), nil=0.0,
            amount=Linear(_first_term, _radius),
            source="larger than one rotor's (Sanchez-Cuevas, Heredia and Ollero 2017); up to three radii "
                   "is assumed"),
        Parameter("height_power", "1", 0.7, 5.0, (2.0, 0.7), moves=True,
            source="Cheeseman and Bennett 1955: 2; 0.7 for fits that fall off otherwise"),
        Parameter("levelling", "1", -2.5, 6.0, moves=True,
            source="wide: any value between the bounds; Cheeseman steepens (-1), Hayden levels off, and "
                   "vehicles differ"),
        Parameter("flat_below_m", "m", LOWEST_M, 1.0, moves=True,
            source="wide: any value between the bounds; both laws end where the disc is nearer than half "
                   "a radius"),
    ),
    flight=FLIGHT,
    static=_static,
    live=_live,
    messages={"DISTANCE_SENSOR": 50.0, "ATTITUDE": 50.0, "LOCAL_POSITION_NED": 50.0},
)  # fmt: skip
