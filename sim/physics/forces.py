"""What air and ground do to a vehicle: loads of every rotor in still and in moving air, summed on the body.

Rotors side by side in `lanes.Lanes`; `geo` holds their places from the centre of mass, axes, spins and what
is left of their thrust and torque.
"""

from __future__ import annotations

import math

from sim.physics.blades import blown, falling, inlined, plain, turned
from sim.physics.layout import (
    BODY_DRAG,
    BODY_LINEAR,
    CEILING_GAIN,
    CEILING_LAW,
    CEILING_Z,
    CX,
    CY,
    CZ,
    DRAG,
    DRAG_LAW,
    DRAG_SCALE,
    FOOT_XY,
    FOOT_Z,
    GROUND_GAIN,
    GROUND_LAW,
    GROUND_SCALE,
    GROUND_Z,
    INFLOW,
    INFLOW_HOVER,
    INFLOW_LIFT,
    MASS,
    PUSH,
    RADIUS,
    ROTOR_INERTIA,
    TIP_SPEED,
    TOP_RATE,
    WIND,
)
from sim.physics.simd import above, below, both, lower, root, total, upper

ROOF_M = 0.12  # of the body's top above its origin


@inlined
def quadratic(u, c):  # type: ignore[no-untyped-def]
    """Thrust and torque in still air; the upper rotor by its own speed alone, powers up to two."""
    a, b = upper(u), lower(u)
    square = a * a
    thrust = (
        ((b * c[6] + c[7]) * b + c[8]) * square
        + ((b * c[9] + c[10]) * b + c[11]) * a
        + (b * c[12] + c[13]) * b
        + c[14]
    )
    torque = (
        ((b * c[15] + c[16]) * b + c[17]) * square
        + ((b * c[18] + c[19]) * b + c[20]) * a
        + (b * c[21] + c[22]) * b
        + c[23]
    )
    upper_thrust, upper_torque = square * c[0] + a * c[1] + c[2], square * c[3] + a * c[4] + c[5]
    return both(upper_thrust, thrust), both(upper_torque, torque)


@plain
def surface(c, u, v):  # type: ignore[no-untyped-def]
    """sum c[a, b] u^a v^b by Horner."""
    total = u * 0.0
    for a in range(c.shape[0] - 1, -1, -1):
        row = v * 0.0
        for b in range(c.shape[1] - 1, -1, -1):
            row = row * v + c[a, b]
        total = total * u + row
    return total


@plain
def general(u, c):  # type: ignore[no-untyped-def]
    """Thrust and torque in still air, any powers."""
    a, b = upper(u), lower(u)
    thrust = both(surface(c[0], a, b), surface(c[2], a, b))
    return thrust, both(surface(c[1], a, b), surface(c[3], a, b))


@inlined
def turn(u, geo, quad, poly, blades):  # type: ignore[no-untyped-def]
    """What rotors do as far as speeds decide: thrust and torque in still air, or blades' numbers."""
    if quad is not None:  # decided when it is compiled: a branch here would cost a step as much as its rotors
        thrust, torque = quadratic(u, quad)
        air = thrust * geo[7], torque * geo[8]
    if poly is not None:
        thrust, torque = general(u, poly)
        air = thrust * geo[7], torque * geo[8]
    if blades is not None:
        air = turned(u, blades)
    return air


@inlined
def still(air, geo):  # type: ignore[no-untyped-def]
    """Force and moment of upright rotors that only their speeds decide."""
    t, q = air[0], air[1]
    x, y, spin = geo[0], geo[1], geo[6]
    return 0.0, 0.0, -total(t), -total(t * y), total(t * x), total(q * spin)


@inlined
def climbing(thrust, u, climb, p):  # type: ignore[no-untyped-def]
    """Thrust of a climbing disc, where that is an effect and not the blades' own."""
    if p[INFLOW] != 0.0:
        ratio = climb / above(u, 0.1) * (p[INFLOW] / p[TIP_SPEED])
        thrust = thrust - thrust * ratio / (above(ratio, ratio * -1.0) + 1.0)
    if p[INFLOW_LIFT] != 0.0:  # blades of lift slope 8 L against momentum: l (l - l_c) + L l = const
        ratio, hover = climb / above(u, 0.1) * (1.0 / p[TIP_SPEED]), p[INFLOW_HOVER]
        half = (p[INFLOW_LIFT] - ratio) * 0.5
        through = root(half * half + (hover * hover + hover * p[INFLOW_LIFT])) - half
        thrust = thrust * through * (through - ratio) * (1.0 / (hover * hover))
    return thrust


