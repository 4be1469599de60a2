"""Short flights that weigh one mixer table against another: drops, yaw steps, gusts, a weak rotor.

What a seed draws (times, directions, which rotor, the gusts and the sensors' noise) is the same for every
table, so that outcomes are paired. `trial_flight.py` flies and judges them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sim.effects import Effect
from sim.flights import circle, vigorous
from sim.px4.cascade import Goal

HEIGHT_M = 6.0
HERE, STILL = (0.0, 0.0, -HEIGHT_M), (0.0, 0.0, 0.0)
BACK_S = 5.0  # after a step, or a rotor's weakness
LEFT = 0.75  # of a weak motor's thrust


@dataclass(frozen=True)
class Draw:
    """What a seed decides."""

    at_s: float  # when it happens, after settling
    direction_deg: float
    rotor: int
    sign: float

    @classmethod
    def of(cls, seed: int, rotors: int) -> Draw:
        """The draw of a seed; every rotor in turn, for upper and lower ones differ."""
        random = np.random.default_rng([seed, 0x3047])
        at, direction = float(random.uniform(2.0, 4.0)), float(random.uniform(0.0, 360.0))
        return cls(at, direction, 1 + (5 * seed) % rotors, float(random.choice([-1.0, 1.0])))


@dataclass(frozen=True)
class Trial:
    """One flight: the goal over time (s after settling), what is true meanwhile, how the loops are set."""

    what: str
    goal: Callable[[float, Draw], Goal]
    effects: Callable[[Draw, float], tuple[Effect, ...]]  # of a draw and the time that settling ends
    seconds: float = 12.0
    integrals: float = 1.0  # times PX4's own and the tuned ones
    hover_estimate: bool = True  # MPC_USE_HTE
    lift_tuned: bool = True  # vertical gains by the table's slope in hover; else PX4's own for every table
    charge: float = 0.95  # of the pack, to begin with


def _after(t: float, d: Draw) -> float:
    """1 from the draw's time on, 0 again some seconds later."""
    return float(d.at_s < t <= d.at_s + BACK_S)


def _hover(t: float, d: Draw) -> Goal:
    return Goal(HERE, STILL)


def _circle(t: float, d: Draw) -> Goal:
    return Goal((2.0, 0.0, -HEIGHT_M), STILL) if t < 0.0 else circle(t, 2.0, -HEIGHT_M, 8.0)


def _vigorous(t: float, d: Draw) -> Goal:
    return vigorous(max(t, 0.0) + d.at_s)


def _yaw_steps(t: float, d: Draw) -> Goal:
    return Goal(HERE, STILL, yaw=0.5 * math.pi * d.sign * _after(t, d))


def _height_steps(t: float, d: Draw) -> Goal:
    return Goal((0.0, 0.0, -HEIGHT_M - 2.0 * _after(t, d)), STILL)


def _climb_and_yaw(t: float, d: Draw) -> Goal:
    turned = 0.5 * math.pi * d.sign * (t > d.at_s)
    return Goal((0.0, 0.0, -HEIGHT_M - 3.0 * _after(t, d)), STILL, yaw=turned)


def _nothing(d: Draw, settled_s: float) -> tuple[Effect, ...]:
    return ()


def _carried(kg: float) -> Callable[[Draw, float], tuple[Effect, ...]]:
    return lambda d, settled_s: (Effect("mass_change", kg),)


def _dropped(d: Draw, settled_s: float) -> tuple[Effect, ...]:
    return (Effect("mass_change", 5.0), Effect("mass_change", -5.0, settled_s + d.at_s))


def _gusts(d: Draw, settled_s: float) -> tuple[Effect, ...]:
    extra = {"direction_deg": d.direction_deg, "gust_m_s": 3.0}
    return (Effect("wind", 8.0, 0.0, extra, "dryden"),)


def _weak(d: Draw, settled_s: float) -> tuple[Effect, ...]:
    """Speeds of one motor by the square root of what is left, and back."""
    onset, extra = settled_s + d.at_s, {"rotor": float(d.rotor)}
    return (
        Effect("degraded_rotor", 1.0 - LEFT, onset, extra, "weak_motor"),
        Effect("degraded_rotor", 1.0 - 1.0 / LEFT, onset + BACK_S, extra, "weak_motor"),
    )


def _unregulated(d: Draw, settled_s: float) -> tuple[Effect, ...]:
    return (Effect("battery_voltage", 1.0, 0.0, {}, "motor"), Effect("mass_change", 5.0))


def _racing(trial: Trial) -> Trial:
    what = "the same, integrals at a tenth, no hover estimate"
    return replace(trial, what=what, integrals=0.1, hover_estimate=False)


def _mapping(trial: Trial) -> Trial:
    return replace(trial, what="the same, integrals half as strong again", integrals=1.5)


_DROP = Trial("5 of 25 kg dropped", _hover, _dropped)
_WEAK = Trial("one motor at 75 % of its thrust for 5 s", _hover, _weak)
_BUSY = Trial("fast circles, climbs and yaw at once", _vigorous, _nothing, 25.0)

TRIALS: dict[str, Trial] = {
    "hover": Trial("calm hover", _hover, _nothing),
    "circle": Trial("circle of 2 m in 8 s", _circle, _nothing, 16.0),
    "gusts": Trial("hover in 8 m/s of wind, gusts of 3 m/s", _hover, _gusts, 20.0),
    "busy": _BUSY,
    "busy, 15 kg": replace(_BUSY, what="the same at 15 kg, gains tuned at 20", effects=_carried(-5.0)),
    "busy, 28 kg": replace(_BUSY, what="the same at 28 kg, gains tuned at 20", effects=_carried(8.0)),
    "height steps": Trial("2 m up and down", _height_steps, _nothing),
    "drop": _DROP,
    "drop, racing": _racing(_DROP),
    "drop, mapping": _mapping(_DROP),
    "drop, stock": replace(_DROP, what="the same on PX4's own vertical gains", lift_tuned=False),
    "weak rotor": _WEAK,
    "weak, racing": _racing(_WEAK),
    "yaw steps": Trial("90 degrees of yaw there and back", _yaw_steps, _nothing),
    "yaw, racing": _racing(Trial("", _yaw_steps, _nothing)),
    "yaw, 25 kg": Trial("the same at 25 kg, gains tuned at 20", _yaw_steps, _carried(5.0)),
    "near full": Trial("36 kg: 3 m up with 90 degrees of yaw", _climb_and_yaw, _carried(16.0)),
    "low battery": Trial(
        "25 kg, pack at 20 %, unregulated ESCs: 3 m up with 90 degrees of yaw",
        _climb_and_yaw, _unregulated, charge=0.2,
    ),
}  # fmt: skip
