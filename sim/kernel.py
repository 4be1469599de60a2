"""The plant's equations, compiled: rigid body with a quaternion, RK4, rotors, ground, battery.

x = (position NED, velocity NED, quaternion body -> NED, body rates) obeys

    p' = v,   v' = g + R(q) F / m,   q' = q * (0, w) / 2,   w' = I^-1 (M - w x I w)

with F, M (body FRD) summed over the rotors: thrust T and torque Q of eq. 17 at the rotors' own speeds, which
follow the command with a first-order lag (solved exactly within a step), and, where an effect is switched on:
  ground        T (1 + g exp(-h / s)), h the disc's height
  inflow        T (1 - k l / (1 + k |l|)), l = climb speed through the disc / blade tip speed
  rotor drag    -c u (air velocity in the disc), at the hub
  rotor inertia -J (dW/dt) a s - w x (J W a s), W the rotor's rate, a its axis, s its spin
  body drag     -d |v| v against the wind
In calm air, clear of the ground, rotor loads depend on their speeds alone and are summed once a stage time:
that is what makes a step cost 0.1 us. The world is flat: nothing depends on where north is zero.
Everything is indexed by the constants below; `plant.py` fills the arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

# state vector: rigid body first, rotor speeds last
POS, VEL, QUAT, RATE = 0, 3, 6, 10
CHARGE, VOLTAGE, CURRENT, SPEED = 13, 14, 15, 16

# parameter vector
MASS, IXX, IYY, IZZ, GRAVITY, GROUND_Z, LAG, TOP_RATE = 0, 1, 2, 3, 4, 5, 6, 7
TIP_SPEED, CX, CY, CZ = 8, 9, 10, 11
GROUND_GAIN, GROUND_SCALE, INFLOW, DRAG, ROTOR_INERTIA, BODY_DRAG = 12, 13, 14, 15, 16, 17
WIND = 18  # three
VOLT_POWER, VOLT_REF, CELLS, CAPACITY, RESISTANCE, EFFICIENCY, FOOT_XY, FOOT_Z = (
    21,
    22,
    23,
    24,
    25,
    26,
    27,
    28,
)
PARAMETERS = 29

# geometry, a row a quantity and a column a rotor
G_POS, G_AXIS, G_SPIN, G_THRUST, G_TORQUE = 0, 3, 6, 7, 8
GEOMETRY = 9

# outputs at the end of a step
O_FORCE, O_ALPHA, O_THRUST = 0, 3, 6

SUPPLY_EVERY = 4  # steps between two looks at the battery: its own time constant is 20 ms

# contracting and reordering sums, not assuming that all numbers are finite
FAST = {"contract", "nsz", "arcp", "reassoc"}


@njit(cache=True, error_model="numpy", fastmath=FAST)
def surface(c, u, v):  # type: ignore[no-untyped-def]
    """sum c[a, b] u^a v^b by Horner."""
    total = 0.0
    for a in range(c.shape[0] - 1, -1, -1):
        row = 0.0
        for b in range(c.shape[1] - 1, -1, -1):
            row = row * v + c[a, b]
        total = total * u + row
    return total


@njit(cache=True, error_model="numpy", fastmath=FAST)
def loads(u, pairs, singles, c, geo, thrust, torque):  # type: ignore[no-untyped-def]
    """Thrust (N) and torque (N m) of every rotor at normalised speeds u, in still air."""
    if singles is None:  # decided when it is compiled: a branch here would cost a step as much as its rotors
        quadratic_loads(u, pairs, c, geo, thrust, torque)
    else:
        general_loads(u, pairs, singles, c, geo, thrust, torque)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def quadratic_loads(u, pairs, c, geo, thrust, torque):  # type: ignore[no-untyped-def]
    """Pairs alone, the upper rotor by its own speed alone, powers up to two."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = u[i], u[j]
        thrust[i] = geo[G_THRUST, i] * ((c[0, 2, 0] * a + c[0, 1, 0]) * a + c[0, 0, 0])
        torque[i] = geo[G_TORQUE, i] * ((c[1, 2, 0] * a + c[1, 1, 0]) * a + c[1, 0, 0])
        thrust[j] = geo[G_THRUST, j] * (
            ((c[2, 2, 2] * b + c[2, 2, 1]) * b + c[2, 2, 0]) * a * a
            + ((c[2, 1, 2] * b + c[2, 1, 1]) * b + c[2, 1, 0]) * a
            + (c[2, 0, 2] * b + c[2, 0, 1]) * b
            + c[2, 0, 0]
        )
        torque[j] = geo[G_TORQUE, j] * (
            ((c[3, 2, 2] * b + c[3, 2, 1]) * b + c[3, 2, 0]) * a * a
            + ((c[3, 1, 2] * b + c[3, 1, 1]) * b + c[3, 1, 0]) * a
            + (c[3, 0, 2] * b + c[3, 0, 1]) * b
            + c[3, 0, 0]
        )