@inlined
def grounded(thrust, height, p):  # type: ignore[no-untyped-def]
    """Thrust near the ground, `height` of every disc."""
    if p[GROUND_LAW] == 0.0:
        return thrust + thrust * falling(above(height, 0.0) * (1.0 / p[GROUND_SCALE])) * p[GROUND_GAIN]
    h = above(height, 0.1)
    square = p[GROUND_SCALE] / (h * h)
    if p[GROUND_LAW] == 1.0:  # Cheeseman and Bennett 1955, eq. 1
        return thrust / (1.0 - below(square, 0.3))
    return thrust * cube_root((square + 1.0) * (square + 1.0))  # Hayden 1976


@plain
def cube_root(x):  # type: ignore[no-untyped-def]
    """Of x from 1 to a few hundred, by Halley."""
    y = (x + 2.0) * (1.0 / 3.0)
    for _ in range(8):
        cube = y * y * y
        y = y * (cube + x * 2.0) / (cube * 2.0 + x)
    return y


@inlined
def ceiled(thrust, height, p):  # type: ignore[no-untyped-def]
    """Thrust under a ceiling."""
    left = above(p[CEILING_Z] - height, 0.2 * p[RADIUS]) * (1.0 / p[RADIUS])
    square = p[CEILING_GAIN] / (left * left)
    if p[CEILING_LAW] == 0.0:  # Hsiao and Chirarattananon 2019: momentum theory, 1/8 for one rotor
        return thrust * (root(square + 1.0) * 0.5 + 0.5)
    return thrust / (1.0 - below(square * 0.25, 0.5))  # Sanchez-Cuevas, Heredia and Ollero 2017


@inlined
def dragged(pull, thrust, u, p):  # type: ignore[no-untyped-def]
    """Drag along the disc by speed, mass flow or flapping, where that is an effect."""
    if p[DRAG_LAW] == 0.0:
        return pull + u * p[DRAG]
    scale = p[DRAG] * p[DRAG_SCALE]
    t = above(thrust, 0.0)
    return pull + (root(t) * scale if p[DRAG_LAW] == 1.0 else t / above(u, 0.1) * scale)


@plain
def feet(pd, v, r, rates, p):  # type: ignore[no-untyped-def]
    """Spring, damper and friction under each foot, and at four corners of the top: force and moment."""
    vn, ve, vd = v
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = r
    wx, wy, wz = rates
    fx = fy = fz = mx = my = mz = 0.0
    for corner in range(8):
        cx = (p[FOOT_XY] if corner & 1 else -p[FOOT_XY]) - p[CX]
        cy = (p[FOOT_XY] if corner & 2 else -p[FOOT_XY]) - p[CY]
        cz = (-ROOF_M if corner & 4 else p[FOOT_Z]) - p[CZ]
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


@inlined
def met(v, rates, geo, tilted):  # type: ignore[no-untyped-def]
    """Speed of every hub through the air: along its axis, and along its disc (x, y, z)."""
    vx, vy, vz = v
    wx, wy, wz = rates
    rx, ry, rz, ax, ay, az, _, _, _ = geo
    lx, ly, lz = rz * wy - ry * wz + vx, rx * wz - rz * wx + vy, ry * wx - rx * wy + vz
    climb, lz = lz * -1.0, lz * 0.0
    if tilted is not None:  # decided when it is compiled: most rotors look straight up
        lz = lz - climb
        climb = lx * ax + ly * ay + lz * az
        lx, ly, lz = lx - climb * ax, ly - climb * ay, lz - climb * az
    return climb, lx, ly, lz


