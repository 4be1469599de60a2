# mypy: disallow-untyped-defs=False
"""What air and ground do to a vehicle: loads of every rotor in still and in moving air, summed on the body.

`w` is the scratch of `layout`, a column a rotor; `f` induced flows; `pairs` (P, 2) the upper (or single)
rotor and the lower one, -1 for none; `poly` (4, A, B) eq. 17's coefficients or (n, n, 8) tables
(`tabled_pair`), empty where rotors are `blades`.
"""

from __future__ import annotations

import math

from sim.physics import blades as air
from sim.physics import layout as at
from sim.physics.compile_cache import inlined

ROOF_M = 0.12  # of the body's top above its origin


@inlined
def surfaces(c, u, v):
    """sum c[s, a, b] u^a v^b of all four surfaces by Horner, side by side."""
    t0 = t1 = t2 = t3 = 0.0
    for a in range(c.shape[1] - 1, -1, -1):
        r0 = r1 = r2 = r3 = 0.0
        for b in range(c.shape[2] - 1, -1, -1):
            r0, r1 = r0 * v + c[0, a, b], r1 * v + c[1, a, b]
            r2, r3 = r2 * v + c[2, a, b], r3 * v + c[3, a, b]
        t0, t1, t2, t3 = t0 * u + r0, t1 * u + r1, t2 * u + r2, t3 * u + r3
    return t0, t1, t2, t3


@inlined
def cell_of(c, x, y):
    """The cell of tables c (n, n, 8) that x, y of their axes (0 .. REACH) lie in, and how far along it."""
    n = c.shape[0] - 1
    a, b = min(max(x, 0.0) * n / at.REACH, n - 1e-9), min(max(y, 0.0) * n / at.REACH, n - 1e-9)
    i, j = int(a), int(b)
    return i, j, a - i, b - j


@inlined
def looked_up(c, first, x, y):
    """Tables `first` and the next."""
    i, j, f, g = cell_of(c, x, y)
    w00, w01, w10, w11 = (1.0 - f) * (1.0 - g), (1.0 - f) * g, f * (1.0 - g), f * g
    k, m = first, first + 1
    return (
        c[i, j, k] * w00 + c[i, j + 1, k] * w01 + c[i + 1, j, k] * w10 + c[i + 1, j + 1, k] * w11,
        c[i, j, m] * w00 + c[i, j + 1, m] * w01 + c[i + 1, j, m] * w10 + c[i + 1, j + 1, m] * w11,
    )


@inlined
def still(poly, u, v):
    """Loads of a pair at its speeds: of coefficients, or of tables, whose loads come first."""
    if poly.shape[0] == 4:
        return surfaces(poly, u, v)
    i, j, f, g = cell_of(poly, u, v)
    w00, w01, w10, w11 = (1.0 - f) * (1.0 - g), (1.0 - f) * g, f * (1.0 - g), f * g
    a, b, c, d = poly[i, j], poly[i, j + 1], poly[i + 1, j], poly[i + 1, j + 1]
    return (
        a[0] * w00 + b[0] * w01 + c[0] * w10 + d[0] * w11,
        a[1] * w00 + b[1] * w01 + c[1] * w10 + d[1] * w11,
        a[2] * w00 + b[2] * w01 + c[2] * w10 + d[2] * w11,
        a[3] * w00 + b[3] * w01 + c[3] * w10 + d[3] * w11,
    )


