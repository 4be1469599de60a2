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

# state vector: rigid body first, then the pack, then what each rotor has
POS, VEL, QUAT, RATE = 0, 3, 6, 10
CHARGE, VOLTAGE, CURRENT, RELAXED, SPEED = 13, 14, 15, 16, 18
PER_ROTOR = 2  # normalised speed; what the speed follows, where the lag is of second order

# parameter vector; a _LAW counts as `effects.FORMS` lists them
# fmt: off
(
    MASS, IXX, IYY, IZZ, GRAVITY, GROUND_Z, LAG, TOP_RATE, TIP_SPEED, CX, CY, CZ, GROUND_GAIN,
    GROUND_SCALE, INFLOW, DRAG, ROTOR_INERTIA, BODY_DRAG, WIND, _WIND_E, _WIND_D, VOLT_POWER, VOLT_REF,
    CELLS, CAPACITY, RESISTANCE, EFFICIENCY, FOOT_XY, FOOT_Z, GROUND_LAW, INFLOW_HOVER, INFLOW_LIFT,
    DRAG_LAW, DRAG_SCALE, LAG_LAW, LAG_RATIO, VOLT_LAW, VOLT_SHARE, PACK_LAW, BODY_LINEAR, PARAMETERS,
) = range(41)
# fmt: on

# geometry, a row a quantity and a column a rotor
G_POS, G_AXIS, G_SPIN, G_THRUST, G_TORQUE, G_SPEED = 0, 3, 6, 7, 8, 9
GEOMETRY = 10

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
def ground_gain(height, p):  # type: ignore[no-untyped-def]
    """Thrust over free thrust, `height` (m) above the ground."""
    h = max(height, 0.0)
    if p[GROUND_LAW] == 0.0:
        return 1.0 + p[GROUND_GAIN] * math.exp(-h / p[GROUND_SCALE])
    square = p[GROUND_SCALE] / max(h * h, 0.01)
    if p[GROUND_LAW] == 1.0:  # Cheeseman and Bennett 1955, eq. 1
        return 1.0 / (1.0 - min(square, 0.3))
    return (1.0 + square) ** (2.0 / 3.0)  # Hayden 1976


@njit(cache=True, error_model="numpy")
def inflow_share(climb, u, p):  # type: ignore[no-untyped-def]
    """Thrust over thrust at rest, the disc climbing at `climb` (m/s)."""
    ratio = climb / (p[TIP_SPEED] * max(u, 0.1))
    share = 1.0 - p[INFLOW] * ratio / (1.0 + abs(p[INFLOW] * ratio))
    if p[INFLOW_LIFT] != 0.0:  # blades of lift slope 8 L against momentum: l (l - l_c) + L l = const
        hover, half = p[INFLOW_HOVER], 0.5 * (p[INFLOW_LIFT] - ratio)
        through = math.sqrt(half * half + hover * hover + hover * p[INFLOW_LIFT]) - half
        share *= through * (through - ratio) / (hover * hover)
    return share


@njit(cache=True, error_model="numpy")
def drag_weight(u, thrust, p):  # type: ignore[no-untyped-def]
    """What the drag in the rotor's plane goes with: its speed, its mass flow, its flapping."""
    if p[DRAG_LAW] == 0.0:
        return u
    t = max(thrust, 0.0)
    return p[DRAG_SCALE] * (math.sqrt(t) if p[DRAG_LAW] == 1.0 else t / max(u, 0.1))


@njit(cache=True, error_model="numpy")
def speed_gain(volts, u, p):  # type: ignore[no-untyped-def]
    """Speed over commanded speed u, at the supply's voltage."""
    v = volts / p[VOLT_REF]
    if p[VOLT_LAW] == 0.0:
        return v ** p[VOLT_POWER]
    if p[VOLT_LAW] == 1.0:  # back-EMF and resistance: (1 - r) y + r y^2 = v, r its share at this load
        r = max(p[VOLT_SHARE] * u, 1e-6)
        y = (math.sqrt((1.0 - r) * (1.0 - r) + 4.0 * r * v) - (1.0 - r)) / (2.0 * r)
        return 1.0 + p[VOLT_POWER] * (y - 1.0)
    return 1.0 + p[VOLT_POWER] * (v - 1.0)


