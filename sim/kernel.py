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
Everything is indexed by the constants below; `plant.py` fills the arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

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

# geometry row of a rotor
G_POS, G_AXIS, G_SPIN, G_THRUST, G_TORQUE = 0, 3, 6, 7, 8
GEOMETRY = 9

# outputs at the end of a step
O_FORCE, O_ALPHA, O_THRUST = 0, 3, 6


@njit(cache=True)
def surface(c, top_a, top_b, u, v):  # type: ignore[no-untyped-def]
    """sum c[a, b] u^a v^b by Horner."""
    total = 0.0
    for a in range(top_a, -1, -1):
        row = 0.0
        for b in range(top_b, -1, -1):
            row = row * v + c[a, b]
        total = total * u + row
    return total


@njit(cache=True)
def derivative(x, u, target, p, geo, level, partner, c, order, dx, thrust, torque):  # type: ignore[no-untyped-def]
    """dx (13) of the rigid body at state x and rotor speeds u; fills thrust (N) and torque (N m)."""
    qw, qx, qy, qz = x[QUAT], x[QUAT + 1], x[QUAT + 2], x[QUAT + 3]
    wx, wy, wz = x[RATE], x[RATE + 1], x[RATE + 2]
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    vn, ve, vd = x[VEL] - p[WIND], x[VEL + 1] - p[WIND + 1], x[VEL + 2] - p[WIND + 2]
    vx, vy, vz = (
        r00 * vn + r10 * ve + r20 * vd,
        r01 * vn + r11 * ve + r21 * vd,
        r02 * vn + r12 * ve + r22 * vd,
    )
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(len(u)):
        if level[i] == 1:
            upper, lower, s = u[partner[i]], u[i], 2
        else:
            upper, lower, s = u[i], 0.0 if partner[i] < 0 else u[partner[i]], 0
        t = surface(c[s], order[s, 0], order[s, 1], upper, lower) * geo[i, G_THRUST]
        q = surface(c[s + 1], order[s + 1, 0], order[s + 1, 1], upper, lower) * geo[i, G_TORQUE]
        ax, ay, az = geo[i, G_AXIS], geo[i, G_AXIS + 1], geo[i, G_AXIS + 2]
        rx, ry, rz = geo[i, G_POS] - p[CX], geo[i, G_POS + 1] - p[CY], geo[i, G_POS + 2] - p[CZ]
        hx = hy = hz = 0.0
        if p[INFLOW] != 0.0 or p[DRAG] != 0.0:
            lx, ly, lz = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx
            climb = lx * ax + ly * ay + lz * az
            ratio = p[INFLOW] * climb / (p[TIP_SPEED] * max(u[i], 0.1))
            t *= 1.0 - ratio / (1.0 + abs(ratio))
            k = -p[DRAG] * u[i]
            hx, hy, hz = k * (lx - climb * ax), k * (ly - climb * ay), k * (lz - climb * az)
        if p[GROUND_GAIN] != 0.0:
            height = p[GROUND_Z] - x[POS + 2] - (r20 * rx + r21 * ry + r22 * rz)
            t *= 1.0 + p[GROUND_GAIN] * math.exp(-max(height, 0.0) / p[GROUND_SCALE])
        spin = geo[i, G_SPIN]
        hx, hy, hz = hx + t * ax, hy + t * ay, hz + t * az
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
        thrust[i], torque[i] = t, q
    if p[BODY_DRAG] != 0.0:
        k = -p[BODY_DRAG] * math.sqrt(vx * vx + vy * vy + vz * vz)
        fx, fy, fz = fx + k * vx, fy + k * vy, fz + k * vz
    if x[POS + 2] + p[FOOT_Z] + 1.5 * p[FOOT_XY] > p[GROUND_Z]:
        for corner in range(4):  # spring, damper and friction under each foot
            cx = (p[FOOT_XY] if corner & 1 else -p[FOOT_XY]) - p[CX]
            cy = (p[FOOT_XY] if corner & 2 else -p[FOOT_XY]) - p[CY]
            cz = p[FOOT_Z] - p[CZ]
            depth = x[POS + 2] + r20 * cx + r21 * cy + r22 * cz - p[GROUND_Z]
            if depth > 0.0:
                bx, by, bz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
                sn = x[VEL] + r00 * bx + r01 * by + r02 * bz
                se = x[VEL + 1] + r10 * bx + r11 * by + r12 * bz
                sd = x[VEL + 2] + r20 * bx + r21 * by + r22 * bz
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
    m = p[MASS]
    dx[POS], dx[POS + 1], dx[POS + 2] = x[VEL], x[VEL + 1], x[VEL + 2]
    dx[VEL] = (r00 * fx + r01 * fy + r02 * fz) / m
    dx[VEL + 1] = (r10 * fx + r11 * fy + r12 * fz) / m
    dx[VEL + 2] = (r20 * fx + r21 * fy + r22 * fz) / m + p[GRAVITY]
    dx[QUAT] = -0.5 * (qx * wx + qy * wy + qz * wz)
    dx[QUAT + 1] = 0.5 * (qw * wx + qy * wz - qz * wy)
    dx[QUAT + 2] = 0.5 * (qw * wy + qz * wx - qx * wz)
    dx[QUAT + 3] = 0.5 * (qw * wz + qx * wy - qy * wx)
    dx[RATE] = (mx - (p[IZZ] - p[IYY]) * wy * wz) / p[IXX]
    dx[RATE + 1] = (my - (p[IXX] - p[IZZ]) * wz * wx) / p[IYY]
    dx[RATE + 2] = (mz - (p[IYY] - p[IXX]) * wx * wy) / p[IZZ]
    return fx / m, fy / m, fz / m