@inlined
def spin(w, p, geo, pairs, poly, blades):
    """What speeds alone decide: thrust (N) and torque (N m) in still air; of blades lift and profile drag."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        u = w[at.W_U, i]
        v = w[at.W_U, j] if j >= 0 else 0.0
        if len(blades):
            w[at.W_STILL, i], w[at.W_STILL_Q, i] = air.spun(u, blades)
            if j >= 0:
                w[at.W_STILL, j], w[at.W_STILL_Q, j] = air.spun(v, blades)
            continue
        thrust, torque, thrust_low, torque_low = still(poly, u, v)
        w[at.W_STILL, i] = thrust * geo[at.G_THRUST, i] * p[at.AIR]
        w[at.W_STILL_Q, i] = torque * geo[at.G_TORQUE, i] * p[at.AIR]
        if j >= 0:
            w[at.W_STILL, j] = thrust_low * geo[at.G_THRUST, j] * p[at.AIR]
            w[at.W_STILL_Q, j] = torque_low * geo[at.G_TORQUE, j] * p[at.AIR]


@inlined
def met(i, v, rates, p, geo):
    """A hub's speed through the air: along its axis, along its disc (x, y, z), and the square of that."""
    x, y, z = geo[at.G_POS, i] - p[at.CX], geo[at.G_POS + 1, i] - p[at.CY], geo[at.G_POS + 2, i] - p[at.CZ]
    ax, ay, az = geo[at.G_AXIS, i], geo[at.G_AXIS + 1, i], geo[at.G_AXIS + 2, i]
    wx, wy, wz = rates
    lx, ly, lz = v[0] + wy * z - wz * y, v[1] + wz * x - wx * z, v[2] + wx * y - wy * x
    climb = lx * ax + ly * ay + lz * az
    lx, ly, lz = lx - climb * ax, ly - climb * ay, lz - climb * az
    return climb, lx, ly, lz, lx * lx + ly * ly + lz * lz


@inlined
def blow(v, rates, w, f, p, geo, pairs, blades):
    """Loads of blades in the air that they meet, and how the flow that they induce changes."""
    now, slope = at.F_NOW, at.F_SLOPE
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        climb, _, _, _, edge2 = met(i, v, rates, p, geo)
        jet, back = air.jet_of(f[now, i], climb, edge2, blades), 0.0
        if j >= 0:
            back = air.reaching_back(f[now, j], f[now + 1, j], blades)
        loads, f[slope, i] = air.alone(
            w[at.W_U, i], w[at.W_STILL, i], w[at.W_STILL_Q, i], f[now, i], edge2, climb, back, blades
        )
        felt(w, p, geo, i, loads)
        if j >= 0:
            climb, _, _, _, edge2 = met(j, v, rates, p, geo)
            loads, f[slope, j], f[slope + 1, j] = air.below(
                w[at.W_U, j], w[at.W_STILL, j], w[at.W_STILL_Q, j], f[now, j], f[now + 1, j],
                edge2, climb, jet, blades,
            )  # fmt: skip
            felt(w, p, geo, j, loads)


@inlined
def felt(w, p, geo, i, loads):
    """A rotor's loads by what is left of it, in this air."""
    left = geo[at.G_THRUST, i] * p[at.AIR]
    w[at.W_THRUST, i], w[at.W_PULL, i] = loads[0] * left, loads[2] * left
    w[at.W_TORQUE, i] = loads[1] * geo[at.G_TORQUE, i] * p[at.AIR]


@inlined
def climbing(thrust, u, climb, p):
    """Thrust of a climbing disc, where that is an effect and not the blades' own."""
    ratio = climb / max(u, 0.1) / p[at.TIP_SPEED]
    if p[at.INFLOW] != 0.0:
        share = ratio * p[at.INFLOW]
        thrust -= thrust * share / (1.0 + abs(share))
    if p[at.INFLOW_LIFT] != 0.0:  # blades of lift slope 8 L against momentum: l (l - l_c) + L l = const
        hover, half = p[at.INFLOW_HOVER], (p[at.INFLOW_LIFT] - ratio) * 0.5
        through = math.sqrt(half * half + hover * hover + hover * p[at.INFLOW_LIFT]) - half
        thrust *= through * (through - ratio) / (hover * hover)
    return thrust


@inlined
def grounded(thrust, height, p):
    """Thrust near the ground, at the disc's height."""
    if p[at.GROUND_LAW] == 0.0:
        return thrust * (1.0 + math.exp(-max(height, 0.0) / p[at.GROUND_SCALE]) * p[at.GROUND_GAIN])
    h = max(height, 0.1)
    square = p[at.GROUND_SCALE] / (h * h)
    if p[at.GROUND_LAW] == 1.0:  # Cheeseman and Bennett 1955, eq. 1
        return thrust / (1.0 - min(square, 0.3))
    return thrust * (1.0 + square) ** (2.0 / 3.0)  # Hayden 1976