@njit(cache=True, error_model="numpy")
def moving(pose, u, rate, p, geo, thrust, torque, felt):  # type: ignore[no-untyped-def]
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
    k = -p[BODY_DRAG] * math.sqrt(vx * vx + vy * vy + vz * vz) - p[BODY_LINEAR]
    fx, fy, fz = k * vx, k * vy, k * vz
    mx = my = mz = 0.0
    for i in range(len(u)):
        t, q, spin = thrust[i], torque[i], geo[G_SPIN, i]
        ax, ay, az = geo[G_AXIS, i], geo[G_AXIS + 1, i], geo[G_AXIS + 2, i]
        rx, ry, rz = geo[G_POS, i] - p[CX], geo[G_POS + 1, i] - p[CY], geo[G_POS + 2, i] - p[CZ]
        lx, ly, lz = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx
        climb = lx * ax + ly * ay + lz * az
        t *= inflow_share(climb, u[i], p)
        if p[GROUND_GAIN] != 0.0:
            height = p[GROUND_Z] - pd - (r20 * rx + r21 * ry + r22 * rz)
            t *= ground_gain(height, p)
        k = -p[DRAG] * drag_weight(u[i], t, p)
        hx = t * ax + k * (lx - climb * ax)
        hy = t * ay + k * (ly - climb * ay)
        hz = t * az + k * (lz - climb * az)
        mx += ry * hz - rz * hy - q * spin * ax
        my += rz * hx - rx * hz - q * spin * ay
        mz += rx * hy - ry * hx - q * spin * az
        if p[ROTOR_INERTIA] != 0.0:
            up = -p[ROTOR_INERTIA] * spin * p[TOP_RATE] * rate[i]
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


@njit(cache=True, error_model="numpy")
def shepherd(cells, charge, current, capacity):  # type: ignore[no-untyped-def]
    """Voltage (V) before its resistance by Shepherd 1965: polarisation grows as the charge goes."""
    spent = 1.0 - charge
    left = max(charge, 0.02)
    drawn = current * 360.0 / capacity  # filtered current, over a tenth of an hour's
    return cells * (3.80 - 0.012 * (spent + 0.1 * drawn) / left + 0.36 * math.exp(-4.0 * spent))


@njit(cache=True, error_model="numpy", fastmath=FAST)
def supply(state, u, torque, p, h):  # type: ignore[no-untyped-def]
    """Current, charge and voltage `h` seconds on; in place."""
    power = 0.0
    for i in range(len(u)):
        power += torque[i] * u[i]
    volts = max(state[VOLTAGE], 1.0)
    current = 1.0 + max(power, 0.0) * p[TOP_RATE] / (p[EFFICIENCY] * volts)
    state[CURRENT] = current
    state[CHARGE] = max(state[CHARGE] - current * h / p[CAPACITY], 0.0)
    drop = p[RESISTANCE] * current
    if p[PACK_LAW] == 0.0:
        rest = open_circuit(p[CELLS], state[CHARGE]) - drop
    elif p[PACK_LAW] == 1.0:  # half at once, the rest by two RC pairs of 3 s and 40 s
        for j, (share, lag) in enumerate(((0.25, 3.0), (0.25, 40.0))):
            state[RELAXED + j] += (share * drop - state[RELAXED + j]) * min(h / lag, 1.0)
        rest = open_circuit(p[CELLS], state[CHARGE]) - 0.5 * drop - state[RELAXED] - state[RELAXED + 1]
    else:
        state[RELAXED] += (current - state[RELAXED]) * min(h / 10.0, 1.0)
        rest = shepherd(p[CELLS], state[CHARGE], state[RELAXED], p[CAPACITY]) - drop
    state[VOLTAGE] += (rest - state[VOLTAGE]) * min(h / 0.02, 1.0)


@njit(cache=True, error_model="numpy")
def lag_of(p):  # type: ignore[no-untyped-def]
    """(time constant s, whether there are two in a row, its factor for speeding up, for slowing down)."""
    if p[LAG_LAW] == 1.0:
        return 0.5 * p[LAG], True, 1.0, 1.0
    if p[LAG_LAW] == 2.0:  # slower down than up, the mean as it was
        return p[LAG], False, 2.0 / (1.0 + p[LAG_RATIO]), 2.0 * p[LAG_RATIO] / (1.0 + p[LAG_RATIO])
    return p[LAG], False, 1.0, 1.0


@njit(cache=True, error_model="numpy")
def follow(u, led, target, lag, h):  # type: ignore[no-untyped-def]
    """Speed, and what it follows, `h` seconds on: the lag's own solution for a constant target."""
    pole, second, rising, falling = lag
    pole *= rising if target > u else falling
    if pole <= 0.0:
        return target, target
    keep, d, e = math.exp(-h / pole), u - target, led - target
    if second:
        return target + (d + e * h / pole) * keep, target + e * keep
    return target + d * keep, target


