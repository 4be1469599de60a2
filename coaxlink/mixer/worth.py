"""What a mixer table is worth to who flies it: power, loop gains over load, authority, ceiling, coupling.

A table is a function from demands (thrust 0..1; roll, pitch, yaw -1..1) to motor commands, desaturation and
thrust curve included; what rotors turn and lift at these is the word of the rotor file, not of the table.
Nothing here counts an error that one constant gain an axis takes off: an autopilot's integrators and its
learnt hover thrust do that by themselves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import AXES
from coaxlink.constants import GRAVITY_M_S2, HALF_A_PWM_STEP
from coaxlink.mixer.demands import Commands, envelope
from coaxlink.vehicle import Vehicle, battery_watts, shaft_watts

Array = NDArray[np.float64]

STEP = 0.01  # of demand, for slopes
LIGHT, HEAVY = 0.75, 1.25  # of the vehicle's mass: its payload off, and as much again on
SAG = 0.85  # of full voltage: 4.2 V a cell, and 3.57 V under load before the knee of a lithium cell
HARD = 4.0  # times the moments of the envelope's edge: a third of weight x arm in roll, a twelfth in yaw
LOADS, TOPMOST = (
    12,
    0.98,
)  # masses at which sink is given; the heaviest, as a share of what the ceiling carries
THRUSTS = tuple(np.linspace(0.0, 1.0, 51)[1:].tolist())  # demands among which one holds the most
COARSE = 5  # of these, looked at first
# shaft over electrical watts of motor and ESC where a stand measured no volts and amps: a premise that enters
# minutes and never their ratio
DRIVE_EFFICIENCY = 0.80


@dataclass(frozen=True)
class AxisReach:
    """How far one axis goes in hover before a rotor is at its bound, and how far at a demand of 1."""

    axis: str
    moment_Nm: float  # delivered when the first rotor gets there, the smaller of both ways
    rotors: tuple[int, ...]  # their numbers; empty where none gets there
    full: bool  # at full speed; else at the least the autopilot lets it turn
    most_Nm: float  # delivered at a demand of 1, the smaller of both ways
    thrust_lost_N: float  # by that demand

    def to_json(self) -> dict[str, Any]:
        """As `--json` writes it."""
        at = ("full speed" if self.full else "least speed") if self.rotors else None
        return {
            "axis": self.axis,
            "moment_Nm": self.moment_Nm,
            "rotors": list(self.rotors),
            "at": at,
            "most_Nm": self.most_Nm,
            "thrust_lost_N": self.thrust_lost_N,
        }


@dataclass(frozen=True)
class Worth:
    """One table on one vehicle. Axes are [thrust, roll, pitch, yaw]; NaN where it cannot be flown."""

    name: str
    mass_kg: float
    hover_demand: float  # 0..1
    hover_W: float  # shaft power
    battery_W: float  # in hover; NaN where the stand measured no volts and amps
    gain: Array  # (4,) d(delivered)/d(demand) in hover, N and N m
    lift_exponent: float  # d(log thrust)/d(log demand) in hover; autopilots count on 1
    load_kg: tuple[float, float]  # light, heavy
    load_span: Array  # (4,) largest over smallest gain from light to heavy
    sag_span: Array  # (4,) the same in hover from a full pack to SAG, ESCs unregulated
    ceiling_N: float  # level thrust, the most of any demand
    limits: tuple[AxisReach, AxisReach, AxisReach]  # roll, pitch, yaw
    hard_Nm: Array  # (3,) moments of the hard manoeuvre
    coupling: Array  # (3, 4) delivered less meant when roll, pitch or yaw alone is demanded
    shape_error: Array  # (4,) mean |error| over the envelope, best constant gain an axis taken off
    sink_kg: Array  # (LOADS,) light to what the ceiling carries; empty without a hover
    sink_m_s2: Array  # (LOADS,) downward under roll and yaw of `hard_Nm` at once, the worst of four ways
    held_kg: float  # the most that any thrust demand holds meanwhile: beyond, no height loop helps

    @property
    def thrust_to_weight(self) -> float:
        """Of the ceiling."""
        return self.ceiling_N / (self.mass_kg * GRAVITY_M_S2)

    @property
    def drawn(self) -> tuple[float, str]:
        """Watts in hover and where they are: from the battery where that was measured, else at the shafts."""
        if math.isfinite(self.battery_W):
            return self.battery_W, "from the battery"
        return self.hover_W, "at the shafts"

    def minutes(self, battery_Wh: float, drive_efficiency: float = DRIVE_EFFICIENCY) -> float:
        """In hover on this energy, by measured battery watts or, without them, by an efficiency."""
        drawn = self.battery_W if math.isfinite(self.battery_W) else self.hover_W / drive_efficiency
        return 60.0 * battery_Wh / drawn

    def to_json(self) -> dict[str, Any]:
        """As `compare` writes it; null where it cannot be flown."""
        return {
            "table": self.name,
            "hover_demand": _null(self.hover_demand),
            "hover_W": _null(self.hover_W),
            "battery_W": _null(self.battery_W),
            "gain": _nulls(self.gain),
            "lift_exponent": _null(self.lift_exponent),
            "load_kg": list(self.load_kg),
            "load_span": _nulls(self.load_span),
            "sag_span": _nulls(self.sag_span),
            "ceiling_N": self.ceiling_N,
            "thrust_to_weight": self.thrust_to_weight,
            "limits": [limit.to_json() for limit in self.limits],
            "hard_Nm": self.hard_Nm.tolist(),
            "coupling": [_nulls(row) for row in self.coupling],
            "shape_error": _nulls(self.shape_error),
            "sink": {"load_kg": self.sink_kg.tolist(), "m_s2": _nulls(self.sink_m_s2)},
            "held_kg": _null(self.held_kg),
        }


def weigh(
    vehicle: Vehicle,
    commands: Commands,
    name: str = "",
    *,
    light: float = LIGHT,
    heavy: float = HEAVY,
) -> Worth:
    """What a table is worth on the vehicle; `light` and `heavy` are shares of the vehicle's mass."""
    airframe = vehicle.airframe
    fly = TableOnRotors(vehicle, commands)
    weight = airframe.mass_kg * GRAVITY_M_S2
    top = fly.ceiling()
    hover = solve(fly.lift, weight)
    drained = TableOnRotors(vehicle, commands, SAG)
    hard = HARD * np.abs(envelope(airframe, 2000)[:, 1:]).max(axis=0)
    hold = (light * airframe.mass_kg, heavy * airframe.mass_kg)
    if hover is None:
        nan = np.full(4, math.nan)
        none = tuple(AxisReach(axis, math.nan, (), True, math.nan, math.nan) for axis in AXES[1:])
        return Worth(
            name, airframe.mass_kg, math.nan, math.nan, math.nan, nan, math.nan, hold, nan, nan, top,
            (none[0], none[1], none[2]), hard, np.full((3, 4), math.nan), nan,
            np.empty(0), np.empty(0), math.nan,
        )  # fmt: skip
    gain = fly.slopes(hover)
    limits = tuple(reach(fly, hover, k) for k in (1, 2, 3))
    turn = hard[[0, 2]] / gain[[1, 3]]
    loads = np.linspace(hold[0], max(TOPMOST * top / GRAVITY_M_S2, hold[0]), LOADS)
    return Worth(
        name,
        airframe.mass_kg,
        hover,
        *fly.power(hover),
        gain,
        float(gain[0]) * hover / fly.lift(hover),
        hold,
        _span([fly.slopes(solve(fly.lift, kg * GRAVITY_M_S2)) for kg in np.linspace(*hold, 5)]),
        _span([gain, drained.slopes(solve(drained.lift, weight))]),
        top,
        (limits[0], limits[1], limits[2]),
        hard,
        _coupling(fly, hover, gain, hard),
        _shape_error(fly, hover, gain, envelope(airframe)),
        loads,
        _sink(fly, loads, turn),
        _most_held(fly, turn) / GRAVITY_M_S2,
    )