@inlined
def ceiled(thrust, height, p):
    """Thrust under a ceiling."""
    left = max(p[at.CEILING_Z] - height, 0.2 * p[at.RADIUS]) / p[at.RADIUS]
    square = p[at.CEILING_GAIN] / (left * left)
    if p[at.CEILING_LAW] == 0.0:  # Hsiao and Chirarattananon 2019: momentum theory, 1/8 for one rotor
        return thrust * (math.sqrt(square + 1.0) * 0.5 + 0.5)
    return thrust / (1.0 - min(square * 0.25, 0.5))  # Sanchez-Cuevas, Heredia and Ollero 2017


@inlined
def dragged(thrust, u, p):
    """Drag along the disc by speed, mass flow or flapping, where that is an effect."""
    if p[at.DRAG_LAW] == 0.0:
        return u * p[at.DRAG]
    scale, t = p[at.DRAG] * p[at.DRAG_SCALE], max(thrust, 0.0)
    return math.sqrt(t) * scale if p[at.DRAG_LAW] == 1.0 else t / max(u, 0.1) * scale


@inlined
def feet(down, v, r, rates, p, load):
    """Add spring, damper and friction under each foot, and at four corners of the top."""
    vn, ve, vd = v
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = r
    wx, wy, wz = rates
    for corner in range(8):
        cx = (p[at.FOOT_XY] if corner & 1 else -p[at.FOOT_XY]) - p[at.CX]
        cy = (p[at.FOOT_XY] if corner & 2 else -p[at.FOOT_XY]) - p[at.CY]
        cz = (-ROOF_M if corner & 4 else p[at.FOOT_Z]) - p[at.CZ]
        depth = down + r20 * cx + r21 * cy + r22 * cz - p[at.GROUND_Z]
        if depth > 0.0:
            bx, by, bz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
            sn = vn + r00 * bx + r01 * by + r02 * bz
            se = ve + r10 * bx + r11 * by + r12 * bz
            sd = vd + r20 * bx + r21 * by + r22 * bz
            push = max(p[at.MASS] * (300.0 * depth + 12.0 * sd), 0.0)
            grip = -0.7 * push / (math.sqrt(sn * sn + se * se) + 0.02)
            gn, ge, gd = grip * sn, grip * se, -push
            hx = r00 * gn + r10 * ge + r20 * gd
            hy = r01 * gn + r11 * ge + r21 * gd
            hz = r02 * gn + r12 * ge + r22 * gd
            add(load, hx, hy, hz, cx, cy, cz)


@inlined
def add(load, fx, fy, fz, x, y, z):
    """A force at a place."""
    load[0] += fx
    load[1] += fy
    load[2] += fz
    load[3] += y * fz - z * fy
    load[4] += z * fx - x * fz
    load[5] += x * fy - y * fx


@inlined
def rotated(y):
    """Body to NED, row by row."""
    qw, qx, qy, qz = y[6], y[7], y[8], y[9]
    return (
        1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy),
        2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
        2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy),
    )  # fmt: skip


@inlined
def bend(down, tilt, v, rates, w, p, geo):
    """Thrust and drag of every rotor as effects have them; tilt: the last row of the rotation matrix."""
    for i in range(w.shape[1]):
        x, y, z = (
            geo[at.G_POS, i] - p[at.CX],
            geo[at.G_POS + 1, i] - p[at.CY],
            geo[at.G_POS + 2, i] - p[at.CZ],
        )
        t, u, height = (
            w[at.W_THRUST, i],
            w[at.W_U, i],
            p[at.GROUND_Z] - down - (x * tilt[0] + y * tilt[1] + z * tilt[2]),
        )
        if p[at.INFLOW] != 0.0 or p[at.INFLOW_LIFT] != 0.0:
            t = climbing(t, u, met(i, v, rates, p, geo)[0], p)
        if p[at.GROUND_GAIN] != 0.0:
            t = grounded(t, height, p)
        if p[at.CEILING_GAIN] != 0.0:
            t = ceiled(t, height, p)
        if p[at.DRAG] != 0.0:
            w[at.W_PULL, i] += dragged(t, u, p)
        w[at.W_THRUST, i] = t


