"""The plant's equations, compiled: rigid body with a quaternion, RK4, rotors, ground, battery.

x = (position NED, velocity NED, quaternion body -> NED, body rates) obeys

    p' = v,   v' = g + R(q) F / m,   q' = q * (0, w) / 2,   w' = I^-1 (M - w x I w)

with F, M (body FRD) summed over the rotors (`forces`): thrust T and torque Q of eq. 17 at the rotors' own
speeds, or of blades in the air they meet (`blades`). Speeds follow the command with a lag that is solved
exactly within a step (`drive`). Where an effect is switched on:
  ground        T (1 + g exp(-h / s)), h the disc's height
  inflow        T (1 - k l / (1 + k |l|)), l = climb speed through the disc / blade tip speed
  rotor drag    -c u (air velocity in the disc), at the hub
  rotor inertia -J (dW/dt) a s - w x (J W a s), W the rotor's rate, a its axis, s its spin
  body drag     -d |v| v against the wind
or its other laws. In calm air, clear of the ground, loads of eq. 17 depend on speeds alone and are summed
once a stage time: that is what makes a step cost 0.1 us. The world is flat: nothing depends on where zero is.
Everything is indexed by `layout`; `plant.py` fills the arrays.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from sim.physics.blades import OPTIONS, inlined, plain
from sim.physics.compile_cache import cached
from sim.physics.drive import follow, lag_of, rates, retarget, supply
from sim.physics.forces import moving, still, turn
from sim.physics.layout import (
    AIR,
    BODY_DRAG,
    BODY_LINEAR,
    CEILING_GAIN,
    CX,
    CY,
    CZ,
    DRAG,
    FOOT_XY,
    FOOT_Z,
    G_AXIS,
    G_POS,
    G_SPEED,
    G_SPIN,
    G_THRUST,
    G_TORQUE,
    GRAVITY,
    GROUND_GAIN,
    GROUND_Z,
    HEAT_SHARE,
    INFLOW,
    INFLOW_LIFT,
    IXX,
    IYY,
    IZZ,
    LAG_LAW,
    MASS,
    O_ALPHA,
    O_FORCE,
    O_THRUST,
    PUSH,
    ROTOR_INERTIA,
    SPEED,
    VOLT_POWER,
    VOLTAGE,
    W_AX,
    W_AY,
    W_AZ,
    W_COMMAND,
    W_FELT,
    W_FLOW,
    W_GQ,
    W_GT,
    W_HEAT,
    W_LED,
    W_LOAD,
    W_OUTER,
    W_ROWS,
    W_SPIN,
    W_U,
    W_X,
    W_Y,
    W_Z,
)
from sim.physics.simd import both, lower, read, write

SUPPLY_EVERY = 4  # steps between two looks at the battery: its own time constant is 20 ms


@inlined
def rigid(y, load, b):  # type: ignore[no-untyped-def]
    """The slope of y = (position, velocity, quaternion, rates) under a force and moment."""
    _, v, (qw, qx, qy, qz), (wx, wy, wz) = y
    fx, fy, fz, mx, my, mz = load
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    return (
        v,
        (
            (r00 * fx + r01 * fy + r02 * fz) * b[0],
            (r10 * fx + r11 * fy + r12 * fz) * b[0],
            (r20 * fx + r21 * fy + r22 * fz) * b[0] + b[7],
        ),
        (
            -0.5 * (qx * wx + qy * wy + qz * wz),
            0.5 * (qw * wx + qy * wz - qz * wy),
            0.5 * (qw * wy + qz * wx - qx * wz),
            0.5 * (qw * wz + qx * wy - qy * wx),
        ),
        (mx * b[1] - b[4] * wy * wz, my * b[2] - b[5] * wz * wx, mz * b[3] - b[6] * wx * wy),
    )


@inlined
def along(y, d, h):  # type: ignore[no-untyped-def]
    """y + h d; y = (position, velocity, quaternion, rates), d its slope."""
    (pn, pe, pd), (vn, ve, vd), (qw, qx, qy, qz), (wx, wy, wz) = y
    (un, ue, ud), (an, ae, ad), (aw, ax, ay, az), (bx, by, bz) = d
    return (
        (pn + h * un, pe + h * ue, pd + h * ud),
        (vn + h * an, ve + h * ae, vd + h * ad),
        (qw + h * aw, qx + h * ax, qy + h * ay, qz + h * az),
        (wx + h * bx, wy + h * by, wz + h * bz),
    )


@inlined
def mean3(a, b, c, d):  # type: ignore[no-untyped-def]
    """Runge and Kutta's mean, times six."""
    return a[0] + 2 * (b[0] + c[0]) + d[0], a[1] + 2 * (b[1] + c[1]) + d[1], a[2] + 2 * (b[2] + c[2]) + d[2]


