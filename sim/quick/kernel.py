# mypy: disallow-untyped-defs=False
"""A flight's inner loop, compiled: read the sensors, fly PX4's loops, mix, let the plant move on.

One turn is what `px4.autopilot.Autopilot.step` does in Offboard with every set-point fresh, in the same
order and with the same numbers; the tests hold the two flights together. Turns need not be whole
milliseconds apart: at 400 Hz the plant is moved by 2 and 3 steps in turn.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from sim.physics.compile_cache import OPTIONS, cached, plain
from sim.physics.kernel import advance
from sim.physics.layout import CURRENT, O_FORCE, SPEED, VOLTAGE, WIND
from sim.px4 import loops
from sim.px4.loops import M_OUT
from sim.quick.mix import call_law, px4_command

for _name in (
    "multiply", "conjugate", "reduced_tilt", "matrix_to_quaternion", "euler", "learn_hover", "low_passed",
    "accelerate", "point", "rates_for", "turn",
):  # fmt: skip
    register_jitable(**OPTIONS)(getattr(loops, _name))

# a reading: specific force, rates, attitude, position, velocity, height, voltage, speeds (N)
R_ACCEL, R_RATES, R_QUAT, R_POS, R_VEL, R_HEIGHT, R_VOLT, R_SPEEDS = 0, 3, 6, 10, 13, 16, 17, 18
# sensors: biases of accelerometer and gyro, what of the wandering is kept and fresh, its two stages
S_ACCEL_BIAS, S_GYRO_BIAS, S_KEEP, S_FRESH, S_PUSH, S_WANDER, S_SHAKE, S_BLADES, SENSES = (
    0, 3, 6, 15, 24, 33, 42, 43, 44,
)  # fmt: skip
# gusts: mean, state, slow state, size, law (0 first order, 1 dryden, 2 shear), length (s), on or off
W_MEAN, W_STATE, W_SLOW, W_SIZE, W_LAW, W_LENGTH, W_ON, GUSTS = 0, 3, 6, 9, 10, 11, 12, 13
# a goal: position, velocity, acceleration, yaw, yaw rate
GOAL = 11
# sums over the judged part
(
    A_TURNS, A_NORTH, A_EAST, A_DOWN, A_DOWN_MAX, A_LEVEL_MAX, A_TILT, A_YAW, A_YAW_MAX, A_BOUND, A_SHAFT,
    A_PACK, A_ROLL_RATE, A_PITCH_RATE, A_YAW_RATE, A_LOWEST, A_WANTED, SUMS,
) = range(18)  # fmt: skip
FALLEN_UPRIGHT = 0.5  # cosine of 60 degrees, PX4's FD_FAIL_R and FD_FAIL_P
FLEW, TIPPED, GROUND = 0, 1, 2
PWM_STEPS = 1000.0
LOG_EXTRA = 16  # columns of a log row besides motors and speeds


@plain
def blow(w, p, height, since, kick):
    """Move the air on: see `effects.Gusts.blow`."""
    if w[W_ON] == 0.0 or (w[W_SIZE] == 0.0 and w[W_LAW] != 2.0):
        return
    keep = math.exp(-max(since, 0.0) / w[W_LENGTH])
    fresh = w[W_SIZE] * math.sqrt(1.0 - keep * keep)
    for k in range(3):
        w[W_SLOW + k] = keep * w[W_SLOW + k] + (1.0 - keep) * w[W_STATE + k]
        w[W_STATE + k] = keep * w[W_STATE + k] + fresh * (0.5 if k == 2 else 1.0) * kick[k]
    a0, a1, a2 = w[W_STATE], w[W_STATE + 1], w[W_STATE + 2]
    m0, m1, m2 = w[W_MEAN], w[W_MEAN + 1], w[W_MEAN + 2]
    if w[W_LAW] == 1.0:
        root = math.sqrt(3.0)
        c0 = (root * a0 + (1.0 - root) * w[W_SLOW]) / math.sqrt(2.0)
        c1 = (root * a1 + (1.0 - root) * w[W_SLOW + 1]) / math.sqrt(2.0)
        c2 = (root * a2 + (1.0 - root) * w[W_SLOW + 2]) / math.sqrt(2.0)
        size = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        size = size if size > 0.0 else 1.0
        e0, e1, e2 = m0 / size, m1 / size, m2 / size
        along = e0 * (a0 - c0) + e1 * (a1 - c1) + e2 * (a2 - c2)
        a0, a1, a2 = c0 + e0 * along, c1 + e1 * along, c2 + e2 * along
    elif w[W_LAW] == 2.0:
        grown = (max(height, 0.1) / 4.0) ** 0.2
        m0, m1, m2 = m0 * grown, m1 * grown, m2 * grown
    p[WIND], p[WIND + 1], p[WIND + 2] = m0 + a0, m1 + a1, m2 + a2


@plain
def read(state, out, top, ground, s, noise, turns, dt, r):
    """Fill a reading from the plant: see `sensors.Sensors.read`."""
    n = len(turns)
    for k in range(9):
        s[S_PUSH + k] = s[S_KEEP + k] * s[S_PUSH + k] + s[S_FRESH + k] * noise[6 + k]
        s[S_WANDER + k] = (
            s[S_KEEP + k] * s[S_WANDER + k] + math.sqrt(2.0) * (1.0 - s[S_KEEP + k]) * s[S_PUSH + k]
        )
    h0, h1, h2 = 0.5 * s[S_WANDER], 0.5 * s[S_WANDER + 1], 0.5 * s[S_WANDER + 2]
    q0, q1, q2, q3 = state[6], state[7], state[8], state[9]
    r[R_QUAT] = q0 - q1 * h0 - q2 * h1 - q3 * h2
    r[R_QUAT + 1] = q1 + q0 * h0 + q2 * h2 - q3 * h1
    r[R_QUAT + 2] = q2 + q0 * h1 + q3 * h0 - q1 * h2
    r[R_QUAT + 3] = q3 + q0 * h2 + q1 * h1 - q2 * h0
    shaken0 = shaken1 = shaken2 = 0.0
    if s[S_SHAKE] != 0.0:
        for i in range(n):
            u = state[SPEED + i]
            turns[i] += dt * top * u * s[S_BLADES]
            strength = s[S_SHAKE] * u * u
            shaken0 += math.cos(turns[i]) * strength
            shaken1 += math.sin(turns[i]) * strength
            shaken2 += 0.3 * math.cos(turns[i]) * strength
    for k in range(3):
        r[R_ACCEL + k] = out[O_FORCE + k] + s[S_ACCEL_BIAS + k] + noise[k]
        r[R_RATES + k] = state[10 + k] + s[S_GYRO_BIAS + k] + noise[3 + k]
        r[R_POS + k] = state[k] + s[S_WANDER + 3 + k]
        r[R_VEL + k] = state[3 + k] + s[S_WANDER + 6 + k]
    r[R_ACCEL] += shaken0
    r[R_ACCEL + 1] += shaken1
    r[R_ACCEL + 2] += shaken2
    r[R_HEIGHT] = max(ground - state[2] + noise[15], 0.0)
    r[R_VOLT] = state[VOLTAGE] + noise[16]
    for i in range(n):
        r[R_SPEEDS + i] = max(state[SPEED + i] + noise[17 + i], 0.0)


@plain
def judge(state, out, goal, wanted, rates, command, n, top, a):
    """Add one turn to the sums."""
    w, x, y, z = state[6], state[7], state[8], state[9]
    bx, by, bz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    aw, ax, ay, az = wanted
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
        off = rates[k] - state[10 + k]
        a[A_ROLL_RATE + k] += off * off


@plain
def log_row(time, r, command, n, top, row):
    """One row of the contract's flight log: see `flights.columns`."""
    row[0] = time
    for i in range(n):
        row[1 + i] = command[i]
        row[1 + n + 14 + i] = r[R_SPEEDS + i] * top * (30.0 / math.pi)
    at = 1 + n
    for k in range(3):
        row[at + k], row[at + 3 + k], row[at + 9 + k] = r[R_ACCEL + k], r[R_RATES + k], r[R_VEL + k]
    roll, pitch, yaw = loops.euler((r[R_QUAT], r[R_QUAT + 1], r[R_QUAT + 2], r[R_QUAT + 3]))
    row[at + 6], row[at + 7], row[at + 8] = roll, pitch, yaw
    row[at + 12], row[at + 13] = r[R_HEIGHT], r[R_VOLT]