@njit(cache=True)
def open_circuit(cells, charge):  # type: ignore[no-untyped-def]
    """Open-circuit voltage (V) of a lithium pack at state of charge 0..1: a slope and a knee at the end."""
    return cells * (3.55 + 0.60 * charge - 0.35 * math.exp(-charge / 0.06))


@njit(cache=True)
def advance(state, command, p, geo, level, partner, c, order, h, steps, out):  # type: ignore[no-untyped-def]
    """`steps` steps of h seconds at constant command (N); state is advanced in place.

    out: specific force at the body origin (3, m/s^2), angular acceleration (3), thrust (N), torque (N).
    """
    n = len(command)
    y, k1, k2, k3, k4 = np.empty(13), np.empty(13), np.empty(13), np.empty(13), np.empty(13)
    middle, end, target, thrust, torque = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    lag = p[LAG]
    keep = math.exp(-h / lag) if lag > 0 else 0.0
    keep_half = math.exp(-0.5 * h / lag) if lag > 0 else 0.0
    u, x = state[SPEED : SPEED + n], state[:13]
    for step in range(steps + 1):
        gain = (state[VOLTAGE] / p[VOLT_REF]) ** p[VOLT_POWER] if p[VOLT_POWER] != 0.0 else 1.0
        for i in range(n):
            target[i] = command[i] * gain
        sx, sy, sz = derivative(x, u, target, p, geo, level, partner, c, order, k1, thrust, torque)
        if step == steps:
            break
        power = 0.0
        for i in range(n):
            middle[i] = target[i] + (u[i] - target[i]) * keep_half
            end[i] = target[i] + (u[i] - target[i]) * keep
            power += torque[i] * u[i] * p[TOP_RATE]
        for j in range(13):
            y[j] = x[j] + 0.5 * h * k1[j]
        derivative(y, middle, target, p, geo, level, partner, c, order, k2, thrust, torque)
        for j in range(13):
            y[j] = x[j] + 0.5 * h * k2[j]
        derivative(y, middle, target, p, geo, level, partner, c, order, k3, thrust, torque)
        for j in range(13):
            y[j] = x[j] + h * k3[j]
        derivative(y, end, target, p, geo, level, partner, c, order, k4, thrust, torque)
        for j in range(13):
            x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
        for i in range(n):
            u[i] = end[i]
        norm = math.sqrt(x[QUAT] ** 2 + x[QUAT + 1] ** 2 + x[QUAT + 2] ** 2 + x[QUAT + 3] ** 2)
        for j in range(4):
            x[QUAT + j] /= norm
        state[CURRENT] = 1.0 + max(power, 0.0) / (p[EFFICIENCY] * max(state[VOLTAGE], 1.0))
        state[CHARGE] = max(state[CHARGE] - state[CURRENT] * h / p[CAPACITY], 0.0)
        rest = open_circuit(p[CELLS], state[CHARGE]) - p[RESISTANCE] * state[CURRENT]
        state[VOLTAGE] += (rest - state[VOLTAGE]) * min(h / 0.02, 1.0)
    # the IMU sits at the body origin, which a moved centre of mass leaves behind
    wx, wy, wz = x[RATE], x[RATE + 1], x[RATE + 2]
    rx, ry, rz = -p[CX], -p[CY], -p[CZ]
    dot, square = wx * rx + wy * ry + wz * rz, wx * wx + wy * wy + wz * wz
    out[O_FORCE] = sx + k1[RATE + 1] * rz - k1[RATE + 2] * ry + wx * dot - rx * square
    out[O_FORCE + 1] = sy + k1[RATE + 2] * rx - k1[RATE] * rz + wy * dot - ry * square
    out[O_FORCE + 2] = sz + k1[RATE] * ry - k1[RATE + 1] * rx + wz * dot - rz * square
    for j in range(3):
        out[O_ALPHA + j] = k1[RATE + j]
    for i in range(n):
        out[O_THRUST + i], out[O_THRUST + n + i] = thrust[i], torque[i]