@inlined
def weighed(y, a, b, c, d, h):  # type: ignore[no-untyped-def]
    """y a step of h on by its four slopes, with a quaternion of length one (by one of Newton's steps)."""
    position, velocity = mean3(a[0], b[0], c[0], d[0]), mean3(a[1], b[1], c[1], d[1])
    f, g, m, n = a[2], b[2], c[2], d[2]
    turned = (
        f[0] + 2 * (g[0] + m[0]) + n[0],
        f[1] + 2 * (g[1] + m[1]) + n[1],
        f[2] + 2 * (g[2] + m[2]) + n[2],
        f[3] + 2 * (g[3] + m[3]) + n[3],
    )
    then = along(y, (position, velocity, turned, mean3(a[3], b[3], c[3], d[3])), h * (1.0 / 6.0))
    qw, qx, qy, qz = then[2]
    k = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)
    return then[0], then[1], (k * qw, k * qx, k * qy, k * qz), then[3]


@inlined
def glide(y, load, u, target, geo, quad, poly, blades, b, half, full, h):  # type: ignore[no-untyped-def]
    """(y, load, speeds, loads) after a step in calm air from its first load: it changes with time alone."""
    a = rigid(y, load, b)
    load = still(turn(target + (u - target) * half[0], geo, quad, poly, blades), geo)
    s = rigid(along(y, a, 0.5 * h), load, b)
    c = rigid(along(y, s, 0.5 * h), load, b)
    u = target + (u - target) * full[0]
    air = turn(u, geo, quad, poly, blades)
    load = still(air, geo)
    d = rigid(along(y, c, h), load, b)
    return weighed(y, a, s, c, d, h), load, u, air


@inlined
def flowed(flow, slopes, h, blades):  # type: ignore[no-untyped-def]
    """What blades induce, after h seconds."""
    if blades is not None:
        flow = (flow[0] + slopes[0] * h, flow[1] + slopes[1] * h)
    return flow


@inlined
def struggle(y, flow, air, u, led, target, geo, tilted, quad, poly, blades, p, b, lag, h):  # type: ignore[no-untyped-def]
    """(y, flow, speeds, what they follow, rotors' numbers, torque) after a step with everything in it."""
    hh = 0.5 * h
    load, _, _, k1 = moving(y, flow, u, rates(u, led, lag), air, geo, tilted, blades, p)
    a = rigid(y, load, b)
    middle, led_middle = follow(u, led, target, lag[1])
    rate = rates(middle, led_middle, lag)
    air = turn(middle, geo, quad, poly, blades)
    then = along(y, a, hh)
    load, _, _, k2 = moving(then, flowed(flow, k1, hh, blades), middle, rate, air, geo, tilted, blades, p)
    s = rigid(then, load, b)
    then = along(y, s, hh)
    load, _, _, k3 = moving(then, flowed(flow, k2, hh, blades), middle, rate, air, geo, tilted, blades, p)
    c = rigid(then, load, b)
    u, led = follow(u, led, target, lag[2])
    air = turn(u, geo, quad, poly, blades)
    then = along(y, c, h)
    load, _, torque, k4 = moving(
        then, flowed(flow, k3, h, blades), u, rates(u, led, lag), air, geo, tilted, blades, p
    )
    d = rigid(then, load, b)
    for k, weight in ((k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)):
        flow = flowed(flow, k, h * weight / 6.0, blades)
    return weighed(y, a, s, c, d, h), flow, u, led, air, torque