def front(rows: Sequence[Worth]) -> list[bool]:
    """(rows) whether no other is as good in hover power, ceiling and yaw authority and better in one.

    Differences below a thousandth are none.
    """
    gains = [(-row.drawn[0], row.ceiling_N, row.limits[2].moment_Nm) for row in rows]

    def beats(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
        more = [x - y for x, y in zip(a, b, strict=True)]
        slack = [1e-3 * abs(y) for y in b]
        return all(m >= -s for m, s in zip(more, slack, strict=True)) and any(
            m > s for m, s in zip(more, slack, strict=True)
        )

    return [math.isfinite(g[0]) and not any(beats(other, g) for other in gains) for g in gains]


def solve(thrust_N: Callable[[float], float], weight_N: float) -> float | None:
    """The demand in 0..1 whose thrust is `weight_N`, None when none is; thrust grows with the demand."""
    if thrust_N(1.0) < weight_N:
        return None
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if thrust_N(middle) < weight_N else (low, middle)
    return high


class TableOnRotors:
    """A table on rotors: demands (4,) [thrust, roll, pitch, yaw] to what is delivered."""

    def __init__(self, vehicle: Vehicle, commands: Commands, full_speed: float = 1.0) -> None:
        """`full_speed`: what a command of 1 brings, of the speed it brings on a full pack."""
        self.vehicle, self.airframe, self.model = vehicle, vehicle.airframe, vehicle.model
        self._commands, self._full_speed = commands, full_speed
        self.least = float(np.min(commands(0.0, 0.0, 0.0, 0.0)))  # ArduPilot's rotors never stand still

    def commands(self, demand: Array) -> Array:
        """(N,) motor commands."""
        thrust, roll, pitch, yaw = demand.tolist()
        return self._commands(roll, pitch, yaw, thrust)

    def speeds(self, demand: Array) -> Array:
        """(N,) normalised."""
        return self.vehicle.turned(self.commands(demand), self._full_speed)

    def wrench(self, demand: Array) -> Array:
        """(4,) N and N m."""
        return self.wrenches([demand])[0]

    def wrenches(self, demands: Iterable[Array]) -> Array:
        """(rows, 4) of demands (rows, 4), asked for one after another."""
        commands = np.array([self.commands(demand) for demand in demands])
        speeds = self.vehicle.turned(commands, self._full_speed)
        return self.airframe.wrench(*self.airframe.loads(self.model, speeds))

    def bound(self, commands: Array) -> NDArray[np.bool_]:
        """Whether rotors (N,) can go no further."""
        return (commands <= self.least + HALF_A_PWM_STEP) | (commands >= 1.0 - HALF_A_PWM_STEP)

    def lift(self, thrust: float) -> float:
        return float(self.wrench(np.array([thrust, 0.0, 0.0, 0.0]))[0])

    def ceiling(self) -> float:
        demands = np.zeros((51, 4))
        demands[:, 0] = np.linspace(0.5, 1.0, 51)
        return float(self.wrenches(demands)[:, 0].max())

    def power(self, thrust: float) -> tuple[float, float]:
        """Watts at the shafts, and from the battery (NaN where these were not measured)."""
        u = self.speeds(np.array([thrust, 0.0, 0.0, 0.0]))
        return float(shaft_watts(self.vehicle, u)), float(battery_watts(self.vehicle, u))

    def slopes(self, thrust: float | None) -> Array:
        """(4,) of each axis by its own demand."""
        if thrust is None:
            return np.full(4, math.nan)
        at = np.array([thrust, 0.0, 0.0, 0.0])
        found = self.wrenches(at + s * step for step in STEP * np.eye(4) for s in (1.0, -1.0))
        return (found[::2] - found[1::2]).diagonal() / (2.0 * STEP)


def reach(fly: TableOnRotors, hover: float, axis: int) -> AxisReach:
    """The authority of an axis (1 roll, 2 pitch, 3 yaw) in hover, wherever one is reported: `moment_Nm`."""
    at = np.array([hover, 0.0, 0.0, 0.0])
    still, ways = fly.wrench(at), []
    for sign in (1.0, -1.0):
        unit = sign * np.eye(4)[axis]
        low, high = 0.0, 1.0
        if fly.bound(fly.commands(at + unit)).any():
            for _ in range(40):
                middle = 0.5 * (low + high)
                low, high = (
                    (low, middle) if fly.bound(fly.commands(at + middle * unit)).any() else (middle, high)
                )
        u = fly.commands(at + high * unit)
        reached = np.flatnonzero(fly.bound(u))
        most = fly.wrench(at + unit)
        ways.append(
            AxisReach(
                AXES[axis],
                abs(float(fly.wrench(at + high * unit)[axis])),
                tuple(int(n) + 1 for n in reached),
                bool((u[reached] > 0.5).any()),
                abs(float(most[axis])),
                float(still[0] - most[0]),
            )
        )
    there, back = ways
    return back if back.moment_Nm < 0.999 * there.moment_Nm else there  # a symmetric vehicle's are a tie


def _span(gains: list[Array]) -> Array:
    """(4,) largest over smallest; NaN where a gain is missing or changes its sign."""
    rows = np.array(gains)
    size = np.abs(rows)
    sound = np.isfinite(rows).all(axis=0) & ((rows > 0).all(axis=0) | (rows < 0).all(axis=0))
    return np.where(sound, size.max(axis=0) / np.where(sound, size.min(axis=0), 1.0), math.nan)


def _coupling(fly: TableOnRotors, hover: float, gain: Array, hard: Array) -> Array:
    """(3, 4) off what was meant, the larger of both ways, with its sign."""
    at = np.array([hover, 0.0, 0.0, 0.0])
    still, rows = fly.wrench(at), []
    for axis in (1, 2, 3):
        meant = hard[axis - 1] * np.eye(4)[axis]
        signs = np.array([1.0, -1.0])[:, None]
        off = fly.wrenches(at + signs * meant / gain[axis]) - still - signs * meant
        tied = np.abs(off[0]) >= 0.999 * np.abs(off[1])  # as a symmetric vehicle's are
        rows.append(np.where(tied, off[0], off[1]))
    return np.array(rows)


def _sink(fly: TableOnRotors, loads_kg: Array, turn: Array) -> Array:
    """(len(loads),) m/s^2 downward under the demands `turn` of roll and yaw, in level flight at each load."""
    found = []
    for kg in loads_kg.tolist():
        demand = solve(fly.lift, kg * GRAVITY_M_S2)
        if demand is None:
            found.append(math.nan)
            continue
        found.append(GRAVITY_M_S2 - _least_lift(fly, demand, turn) / kg)
    return np.array(found)


def _most_held(fly: TableOnRotors, turn: Array) -> float:
    """N that some thrust demand holds in the turn `turn`: the best of every fifth, then of those about it."""
    coarse = {n: _least_lift(fly, THRUSTS[n], turn) for n in range(COARSE - 1, len(THRUSTS), COARSE)}
    best = max(coarse, key=coarse.__getitem__)
    about = range(max(best - COARSE + 1, 0), min(best + COARSE, len(THRUSTS)))
    return max(coarse[best], *(_least_lift(fly, THRUSTS[n], turn) for n in about if n != best))


def _least_lift(fly: TableOnRotors, thrust: float, turn: Array) -> float:
    """N at a thrust demand under the demands `turn` of roll and yaw at once, the worst of four ways."""
    ways = itertools.product((1.0, -1.0), repeat=2)
    demands = [np.array([thrust, r * turn[0], 0.0, y * turn[1]]) for r, y in ways]
    return float(fly.wrenches(demands)[:, 0].min())


def _shape_error(fly: TableOnRotors, hover: float, gain: Array, wrenches: Array) -> Array:
    """(4,) mean |delivered - g demand|, g of least squares; demands mean `wrenches` by hover's own gains."""
    unit = np.array([fly.airframe.mass_kg * GRAVITY_M_S2 / hover, *gain[1:]])
    demands = wrenches / unit
    delivered = fly.wrenches(demands)
    best = (demands * delivered).sum(axis=0) / (demands**2).sum(axis=0)
    return np.asarray(np.abs(delivered - best * demands).mean(axis=0))


def _null(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _nulls(x: Array) -> list[float | None]:
    return [_null(v) for v in x.tolist()]
