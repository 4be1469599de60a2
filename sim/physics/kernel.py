# mypy: disallow-untyped-defs=False
"""The plant's equations, compiled: rigid body with a quaternion, RK4, rotors, ground, battery.

y = (position NED, velocity NED, quaternion body -> NED, body rates) obeys

    p' = v,   v' = g + R(q) F / m,   q' = q * (0, w) / 2,   w' = I^-1 (M - w x I w)

with F, M (body FRD) summed over the rotors (`forces`): thrust T and torque Q of eq. 17 at the rotors' own
speeds, or of blades in the air they meet (`blades`). Speeds follow the command with a lag that is solved
exactly within a step (`drive`). Where an effect is switched on:
  ground        T (1 + g exp(-h / s)), h the disc's height
  inflow        T (1 - k l / (1 + k |l|)), l = climb speed through the disc / blade tip speed
  rotor drag    -c u (air velocity in the disc), at the hub
  rotor inertia -J (dW/dt) a s - w x (J W a s), W the rotor's rate, a its axis, s its spin
  body drag     -d |v| v against the wind
or its other laws. The world is flat: nothing depends on where zero is. Everything is indexed by `layout`;
`plant.py` fills the arrays.
"""

from __future__ import annotations

import numpy as np

from sim.physics import layout as at
from sim.physics import sensing
from sim.physics.compile_cache import OPTIONS, cached, inlined
from sim.physics.drive import follow, kept, lag_of, retarget, supply, turned
from sim.physics.forces import rotated, spin, wrench

SUPPLY_EVERY = 4  # steps between two looks at the battery: its own time constant is 20 ms
BODY = 13


@inlined
def shares_of(p):
    """1 / mass, 1 / inertia and the gyroscopic shares of `rigid`."""
    jx, jy, jz = p[at.IXX], p[at.IYY], p[at.IZZ]
    return (
        1 / p[at.MASS],
        1 / jx,
        1 / jy,
        1 / jz,
        (jz - jy) / jx,
        (jx - jz) / jy,
        (jy - jx) / jz,
        p[at.GRAVITY],
    )


@inlined
def rigid(y, load, body, slope):
    """Fill `slope` (13) of y under a force and moment; `body` of `shares_of`."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotated(y)
    fx, fy, fz = load[0] * body[0], load[1] * body[0], load[2] * body[0]
    qw, qx, qy, qz = y[6], y[7], y[8], y[9]
    wx, wy, wz = y[10], y[11], y[12]
    slope[0], slope[1], slope[2] = y[3], y[4], y[5]
    slope[3] = r00 * fx + r01 * fy + r02 * fz
    slope[4] = r10 * fx + r11 * fy + r12 * fz
    slope[5] = r20 * fx + r21 * fy + r22 * fz + body[7]
    slope[6] = -0.5 * (qx * wx + qy * wy + qz * wz)
    slope[7] = 0.5 * (qw * wx + qy * wz - qz * wy)
    slope[8] = 0.5 * (qw * wy + qz * wx - qx * wz)
    slope[9] = 0.5 * (qw * wz + qx * wy - qy * wx)
    slope[10] = load[3] * body[1] - body[4] * wy * wz
    slope[11] = load[4] * body[2] - body[5] * wz * wx
    slope[12] = load[5] * body[3] - body[6] * wx * wy


@inlined
def sensed(y, load, p, body, slope, out):
    """The IMU sits at the body origin, which a moved centre of mass leaves behind."""
    wx, wy, wz = y[10], y[11], y[12]
    ax, ay, az = slope[10], slope[11], slope[12]
    rx, ry, rz = -p[at.CX], -p[at.CY], -p[at.CZ]
    dot, square = wx * rx + wy * ry + wz * rz, wx * wx + wy * wy + wz * wz
    out[at.O_FORCE] = load[0] * body[0] + ay * rz - az * ry + wx * dot - rx * square
    out[at.O_FORCE + 1] = load[1] * body[0] + az * rx - ax * rz + wy * dot - ry * square
    out[at.O_FORCE + 2] = load[2] * body[0] + ax * ry - ay * rx + wz * dot - rz * square
    out[at.O_ALPHA], out[at.O_ALPHA + 1], out[at.O_ALPHA + 2] = ax, ay, az


@inlined
def calm_air(p, blades):
    """Whether loads depend on speeds alone, clear of the ground."""
    calm = p[at.INFLOW] == p[at.DRAG] == p[at.GROUND_GAIN] == p[at.ROTOR_INERTIA] == p[at.BODY_DRAG] == 0.0
    calm = calm and p[at.INFLOW_LIFT] == p[at.BODY_LINEAR] == p[at.CEILING_GAIN] == 0.0
    return calm and p[at.PUSH] == p[at.PUSH + 1] == p[at.PUSH + 2] == 0.0 and len(blades) == 0


@inlined
def loaded(state, command, geo, w, f, second):
    """Fill the scratch from the vehicle's arrays."""
    n = len(command)
    for i in range(n):
        first = at.SPEED + i
        w[at.W_U, i], w[at.W_HEAT, i] = state[first], state[first + 2 * n]
        w[at.W_TARGET, i] = command[i] * geo[at.G_SPEED, i]
        w[at.W_LED, i] = state[first + n] if second else w[at.W_TARGET, i]
        f[at.F_NOW, i], f[at.F_NOW + 1, i] = state[first + 3 * n], state[first + 4 * n]