@plain
def laid_out(state, command, p, geo, slots, w, n):  # type: ignore[no-untyped-def]
    """Fill the scratch from the vehicle's arrays; whether every axis points straight up."""
    rotors, level = len(command), True
    w[:] = 0.0
    for k in range(n):
        i = slots[k]
        w[W_AZ * n + k] = -1.0
        if i < 0:
            continue
        level = level and geo[G_AXIS + 2, i] == -1.0
        for j in range(3):
            w[(W_X + j) * n + k] = geo[G_POS + j, i] - p[CX + j]
            w[(W_AX + j) * n + k] = geo[G_AXIS + j, i]
        w[W_SPIN * n + k] = geo[G_SPIN, i]
        w[W_GT * n + k], w[W_GQ * n + k] = geo[G_THRUST, i] * p[AIR], geo[G_TORQUE, i] * p[AIR]
        w[W_COMMAND * n + k] = command[i] * geo[G_SPEED, i]
        w[W_U * n + k] = state[SPEED + i]
        w[W_LED * n + k] = state[SPEED + rotors + i]
        w[W_HEAT * n + k] = state[SPEED + 2 * rotors + i]
        w[W_FLOW * n + k] = state[SPEED + 3 * rotors + i]
        w[W_OUTER * n + k] = state[SPEED + 4 * rotors + i]
    return level


@plain
def written_back(state, out, slots, w, n, rotors):  # type: ignore[no-untyped-def]
    """What the scratch holds of each rotor, to the vehicle's arrays."""
    for k in range(n):
        i = slots[k]
        if i >= 0:
            state[SPEED + i] = w[W_U * n + k]
            state[SPEED + rotors + i] = w[W_LED * n + k]
            state[SPEED + 2 * rotors + i] = w[W_HEAT * n + k]
            state[SPEED + 3 * rotors + i] = w[W_FLOW * n + k]
            state[SPEED + 4 * rotors + i] = w[W_OUTER * n + k]
            out[O_THRUST + i], out[O_THRUST + rotors + i] = w[W_FELT * n + k], w[W_LOAD * n + k]


@plain
def sensed(y, load, b, p, out):  # type: ignore[no-untyped-def]
    """The IMU sits at the body origin, which a moved centre of mass leaves behind."""
    wx, wy, wz = y[3]
    ax, ay, az = rigid(y, load, b)[3]
    rx, ry, rz = -p[CX], -p[CY], -p[CZ]
    dot, square = wx * rx + wy * ry + wz * rz, wx * wx + wy * wy + wz * wz
    out[O_FORCE] = load[0] * b[0] + ay * rz - az * ry + wx * dot - rx * square
    out[O_FORCE + 1] = load[1] * b[0] + az * rx - ax * rz + wy * dot - ry * square
    out[O_FORCE + 2] = load[2] * b[0] + ax * ry - ay * rx + wz * dot - rz * square
    out[O_ALPHA], out[O_ALPHA + 1], out[O_ALPHA + 2] = ax, ay, az


@plain
def calm_air(p, blades):  # type: ignore[no-untyped-def]
    """Whether loads depend on speeds alone, clear of the ground and with upright axes."""
    calm = p[INFLOW] == p[DRAG] == p[GROUND_GAIN] == p[ROTOR_INERTIA] == p[BODY_DRAG] == 0.0
    calm = calm and p[INFLOW_LIFT] == p[BODY_LINEAR] == p[CEILING_GAIN] == p[LAG_LAW] == 0.0
    return calm and p[PUSH] == p[PUSH + 1] == p[PUSH + 2] == 0.0 and blades is None