@cached(**OPTIONS)
def fly(
    first, last, judged, rate, h, state, p, geo, pairs, poly, blades, out, top, ground, goals, noise, kicks, ring, s, turns, w, g, m, columns, curve, address, book, demand, sp, command, a, thin,
    thin_every, log, log_every,
):  # fmt: skip
    """Turns first..last (from 0 on; row 0 of goals, noise and kicks is turn `first`'s).

    Returns (turns flown, how it ended: FLEW, TIPPED, GROUND). `judged`: turn from which sums are taken; ring
    (late + 1, 18 + N): readings, of which the oldest is flown by; thin (rows, 4 + N), log (rows, 15 + 2 N).
    """
    n, dt, late = len(command), 1.0 / rate, len(ring) - 1
    before = 0.0 if first == 0 else h * ((1000 * first) // rate - (1000 * (first - 1)) // rate)
    for turn in range(first, last):
        row = turn - first
        blow(w, p, ground - state[2], before, kicks[row])
        read(state, out, top, ground, s, noise[row], turns, dt, ring[turn % (late + 1)])
        r = ring[max(turn - late, 0) % (late + 1)]
        goal = goals[row]
        attitude = (r[R_QUAT], r[R_QUAT + 1], r[R_QUAT + 2], r[R_QUAT + 3])
        loops.accelerate(
            (goal[0], goal[1], goal[2]), (goal[3], goal[4], goal[5]), (goal[6], goal[7], goal[8]),
            (r[R_POS], r[R_POS + 1], r[R_POS + 2]), (r[R_VEL], r[R_VEL + 1], r[R_VEL + 2]), g, m, dt,
        )  # fmt: skip
        thrust, wanted = loops.point(goal[9], attitude, g, m, dt)
        rates = loops.rates_for(wanted, attitude, goal[10], g)
        loops.turn(rates, thrust, (r[R_RATES], r[R_RATES + 1], r[R_RATES + 2]), g, m, dt)
        demand[0], demand[1], demand[2], demand[3] = m[M_OUT], m[M_OUT + 1], m[M_OUT + 2], thrust
        if address == 0:
            px4_command(columns, curve, demand[0], demand[1], demand[2], thrust, sp, command)
        else:
            call_law(address, book, demand, command)
        for i in range(n):  # a PWM output has a thousand steps
            command[i] = np.rint(command[i] * PWM_STEPS) / PWM_STEPS
        if log_every and turn % log_every == 0:
            log_row(h * ((1000 * turn) // rate), r, command, n, top, log[turn // log_every])
        steps = (1000 * (turn + 1)) // rate - (1000 * turn) // rate
        advance(state, command, p, geo, pairs, poly, blades, h, steps, out)
        before = h * steps
        if turn >= judged:
            judge(state, out, goal, wanted, rates, command, n, top, a)
            if (turn - judged) % thin_every == 0:
                slim = thin[(turn - judged) // thin_every]
                slim[0], slim[1], slim[2], slim[3] = thrust, demand[0], demand[1], demand[2]
                for i in range(n):
                    slim[4 + i] = command[i]
        upright = 1 - 2 * (state[7] * state[7] + state[8] * state[8])
        if not upright > FALLEN_UPRIGHT:
            return turn + 1, TIPPED
        if state[2] > -0.02:
            return turn + 1, GROUND
    return last, FLEW