@njit(cache=True, error_model="numpy", fastmath=FAST)
def general_loads(u, pairs, singles, c, geo, thrust, torque):  # type: ignore[no-untyped-def]
    """Any powers, rotors without a pair among them."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = u[i], u[j]
        thrust[i] = geo[G_THRUST, i] * surface(c[0], a, b)
        torque[i] = geo[G_TORQUE, i] * surface(c[1], a, b)
        thrust[j] = geo[G_THRUST, j] * surface(c[2], a, b)
        torque[j] = geo[G_TORQUE, j] * surface(c[3], a, b)
    for k in range(len(singles)):
        i = singles[k]
        thrust[i] = geo[G_THRUST, i] * surface(c[0], u[i], 0.0)
        torque[i] = geo[G_TORQUE, i] * surface(c[1], u[i], 0.0)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def still(thrust, torque, geo, p):  # type: ignore[no-untyped-def]
    """Force and moment of upright rotors that only their speeds decide."""
    up = mx = my = mz = 0.0
    for i in range(len(thrust)):
        t = thrust[i]
        up += t
        mx -= t * geo[G_POS + 1, i]
        my += t * geo[G_POS, i]
        mz += torque[i] * geo[G_SPIN, i]
    return 0.0, 0.0, -up, mx + up * p[CY], my - up * p[CX], mz


@njit(cache=True, error_model="numpy")
def moving(pose, u, target, p, geo, thrust, torque, felt):  # type: ignore[no-untyped-def]
    """Force and moment where air moves, axes tilt, rotors react or feet touch; fills `felt` thrust (N)."""
    pd, vn, ve, vd, qw, qx, qy, qz, wx, wy, wz = pose
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    an, ae, ad = vn - p[WIND], ve - p[WIND + 1], vd - p[WIND + 2]
    vx, vy, vz = (
        r00 * an + r10 * ae + r20 * ad,
        r01 * an + r11 * ae + r21 * ad,
        r02 * an + r12 * ae + r22 * ad,
    )
    k = -p[BODY_DRAG] * math.sqrt(vx * vx + vy * vy + vz * vz)
    fx, fy, fz = k * vx, k * vy, k * vz
    mx = my = mz = 0.0
    for i in range(len(u)):
        t, q, spin = thrust[i], torque[i], geo[G_SPIN, i]
        ax, ay, az = geo[G_AXIS, i], geo[G_AXIS + 1, i], geo[G_AXIS + 2, i]
        rx, ry, rz = geo[G_POS, i] - p[CX], geo[G_POS + 1, i] - p[CY], geo[G_POS + 2, i] - p[CZ]
        lx, ly, lz = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx
        climb = lx * ax + ly * ay + lz * az
        ratio = p[INFLOW] * climb / (p[TIP_SPEED] * max(u[i], 0.1))
        t *= 1.0 - ratio / (1.0 + abs(ratio))
        if p[GROUND_GAIN] != 0.0:
            height = p[GROUND_Z] - pd - (r20 * rx + r21 * ry + r22 * rz)
            t *= 1.0 + p[GROUND_GAIN] * math.exp(-max(height, 0.0) / p[GROUND_SCALE])
        k = -p[DRAG] * u[i]
        hx = t * ax + k * (lx - climb * ax)
        hy = t * ay + k * (ly - climb * ay)
        hz = t * az + k * (lz - climb * az)
        mx += ry * hz - rz * hy - q * spin * ax
        my += rz * hx - rx * hz - q * spin * ay
        mz += rx * hy - ry * hx - q * spin * az
        if p[ROTOR_INERTIA] != 0.0 and p[LAG] > 0.0:
            up = -p[ROTOR_INERTIA] * spin * p[TOP_RATE] * (target[i] - u[i]) / p[LAG]
            turn = p[ROTOR_INERTIA] * spin * p[TOP_RATE] * u[i]
            mx += up * ax - turn * (wy * az - wz * ay)
            my += up * ay - turn * (wz * ax - wx * az)
            mz += up * az - turn * (wx * ay - wy * ax)
        fx, fy, fz = fx + hx, fy + hy, fz + hz
        felt[i] = t
    if pd + p[FOOT_Z] + 1.5 * p[FOOT_XY] > p[GROUND_Z]:
        for corner in range(4):  # spring, damper and friction under each foot
            cx = (p[FOOT_XY] if corner & 1 else -p[FOOT_XY]) - p[CX]
            cy = (p[FOOT_XY] if corner & 2 else -p[FOOT_XY]) - p[CY]
            cz = p[FOOT_Z] - p[CZ]
            depth = pd + r20 * cx + r21 * cy + r22 * cz - p[GROUND_Z]
            if depth > 0.0:
                bx, by, bz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
                sn = vn + r00 * bx + r01 * by + r02 * bz
                se = ve + r10 * bx + r11 * by + r12 * bz
                sd = vd + r20 * bx + r21 * by + r22 * bz
                load = max(p[MASS] * (300.0 * depth + 12.0 * sd), 0.0)
                grip = -0.7 * load / (math.sqrt(sn * sn + se * se) + 0.02)
                gn, ge, gd = grip * sn, grip * se, -load
                hx = r00 * gn + r10 * ge + r20 * gd
                hy = r01 * gn + r11 * ge + r21 * gd
                hz = r02 * gn + r12 * ge + r22 * gd
                fx, fy, fz = fx + hx, fy + hy, fz + hz
                mx += cy * hz - cz * hy
                my += cz * hx - cx * hz
                mz += cx * hy - cy * hx
    return fx, fy, fz, mx, my, mz


@njit(cache=True, error_model="numpy", fastmath=FAST)
def rigid(qw, qx, qy, qz, wx, wy, wz, load, b):  # type: ignore[no-untyped-def]
    """(acceleration 3, quaternion rate 4, angular acceleration 3) under a force and moment."""
    fx, fy, fz, mx, my, mz = load
    return (
        ((1 - 2 * (qy * qy + qz * qz)) * fx + 2 * (qx * qy - qw * qz) * fy + 2 * (qx * qz + qw * qy) * fz)
        * b[0],
        (2 * (qx * qy + qw * qz) * fx + (1 - 2 * (qx * qx + qz * qz)) * fy + 2 * (qy * qz - qw * qx) * fz)
        * b[0],
        (2 * (qx * qz - qw * qy) * fx + 2 * (qy * qz + qw * qx) * fy + (1 - 2 * (qx * qx + qy * qy)) * fz)
        * b[0]
        + b[7],
        -0.5 * (qx * wx + qy * wy + qz * wz),
        0.5 * (qw * wx + qy * wz - qz * wy),
        0.5 * (qw * wy + qz * wx - qx * wz),
        0.5 * (qw * wz + qx * wy - qy * wx),
        mx * b[1] - b[4] * wy * wz,
        my * b[2] - b[5] * wz * wx,
        mz * b[3] - b[6] * wx * wy,
    )


@njit(cache=True, error_model="numpy")
def open_circuit(cells, charge):  # type: ignore[no-untyped-def]
    """Open-circuit voltage (V) of a lithium pack at state of charge 0..1: a slope and a knee at the end."""
    return cells * (3.55 + 0.60 * charge - 0.35 * math.exp(-charge / 0.06))


@njit(cache=True, error_model="numpy", fastmath=FAST)
def supply(state, u, torque, p, h):  # type: ignore[no-untyped-def]
    """Current, charge and voltage `h` seconds on; in place."""
    power = 0.0
    for i in range(len(u)):
        power += torque[i] * u[i]
    volts = max(state[VOLTAGE], 1.0)
    state[CURRENT] = 1.0 + max(power, 0.0) * p[TOP_RATE] / (p[EFFICIENCY] * volts)
    state[CHARGE] = max(state[CHARGE] - state[CURRENT] * h / p[CAPACITY], 0.0)
    rest = open_circuit(p[CELLS], state[CHARGE]) - p[RESISTANCE] * state[CURRENT]
    state[VOLTAGE] += (rest - state[VOLTAGE]) * min(h / 0.02, 1.0)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def advance(state, command, p, geo, pairs, singles, c, h, steps, out):  # type: ignore[no-untyped-def]
    """`steps` steps of h seconds at constant command (N); state is advanced in place.

    out: specific force at the body origin (3, m/s^2), angular acceleration (3), thrust (N), torque (N).
    """
    n = len(command)
    u, middle, target = state[SPEED : SPEED + n].copy(), np.empty(n), np.empty(n)
    thrust, torque, felt = np.empty(n), np.empty(n), np.empty(n)
    keep = math.exp(-h / p[LAG]) if p[LAG] > 0 else 0.0
    keep_half = math.exp(-0.5 * h / p[LAG]) if p[LAG] > 0 else 0.0
    jx, jy, jz = p[IXX], p[IYY], p[IZZ]
    b = (1 / p[MASS], 1 / jx, 1 / jy, 1 / jz, (jz - jy) / jx, (jx - jz) / jy, (jy - jx) / jz, p[GRAVITY])
    pn, pe, pd, vn, ve, vd = state[0], state[1], state[2], state[3], state[4], state[5]
    qw, qx, qy, qz, wx, wy, wz = state[6], state[7], state[8], state[9], state[10], state[11], state[12]
    calm = p[INFLOW] == p[DRAG] == p[GROUND_GAIN] == p[ROTOR_INERTIA] == p[BODY_DRAG] == 0.0
    for i in range(n):
        calm = calm and geo[G_AXIS + 2, i] == -1.0
        target[i] = command[i]
    clear = p[GROUND_Z] - p[FOOT_Z] - 1.5 * p[FOOT_XY] - 0.05
    hh, h6 = 0.5 * h, h / 6.0
    loads(u, pairs, singles, c, geo, thrust, torque)
    for step in range(steps):
        if step % SUPPLY_EVERY == 0:
            if p[VOLT_POWER] != 0.0:
                gain = (state[VOLTAGE] / p[VOLT_REF]) ** p[VOLT_POWER]
                for i in range(n):
                    target[i] = command[i] * gain
            supply(state, u, torque, p, h * min(SUPPLY_EVERY, steps - step))
        free = calm and pd < clear
        if free:
            load = still(thrust, torque, geo, p)
        else:
            pose = (pd, vn, ve, vd, qw, qx, qy, qz, wx, wy, wz)
            load = moving(pose, u, target, p, geo, thrust, torque, felt)
        an, ae, ad, aw, ax, ay, az, awx, awy, awz = rigid(qw, qx, qy, qz, wx, wy, wz, load, b)
        for i in range(n):
            d = u[i] - target[i]
            middle[i] = target[i] + d * keep_half
            u[i] = target[i] + d * keep
        loads(middle, pairs, singles, c, geo, thrust, torque)
        w, x, y, z = qw + hh * aw, qx + hh * ax, qy + hh * ay, qz + hh * az
        r, s, t = wx + hh * awx, wy + hh * awy, wz + hh * awz
        if free:
            load = still(thrust, torque, geo, p)
        else:
            pose = (
                pd + hh * vd,
                vn + hh * an,
                ve + hh * ae,
                vd + hh * ad,
                w,
                x,
                y,
                z,
                r,
                s,
                t,
            )
            load = moving(pose, middle, target, p, geo, thrust, torque, felt)
        bn, be, bd, bw, bx, by, bz, bwx, bwy, bwz = rigid(w, x, y, z, r, s, t, load, b)
        w, x, y, z = qw + hh * bw, qx + hh * bx, qy + hh * by, qz + hh * bz
        r, s, t = wx + hh * bwx, wy + hh * bwy, wz + hh * bwz
        if not free:
            ud = vd + hh * ad
            pose = (
                pd + hh * ud,
                vn + hh * bn,
                ve + hh * be,
                vd + hh * bd,
                w,
                x,
                y,
                z,
                r,
                s,
                t,
            )
            load = moving(pose, middle, target, p, geo, thrust, torque, felt)
        cn, ce, cd, cw, cx, cy, cz, cwx, cwy, cwz = rigid(w, x, y, z, r, s, t, load, b)
        loads(u, pairs, singles, c, geo, thrust, torque)
        w, x, y, z = qw + h * cw, qx + h * cx, qy + h * cy, qz + h * cz
        r, s, t = wx + h * cwx, wy + h * cwy, wz + h * cwz
        if free:
            load = still(thrust, torque, geo, p)
        else:
            ud = vd + hh * bd
            pose = (
                pd + h * ud,
                vn + h * cn,
                ve + h * ce,
                vd + h * cd,
                w,
                x,
                y,
                z,
                r,
                s,
                t,
            )
            load = moving(pose, u, target, p, geo, thrust, torque, felt)
        dn, de, dd, dw, dx, dy, dz, dwx, dwy, dwz = rigid(w, x, y, z, r, s, t, load, b)
        pn, pe, pd = (
            pn + h * (vn + h6 * (an + bn + cn)),
            pe + h * (ve + h6 * (ae + be + ce)),
            pd + h * (vd + h6 * (ad + bd + cd)),
        )
        vn, ve, vd = (
            vn + h6 * (an + 2 * (bn + cn) + dn),
            ve + h6 * (ae + 2 * (be + ce) + de),
            vd + h6 * (ad + 2 * (bd + cd) + dd),
        )
        qw += h6 * (aw + 2 * (bw + cw) + dw)
        qx += h6 * (ax + 2 * (bx + cx) + dx)
        qy += h6 * (ay + 2 * (by + cy) + dy)
        qz += h6 * (az + 2 * (bz + cz) + dz)
        wx += h6 * (awx + 2 * (bwx + cwx) + dwx)
        wy += h6 * (awy + 2 * (bwy + cwy) + dwy)
        wz += h6 * (awz + 2 * (bwz + cwz) + dwz)
        # one step of Newton's square root: the norm is off by h^5 at most
        k = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = k * qw, k * qx, k * qy, k * qz
    state[0], state[1], state[2], state[3], state[4], state[5] = pn, pe, pd, vn, ve, vd
    state[6], state[7], state[8], state[9] = qw, qx, qy, qz
    state[10], state[11], state[12] = wx, wy, wz
    for i in range(n):
        state[SPEED + i] = u[i]
    pose = (pd, vn, ve, vd, qw, qx, qy, qz, wx, wy, wz)
    load = moving(pose, u, target, p, geo, thrust, torque, felt)
    end = rigid(qw, qx, qy, qz, wx, wy, wz, load, b)
    # the IMU sits at the body origin, which a moved centre of mass leaves behind
    rx, ry, rz = -p[CX], -p[CY], -p[CZ]
    dot, square = wx * rx + wy * ry + wz * rz, wx * wx + wy * wy + wz * wz
    out[O_FORCE] = load[0] * b[0] + end[8] * rz - end[9] * ry + wx * dot - rx * square
    out[O_FORCE + 1] = load[1] * b[0] + end[9] * rx - end[7] * rz + wy * dot - ry * square
    out[O_FORCE + 2] = load[2] * b[0] + end[7] * ry - end[8] * rx + wz * dot - rz * square
    for j in range(3):
        out[O_ALPHA + j] = end[7 + j]
    for i in range(n):
        out[O_THRUST + i], out[O_THRUST + n + i] = felt[i], torque[i]


@njit(parallel=True, fastmath=FAST)
def advance_many(states, commands, p, geo, pairs, singles, c, h, steps, outs):  # type: ignore[no-untyped-def]
    """`advance` of M alike vehicles: states (M, 16 + N), commands (M, N), outs (M, 6 + 2 N)."""
    for k in prange(len(states)):
        advance(states[k], commands[k], p, geo, pairs, singles, c, h, steps, outs[k])
