# mypy: disallow-untyped-defs=False
"""A turn of a flight, compiled: the air moves, sensors are read, PX4's loops steer, the mix, the plant.

`fly` is a whole flight of such turns. The stand-in drives the same functions one by one (`sense`, `advance`,
`px4.track`), with its modes and whoever talks to it in between. Turns need not be whole milliseconds
apart: at 400 Hz the plant is moved by 2 and 3 steps in turn.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sim.flight_log import log_row
from sim.physics import sensing, wind
from sim.physics.compile_cache import OPTIONS, cached, inlined
from sim.physics.kernel import advance
from sim.physics.layout import CURRENT, SPEED, VOLTAGE
from sim.px4.loops import D_ATTITUDE, D_RATES, D_THRUST
from sim.px4.track import steer
from sim.quick.mix import call_law, px4_command

for _function in (wind.blow, log_row):
    inlined(_function)

# sums over the judged part
(
    A_TURNS, A_NORTH, A_EAST, A_DOWN, A_DOWN_MAX, A_LEVEL_MAX, A_TILT, A_YAW, A_YAW_MAX, A_BOUND, A_SHAFT,
    A_PACK, A_ROLL_RATE, A_PITCH_RATE, A_YAW_RATE, A_LOWEST, A_WANTED, SUMS,
) = range(18)  # fmt: skip
FALLEN_UPRIGHT = 0.5  # cosine of 60 degrees, PX4's FD_FAIL_R and FD_FAIL_P
FLEW, TIPPED, GROUND = 0, 1, 2
PWM_STEPS = 1000.0


@inlined
def judge(state, out, goal, demand, command, n, top, a):
    """Add one turn to the sums."""
    w, x, y, z = state[6], state[7], state[8], state[9]
    bx, by, bz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    aw, ax, ay, az = (
        demand[D_ATTITUDE],
        demand[D_ATTITUDE + 1],
        demand[D_ATTITUDE + 2],
        demand[D_ATTITUDE + 3],
    )
    ux, uy, uz = 2 * (ax * az + aw * ay), 2 * (ay * az - aw * ax), 1 - 2 * (ax * ax + ay * ay)
    tilt = math.acos(min(max(ux * bx + uy * by + uz * bz, -1.0), 1.0))
    heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    yaw = goal[9] - heading
    yaw -= 2 * math.pi * np.rint(yaw / (2 * math.pi))
    north, east, down = goal[0] - state[0], goal[1] - state[1], state[2] - goal[2]
    shaft, bound = 0.0, 0.0
    for i in range(n):
        shaft += out[6 + n + i] * state[SPEED + i]
        if command[i] >= 1.0 - 0.5e-3 or command[i] <= 0.5e-3:
            bound = 1.0
    a[A_TURNS] += 1.0
    a[A_NORTH] += north * north
    a[A_EAST] += east * east
    a[A_DOWN] += down * down
    a[A_DOWN_MAX] = max(a[A_DOWN_MAX], abs(down))
    a[A_LEVEL_MAX] = max(a[A_LEVEL_MAX], math.sqrt(north * north + east * east))
    a[A_LOWEST] = max(a[A_LOWEST], state[2])
    a[A_WANTED] = max(a[A_WANTED], goal[2])
    a[A_TILT] += tilt * tilt
    a[A_YAW] += yaw * yaw
    a[A_YAW_MAX] = max(a[A_YAW_MAX], abs(yaw))
    a[A_BOUND] += bound
    a[A_SHAFT] += shaft * top
    a[A_PACK] += state[CURRENT] * state[VOLTAGE]
    for k in range(3):
        off = demand[D_RATES + k] - state[10 + k]
        a[A_ROLL_RATE + k] += off * off


class Turns(NamedTuple):
    """Which turns are flown, counted from the flight's first."""

    first: int
    last: int
    judged: int  # from which on sums are taken
    rate_hz: int
    steps: int  # of the plant in each; all turns are of one length, for loops know one interval