@plain
def run(state, command, p, positions, slots, lanes, tilted, quad, poly, blades, h, steps, out):  # type: ignore[no-untyped-def]
    """`steps` steps of h seconds at constant command (N); state is advanced in place."""
    n = 2 * len(lanes)
    w = np.empty(W_ROWS * n)
    calm = laid_out(state, command, p, positions, slots, w, n) and calm_air(p, blades)
    lag = lag_of(p, h)
    jx, jy, jz = p[IXX], p[IYY], p[IZZ]
    b = (1 / p[MASS], 1 / jx, 1 / jy, 1 / jz, (jz - jy) / jx, (jx - jz) / jy, (jy - jx) / jz, p[GRAVITY])
    bends = p[VOLT_POWER] != 0.0 or p[HEAT_SHARE] != 0.0
    clear = p[GROUND_Z] - p[FOOT_Z] - 1.5 * p[FOOT_XY] - 0.05
    y = (
        (state[0], state[1], state[2]),
        (state[3], state[4], state[5]),
        (state[6], state[7], state[8], state[9]),
        (state[10], state[11], state[12]),
    )
    geo = (
        read(w, W_X, lanes),
        read(w, W_Y, lanes),
        read(w, W_Z, lanes),
        read(w, W_AX, lanes),
        read(w, W_AY, lanes),
        read(w, W_AZ, lanes),
        read(w, W_SPIN, lanes),
        read(w, W_GT, lanes),
        read(w, W_GQ, lanes),
    )
    u, led, demanded, heat = (
        read(w, W_U, lanes),
        read(w, W_LED, lanes),
        read(w, W_COMMAND, lanes),
        read(w, W_HEAT, lanes),
    )
    target = demanded
    if not lag[0]:
        led = target
    flow = read(w, W_FLOW, lanes), lower(read(w, W_OUTER, lanes))
    air = turn(u, geo, quad, poly, blades)
    _, thrust, torque, _ = moving(y, flow, u, u * 0.0, air, geo, tilted, blades, p)
    done = 0
    while done < steps:
        more = min(SUPPLY_EVERY, steps - done)
        if bends:
            target = retarget(demanded, heat, state[VOLTAGE], p)
            if not lag[0]:
                led = target
        heat = supply(state, u, torque, heat, p, h * more)
        if calm and y[0][2] < clear:
            load = still(air, geo)
            for _ in range(more):
                y, load, u, air = glide(y, load, u, target, geo, quad, poly, blades, b, lag[1], lag[2], h)
            torque = air[1]
        else:
            for _ in range(more):
                y, flow, u, led, air, torque = struggle(
                    y, flow, air, u, led, target, geo, tilted, quad, poly, blades, p, b, lag, h
                )
        done += more
    load, thrust, torque, _ = moving(y, flow, u, rates(u, led, lag), air, geo, tilted, blades, p)
    for j in range(3):
        state[j], state[3 + j], state[10 + j] = y[0][j], y[1][j], y[3][j]
    for j in range(4):
        state[6 + j] = y[2][j]
    sensed(y, load, b, p, out)
    write(w, W_U, u)
    write(w, W_LED, led)
    write(w, W_HEAT, heat)
    write(w, W_FLOW, flow[0])
    write(w, W_OUTER, both(flow[1], flow[1]))
    write(w, W_FELT, thrust)
    write(w, W_LOAD, torque)
    written_back(state, out, slots, w, n, len(command))


@cached(**OPTIONS)
def advance(state, command, p, geo, slots, lanes, tilted, quad, poly, blades, h, steps, out):  # type: ignore[no-untyped-def]
    """`run` for one vehicle.

    `lanes` is a tuple whose length is the number of lanes, `slots` (2 lanes) the rotor in each slot or -1;
    `tilted` is None where every axis points straight up;
    of `quad` (coefficients of eq. 17), `poly` (any powers) and `blades` one is not None.
    out: specific force at the body origin (3, m/s^2), angular acceleration (3), thrust (N), torque (N).
    """
    run(state, command, p, geo, slots, lanes, tilted, quad, poly, blades, h, steps, out)


@cached(parallel=True, **OPTIONS)
def advance_many(  # type: ignore[no-untyped-def]
    states, commands, p, geo, slots, lanes, tilted, quad, poly, blades, h, steps, outs
):
    """`advance` of M alike vehicles: states (M, S), commands (M, N), outs (M, 6 + 2 N)."""
    for k in prange(len(states)):
        run(states[k], commands[k], p, geo, slots, lanes, tilted, quad, poly, blades, h, steps, outs[k])