@inlined
def stored(w, f, state, out):
    """What the scratch holds of each rotor, to the vehicle's arrays."""
    n = w.shape[1]
    for i in range(n):
        first = at.SPEED + i
        state[first], state[first + n], state[first + 2 * n] = w[at.W_U, i], w[at.W_LED, i], w[at.W_HEAT, i]
        state[first + 3 * n], state[first + 4 * n] = f[at.F_NOW, i], f[at.F_NOW + 1, i]
        out[at.O_THRUST + i], out[at.O_THRUST + n + i] = w[at.W_THRUST, i], w[at.W_TORQUE, i]


@inlined
def begun(y, w, f, start, total, blades):
    """Remember where a step starts."""
    for k in range(BODY):
        start[k], total[k] = y[k], 0.0
    for i in range(w.shape[1]):
        w[at.W_U0, i], w[at.W_LED0, i] = w[at.W_U, i], w[at.W_LED, i]
        for k in range(2 if len(blades) else 0):
            f[at.F_START + k, i], f[at.F_SUM + k, i] = f[at.F_NOW + k, i], 0.0


@inlined
def onward(stage, h, y, f, start, slope, total, blades):
    """Move y and the flows on to the next stage of Runge and Kutta's step, or to its end."""
    weight = 1.0 if stage == 0 or stage == 3 else 2.0
    ahead = h / 6.0 if stage == 3 else h if stage == 2 else 0.5 * h
    for k in range(BODY):
        total[k] += weight * slope[k]
        y[k] = start[k] + ahead * (total[k] if stage == 3 else slope[k])
    for k in range(2 if len(blades) else 0):
        for i in range(f.shape[1]):
            f[at.F_SUM + k, i] += weight * f[at.F_SLOPE + k, i]
            f[at.F_NOW + k, i] = (
                f[at.F_START + k, i] + ahead * f[(at.F_SUM if stage == 3 else at.F_SLOPE) + k, i]
            )
    if stage == 3:  # a quaternion of length one, by one of Newton's steps
        scale = 1.5 - 0.5 * (y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
        for k in range(6, 10):
            y[k] *= scale


@cached(forceinline=True, **OPTIONS)
def advance(state, command, p, geo, pairs, poly, blades, h, steps, out):
    """`steps` steps of h seconds at constant command (N); state is advanced in place.

    `pairs`, `poly` and `blades` as in `forces`; out: specific force at the body origin (3, m/s^2), angular
    acceleration (3), thrust (N), torque (N).
    """
    n, y = len(command), state[:BODY]
    w, f = np.zeros((at.W_ROWS, n)), np.zeros((at.F_ROWS, n))
    start, slope, total, load = np.zeros(BODY), np.zeros(BODY), np.zeros(BODY), np.zeros(6)
    lag, body = lag_of(p), shares_of(p)
    half, full = kept(lag, 0.5 * h), kept(lag, h)
    bends = p[at.VOLT_POWER] != 0.0 or p[at.HEAT_SHARE] != 0.0
    still, clear = calm_air(p, blades), p[at.GROUND_Z] - p[at.FOOT_Z] - 1.5 * p[at.FOOT_XY] - 0.05
    calm = False
    loaded(state, command, geo, w, f, lag[2])
    for count in range(4 * steps + 1):  # stages; the last is what the end is like
        step, stage = count // 4, count % 4
        look = stage == 0 and step % SUPPLY_EVERY == 0 and step < steps
        if look:
            calm = still and y[2] < clear
            if poly.shape[2] == at.TABLES:
                turned(command, state[at.VOLTAGE], geo, p, w, lag[2], pairs, poly)
            elif bends:
                retarget(command, state[at.VOLTAGE], geo, p, w, lag[2])
        if stage % 2 or count == 0:  # what speeds are now, half a step and a whole one on
            if count:
                follow(w, half if stage == 1 else full)
            spin(w, p, geo, pairs, poly, blades)
        if not (calm and stage == 2):  # then it is the load of the stage before
            wrench(y, w, f, p, geo, pairs, blades, lag, load)
        rigid(y, load, body, slope)
        if look:
            supply(state, w, p, geo, h * min(SUPPLY_EVERY, steps - step), pairs, poly)
        if stage == 0:
            begun(y, w, f, start, total, blades)
        if step < steps:
            onward(stage, h, y, f, start, slope, total, blades)
    sensed(y, load, p, body, slope, out)
    stored(w, f, state, out)


inlined(sensing.read)


@cached(**OPTIONS)
def sense(state, out, top, ground, s, noise, turns, dt, r):
    """`sensing.read` for one reading."""
    sensing.read(state, out, top, ground, s, noise, turns, dt, r)