class Body(NamedTuple):
    """The plant and the air around it, as `Plant` and `wind` keep them."""

    state: Any
    parameters: Any
    geometry: Any
    pairs: Any
    loads: Any
    blades: Any
    out: Any
    gusts: Any
    top_rad_s: float
    ground_m: float


class Rows(NamedTuple):
    """A row a turn, of which row 0 is the first one's."""

    goals: Any
    noise: Any
    kicks: Any  # of the gusts


class Senses(NamedTuple):
    """Readings, and what sensors remember."""

    ring: Any  # (late + 1, 18 + N), of which the oldest is flown by
    memory: Any
    turns: Any  # how each sensor is turned


class Loops(NamedTuple):
    """PX4's, as `px4.loops` has them."""

    gains: Any
    memory: Any
    demand: Any


class Mix(NamedTuple):
    """From demand to command: PX4's table, or the C function at an address, as `quick.mix` has them."""

    columns: Any  # (6, N)
    curve: float
    address: int  # 0: PX4's table
    book: Any
    scratch: Any  # (N,)
    command: Any  # (N,)


class Kept(NamedTuple):
    """What stays of the flight."""

    sums: Any
    thin: Any  # (rows, 4 + N), a row every `thin_every` turns
    thin_every: int
    log: Any  # (rows, 15 + 2 N), a row every `log_every` turns; 0: none
    log_every: int


@cached(**OPTIONS)
def fly(turns, body, rows, senses, loops, mix, kept):
    """Fly these turns; returns (turns flown, how it ended: FLEW, TIPPED, GROUND)."""
    first, rate, steps = turns.first, turns.rate_hz, turns.steps
    state, top, command, demand = body.state, body.top_rad_s, mix.command, loops.demand
    n, dt, ring, late = len(command), 1.0 / rate, senses.ring, len(senses.ring) - 1
    h, before = dt / steps, 0.0 if first == 0 else dt
    for turn in range(first, turns.last):
        row = turn - first
        wind.blow(body.gusts, body.parameters, body.ground_m - state[2], before, rows.kicks[row])
        sensing.read(
            state, body.out, top, body.ground_m, senses.memory, rows.noise[row], senses.turns, dt,
            ring[turn % (late + 1)],
        )  # fmt: skip
        reading, goal = ring[max(turn - late, 0) % (late + 1)], rows.goals[row]
        steer(goal, reading, loops.gains, loops.memory, dt, demand)
        thrust = demand[D_THRUST]
        if mix.address == 0:
            px4_command(mix.columns, mix.curve, demand[0], demand[1], demand[2], thrust, mix.scratch, command)
        else:
            call_law(mix.address, mix.book, demand, command)
        for i in range(n):  # a PWM output has a thousand steps
            command[i] = np.rint(command[i] * PWM_STEPS) / PWM_STEPS
        if kept.log_every and turn % kept.log_every == 0:
            log_row(turn * dt, reading, command, n, top, kept.log[turn // kept.log_every])
        advance(
            state, command, body.parameters, body.geometry, body.pairs, body.loads, body.blades, h, steps,
            body.out,
        )  # fmt: skip
        before = dt
        if turn >= turns.judged:
            judge(state, body.out, goal, demand, command, n, top, kept.sums)
            if (turn - turns.judged) % kept.thin_every == 0:
                slim = kept.thin[(turn - turns.judged) // kept.thin_every]
                slim[0], slim[1], slim[2], slim[3] = thrust, demand[0], demand[1], demand[2]
                for i in range(n):
                    slim[4 + i] = command[i]
        upright = 1 - 2 * (state[7] * state[7] + state[8] * state[8])
        if not upright > FALLEN_UPRIGHT:
            return turn + 1, TIPPED
        if state[2] > -0.02:
            return turn + 1, GROUND
    return turns.last, FLEW