@njit(cache=True, error_model="numpy")
def fill_rates(rate, u, led, target, lag):  # type: ignore[no-untyped-def]
    """Normalised speed per second of every rotor."""
    pole, second, rising, falling = lag
    for i in range(len(u)):
        way = (led[i] if second else target[i]) - u[i]
        rate[i] = way / (pole * (rising if way > 0.0 else falling)) if pole > 0.0 else 0.0


@njit(cache=True, error_model="numpy", fastmath=FAST)
def advance(state, command, p, geo, pairs, singles, c, h, steps, out):  # type: ignore[no-untyped-def]
    """`steps` steps of h seconds at constant command (N); state is advanced in place.

    out: specific force at the body origin (3, m/s^2), angular acceleration (3), thrust (N), torque (N).
    """
    n = len(command)
    u, middle, target = state[SPEED : SPEED + n].copy(), np.empty(n), np.empty(n)
    led, led_middle, rate = state[SPEED + n : SPEED + 2 * n].copy(), np.empty(n), np.zeros(n)
    lag = lag_of(p)
    plain, reacts = p[LAG_LAW] == 0.0, p[ROTOR_INERTIA] != 0.0
    keep = math.exp(-h / p[LAG]) if p[LAG] > 0 else 0.0
    keep_half = math.exp(-0.5 * h / p[LAG]) if p[LAG] > 0 else 0.0
    thrust, torque, felt = np.empty(n), np.empty(n), np.empty(n)
    jx, jy, jz = p[IXX], p[IYY], p[IZZ]
    b = (1 / p[MASS], 1 / jx, 1 / jy, 1 / jz, (jz - jy) / jx, (jx - jz) / jy, (jy - jx) / jz, p[GRAVITY])
    pn, pe, pd, vn, ve, vd = state[0], state[1], state[2], state[3], state[4], state[5]
    qw, qx, qy, qz, wx, wy, wz = state[6], state[7], state[8], state[9], state[10], state[11], state[12]
    calm = p[INFLOW] == p[DRAG] == p[GROUND_GAIN] == p[ROTOR_INERTIA] == p[BODY_DRAG] == 0.0
    calm = calm and p[INFLOW_LIFT] == p[BODY_LINEAR] == 0.0
    for i in range(n):
        calm = calm and geo[G_AXIS + 2, i] == -1.0
        target[i] = command[i] * geo[G_SPEED, i]
    clear = p[GROUND_Z] - p[FOOT_Z] - 1.5 * p[FOOT_XY] - 0.05
    hh, h6 = 0.5 * h, h / 6.0
    loads(u, pairs, singles, c, geo, thrust, torque)
    for step in range(steps):
        if step % SUPPLY_EVERY == 0:
            if p[VOLT_POWER] != 0.0:
                for i in range(n):
                    target[i] = command[i] * geo[G_SPEED, i] * speed_gain(state[VOLTAGE], command[i], p)
            supply(state, u, torque, p, h * min(SUPPLY_EVERY, steps - step))
        free = calm and pd < clear
        if free:
            load = still(thrust, torque, geo, p)
        else:
            pose = (pd, vn, ve, vd, qw, qx, qy, qz, wx, wy, wz)
            if reacts:
                fill_rates(rate, u, led, target, lag)
            load = moving(pose, u, rate, p, geo, thrust, torque, felt)
        an, ae, ad, aw, ax, ay, az, awx, awy, awz = rigid(qw, qx, qy, qz, wx, wy, wz, load, b)
        if plain:
            for i in range(n):
                d = u[i] - target[i]
                middle[i] = target[i] + d * keep_half
                u[i] = target[i] + d * keep

        else:
            for i in range(n):
                middle[i], led_middle[i] = follow(u[i], led[i], target[i], lag, hh)
                u[i], led[i] = follow(u[i], led[i], target[i], lag, h)
        if reacts:
            fill_rates(rate, middle, led_middle, target, lag)
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
            load = moving(pose, middle, rate, p, geo, thrust, torque, felt)
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
            load = moving(pose, middle, rate, p, geo, thrust, torque, felt)
        cn, ce, cd, cw, cx, cy, cz, cwx, cwy, cwz = rigid(w, x, y, z, r, s, t, load, b)
        if reacts:
            fill_rates(rate, u, led, target, lag)
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
            load = moving(pose, u, rate, p, geo, thrust, torque, felt)
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
        state[SPEED + i], state[SPEED + n + i] = u[i], led[i]
    pose = (pd, vn, ve, vd, qw, qx, qy, qz, wx, wy, wz)
    fill_rates(rate, u, led, target, lag)
    load = moving(pose, u, rate, p, geo, thrust, torque, felt)
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