@inlined
def leaning(thrust, pull, twist, along, geo, tilted):  # type: ignore[no-untyped-def]
    """Force and moment of all rotors: thrust, drag along the disc, torque about the axis."""
    lx, ly, lz = along
    rx, ry, rz, ax, ay, az, _, _, _ = geo
    hx, hy, hz, tx, ty, tz = pull * lx * -1.0, pull * ly * -1.0, thrust * -1.0, rx, ry, twist
    mx, my, mz = ry * hz - rz * hy, rz * hx - rx * hz, rx * hy - ry * hx + tz
    if tilted is not None:
        hx, hy, hz = thrust * ax + hx, thrust * ay + hy, thrust * az - pull * lz
        tx, ty, tz = twist * ax, twist * ay, twist * az
        mx, my, mz = ry * hz - rz * hy - tx, rz * hx - rx * hz - ty, rx * hy - ry * hx - tz
    return total(hx), total(hy), total(hz), total(mx), total(my), total(mz)


@inlined
def moving(y, flow, u, rate, air, geo, tilted, blades, p):  # type: ignore[no-untyped-def]
    """(force and moment, thrusts, torques, slope of flow): moving air, tilted axes, reactions, feet.

    u, rate: the rotors' normalised speeds and their rates; air: of `turn`; flow: of `blades`.
    """
    (_, _, pd), (vn, ve, vd), (qw, qx, qy, qz), (wx, wy, wz) = y
    rx, ry, rz, ax, ay, az, spin, left, left_torque = geo
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    an, ae, ad = vn - p[WIND], ve - p[WIND + 1], vd - p[WIND + 2]
    vx = r00 * an + r10 * ae + r20 * ad
    vy = r01 * an + r11 * ae + r21 * ad
    vz = r02 * an + r12 * ae + r22 * ad
    climb, lx, ly, lz = met((vx, vy, vz), (wx, wy, wz), geo, tilted)
    thrust, torque, pull, slopes = air[0], air[1], u * 0.0, flow
    if blades is not None:  # decided when it is compiled
        edge2 = lx * lx + ly * ly + lz * lz
        thrust, torque, pull, slopes = blown(flow, air, edge2, climb, blades[0])
        thrust, torque, pull = thrust * left, torque * left_torque, pull * left
    thrust = climbing(thrust, u, climb, p)
    if p[GROUND_GAIN] != 0.0 or p[CEILING_GAIN] != 0.0:
        height = (p[GROUND_Z] - pd) - (rx * r20 + ry * r21 + rz * r22)
        if p[GROUND_GAIN] != 0.0:
            thrust = grounded(thrust, height, p)
        if p[CEILING_GAIN] != 0.0:
            thrust = ceiled(thrust, height, p)
    if p[DRAG] != 0.0:
        pull = dragged(pull, thrust, u, p)
    spun = p[ROTOR_INERTIA] * p[TOP_RATE]
    twist = torque * spin
    if spun != 0.0:
        twist = twist + rate * spin * spun
    fx, fy, fz, tx, ty, tz = leaning(thrust, pull, twist, (lx, ly, lz), geo, tilted)
    if spun != 0.0:
        turn = u * spin * spun
        if tilted is None:
            momentum = total(turn)  # about -z
            tx, ty = tx + wy * momentum, ty - wx * momentum
        if tilted is not None:
            hx, hy, hz = total(turn * ax), total(turn * ay), total(turn * az)
            tx, ty, tz = tx - (wy * hz - wz * hy), ty - (wz * hx - wx * hz), tz - (wx * hy - wy * hx)
    k = -p[BODY_DRAG] * math.sqrt(vx * vx + vy * vy + vz * vz) - p[BODY_LINEAR]
    fx, fy, fz = fx + k * vx + p[PUSH], fy + k * vy + p[PUSH + 1], fz + k * vz + p[PUSH + 2]
    if pd + p[FOOT_Z] + 1.5 * p[FOOT_XY] > p[GROUND_Z]:
        r = (r00, r01, r02, r10, r11, r12, r20, r21, r22)
        gx, gy, gz, nx, ny, nz = feet(pd, (vn, ve, vd), r, (wx, wy, wz), p)
        fx, fy, fz, tx, ty, tz = fx + gx, fy + gy, fz + gz, tx + nx, ty + ny, tz + nz
    return (fx, fy, fz, tx, ty, tz), thrust, torque, slopes