@inlined
def summed(v, rates, w, p, geo, load):
    """Force and moment of all rotors: thrust, drag along the disc, torque about the axis.

    Nothing but sums, so that the compiler puts rotors side by side.
    """
    sx = sy = sz = mx = my = mz = 0.0
    for i in range(w.shape[1]):
        t, pull, twist = w[at.W_THRUST, i], w[at.W_PULL, i], w[at.W_TORQUE, i] * geo[at.G_SPIN, i]
        x, y, z = (
            geo[at.G_POS, i] - p[at.CX],
            geo[at.G_POS + 1, i] - p[at.CY],
            geo[at.G_POS + 2, i] - p[at.CZ],
        )
        ax, ay, az = geo[at.G_AXIS, i], geo[at.G_AXIS + 1, i], geo[at.G_AXIS + 2, i]
        _, lx, ly, lz, _ = met(i, v, rates, p, geo)
        fx, fy, fz = t * ax - pull * lx, t * ay - pull * ly, t * az - pull * lz
        sx, sy, sz = sx + fx, sy + fy, sz + fz
        mx += y * fz - z * fy - twist * ax
        my += z * fx - x * fz - twist * ay
        mz += x * fy - y * fx - twist * az
    load[0], load[1], load[2], load[3], load[4], load[5] = sx, sy, sz, mx, my, mz


@inlined
def reaction(rates, w, p, geo, lag, load):
    """Of rotors that speed up and that are turned with the body."""
    inertia = p[at.ROTOR_INERTIA] * p[at.TOP_RATE]
    wx, wy, wz = rates
    up, down, _ = lag
    for i in range(w.shape[1]):
        u, way = w[at.W_U, i], w[at.W_LED, i] - w[at.W_U, i]
        pole = up if way > 0.0 else down
        fresh = way / pole if pole > 0.0 else 0.0
        spun = inertia * geo[at.G_SPIN, i]
        hx, hy, hz = (
            spun * u * geo[at.G_AXIS, i],
            spun * u * geo[at.G_AXIS + 1, i],
            spun * u * geo[at.G_AXIS + 2, i],
        )
        load[3] -= spun * fresh * geo[at.G_AXIS, i] + wy * hz - wz * hy
        load[4] -= spun * fresh * geo[at.G_AXIS + 1, i] + wz * hx - wx * hz
        load[5] -= spun * fresh * geo[at.G_AXIS + 2, i] + wx * hy - wy * hx


@inlined
def wrench(y, w, f, p, geo, pairs, blades, lag, load):
    """Fill `load` (6): force and moment on the body at y = (position, velocity, quaternion, rates).

    After `spin`.
    """
    r, rates = rotated(y), (y[10], y[11], y[12])
    an, ae, ad = y[3] - p[at.WIND], y[4] - p[at.WIND + 1], y[5] - p[at.WIND + 2]
    vx = r[0] * an + r[3] * ae + r[6] * ad
    vy = r[1] * an + r[4] * ae + r[7] * ad
    vz = r[2] * an + r[5] * ae + r[8] * ad
    v = (vx, vy, vz)
    if len(blades):
        blow(v, rates, w, f, p, geo, pairs, blades)
    else:
        for i in range(w.shape[1]):
            w[at.W_THRUST, i], w[at.W_TORQUE, i], w[at.W_PULL, i] = w[at.W_STILL, i], w[at.W_STILL_Q, i], 0.0
    bent = p[at.INFLOW] != 0.0 or p[at.INFLOW_LIFT] != 0.0 or p[at.DRAG] != 0.0
    if bent or p[at.GROUND_GAIN] != 0.0 or p[at.CEILING_GAIN] != 0.0:
        bend(y[2], (r[6], r[7], r[8]), v, rates, w, p, geo)
    summed(v, rates, w, p, geo, load)
    if p[at.ROTOR_INERTIA] != 0.0:
        reaction(rates, w, p, geo, lag, load)
    k = -p[at.BODY_DRAG] * math.sqrt(vx * vx + vy * vy + vz * vz) - p[at.BODY_LINEAR]
    load[0] += k * vx + p[at.PUSH]
    load[1] += k * vy + p[at.PUSH + 1]
    load[2] += k * vz + p[at.PUSH + 2]
    if y[2] + p[at.FOOT_Z] + 1.5 * p[at.FOOT_XY] > p[at.GROUND_Z]:
        feet(y[2], (y[3], y[4], y[5]), r, rates, p, load)
