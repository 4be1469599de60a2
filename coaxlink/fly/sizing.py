"""A first small swing, and a plan sized by what became of it.

A vehicle may swing further than it is asked to: its position loops shape a way of their own, and near their
resonance the way grows. How far is measured on a small swing before the plan, whose swings are then made
smaller by as much, so that they go where they were meant to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coaxlink.fly.commands import Track
from coaxlink.fly.trajectory import FlightPlan, Hold, Swing

SMALL = 0.25  # of the plan's widest swing
CYCLES = 2  # the last is measured: a resonance has built up by then
SETTLE_S = 2.0  # before and after
MOST_SWING = 4.0  # judgement: a vehicle that swings further is not held by its loops


def first_swing(plan: FlightPlan) -> FlightPlan | None:
    """The widest level swing of a plan, small and short; None for a plan without one."""
    widest = max((s for s in plan.segments if isinstance(s, Swing)), key=_reach, default=None)
    if widest is None or _reach(widest) == 0.0:
        return None
    north, east, _ = _scaled(widest, SMALL).end_m
    small = replace(
        widest,
        name="first small swing",
        end_m=(north, east, widest.start_m[2]),
        duration_s=CYCLES * widest.duration_s / widest.cycles,
        cycles=CYCLES,
        yaw_end_rad=widest.yaw_start_rad,
    )
    hold = Hold("before the first swing", widest.start_m, SETTLE_S, widest.yaw_start_rad)
    return FlightPlan((hold, small, replace(hold, name="after the first swing")))


def overshoot(small: FlightPlan, track: Track) -> float:
    """How many times as far as asked the last cycle went; 1 for one that went less far.

    By its harmonic at the swing's own period: gusts and drift beside it count for little.
    """
    hold, swing, _ = small.segments
    assert isinstance(swing, Swing)
    time = np.array(track.time_s) - track.time_s[0] - hold.duration_s
    period = swing.duration_s / swing.cycles
    rows = (time >= swing.duration_s - period) & (time <= swing.duration_s)
    along = np.array(_level(swing)) / _reach(swing)
    place = np.array(track.flown_m)[rows, :2] @ along
    t = time[rows]
    if len(t) < 8:  # four unknowns: it tells too little
        return 1.0
    w = 2.0 * math.pi / period
    columns = np.stack([np.ones_like(t), t, np.cos(w * t), np.sin(w * t)], axis=1)
    found = np.linalg.lstsq(columns, place, rcond=None)[0]
    return max(float(np.hypot(found[2], found[3])) / (0.5 * _reach(swing)), 1.0)


def sized(plan: FlightPlan, gain: float) -> FlightPlan:
    """The plan with every level swing that many times smaller."""
    return FlightPlan(
        tuple(
            _scaled(s, 1.0 / gain) if isinstance(s, Swing) and s.cycles and gain > 1.0 else s
            for s in plan.segments
        )
    )


def _level(swing: Swing) -> Sequence[float]:
    return [e - s for s, e in zip(swing.start_m[:2], swing.end_m[:2], strict=True)]


def _reach(swing: Swing) -> float:
    """Metres over ground; 0 for a way there to stay."""
    return math.hypot(*_level(swing)) if swing.cycles else 0.0


def _scaled(swing: Swing, share: float) -> Swing:
    north, east = (s + share * d for s, d in zip(swing.start_m[:2], _level(swing), strict=True))
    return replace(swing, end_m=(north, east, swing.end_m[2]))
