# mypy: disallow-untyped-defs=False
"""The cascade's equations as functions of gains and memory: position, velocity, attitude, rates.

Nothing here but floats, tuples and indexing: the same functions run on lists in plain Python (`cascade`) and
on arrays where numba compiles them (`sim.quick`). Positions NED in m, rates FRD in rad/s, quaternions
(w, x, y, z) body to NED; `g` holds gains and `m` memory at the places named below.
"""

from __future__ import annotations

import math

G = 9.80665

# gains, three an axis (x, y, z or roll, pitch, yaw)
# fmt: off
(
    POSITION, VELOCITY_P, VELOCITY_I, VELOCITY_D, ATTITUDE, RATE_MAX, RATE_P, RATE_I, RATE_D, RATE_FF,
    RATE_LIMIT,
) = range(0, 33, 3)
(
    FASTEST, CLIMB, SINK, TILT, THRUST_MIN, THRUST_MAX, HOVER, ESTIMATE, HOVER_RANGE, YAW_WEIGHT,
    GYRO_CUTOFF, RATE_CUTOFF, ACCEL_CUTOFF, GAINS,
) = range(33, 47)
# memory, three an axis but for the gyro's filter: four, two readings and two filtered rates of before
(
    M_VELOCITY_I, M_RATE_I, M_ACCEL, M_ALPHA, M_LAST_RATES, M_LAST_VELOCITY, M_WANTED, M_OUT, M_GYRO,
) = range(0, 27, 3)
M_THRUST, M_HOVER, M_MOVED, M_TURNED, MEMORY = range(36, 41)
# fmt: on
# a goal: position, velocity, acceleration, yaw, yaw rate
GOAL = 11
# what the loops want: normalised roll, pitch, yaw and thrust, attitude, body rates
D_THRUST, D_ATTITUDE, D_RATES, DEMAND = 3, 4, 8, 11


def forget(m):
    """Integrals and filters as on the ground; the hover thrust that was learnt stays."""
    for k in range(M_HOVER):
        m[k] = 0.0
    m[M_MOVED] = m[M_TURNED] = 0.0


def accelerate(target, speed, feed, position, velocity, g, m, dt):
    """m[M_OUT:] is the acceleration (m/s^2) for a goal's place, speed and acceleration, NaN for none."""
    for k in range(3):
        wanted = 0.0
        if not math.isnan(target[k]):
            wanted += g[POSITION + k] * (target[k] - position[k])
        if not math.isnan(speed[k]):
            wanted += speed[k]
        m[M_WANTED + k] = wanted
    level = math.hypot(m[M_WANTED], m[M_WANTED + 1])
    if level > g[FASTEST]:
        m[M_WANTED] = m[M_WANTED] * g[FASTEST] / level
        m[M_WANTED + 1] = m[M_WANTED + 1] * g[FASTEST] / level
    m[M_WANTED + 2] = min(max(m[M_WANTED + 2], -g[CLIMB]), g[SINK])
    share = 1.0 - math.exp(-2 * math.pi * g[ACCEL_CUTOFF] * dt)
    full = m[M_THRUST] >= g[THRUST_MAX] - 1e-6 or m[M_THRUST] <= g[THRUST_MIN] + 1e-6
    for k in range(3):
        if m[M_MOVED] != 0.0:
            m[M_ACCEL + k] += share * ((velocity[k] - m[M_LAST_VELOCITY + k]) / dt - m[M_ACCEL + k])
        error = m[M_WANTED + k] - velocity[k]
        out = g[VELOCITY_P + k] * error + m[M_VELOCITY_I + k] - g[VELOCITY_D + k] * m[M_ACCEL + k]
        m[M_OUT + k] = out + (0.0 if math.isnan(feed[k]) else feed[k])
        if not (k == 2 and full):
            step = g[VELOCITY_I + k] * error * dt
            m[M_VELOCITY_I + k] = min(max(m[M_VELOCITY_I + k] + step, -0.5 * G), 0.5 * G)
        m[M_LAST_VELOCITY + k] = velocity[k]
    m[M_MOVED] = 1.0


def point(yaw, attitude, g, m, dt):
    """(collective thrust 0..1, the attitude that points it) for the acceleration in m[M_OUT:]."""
    ax, ay, az = m[M_OUT], m[M_OUT + 1], m[M_OUT + 2]
    x, y, z = -ax, -ay, G  # PX4 tilts for level acceleration against plain gravity
    limit = z * math.tan(g[TILT])
    level = math.hypot(x, y)
    if level > limit:
        x, y = x * limit / level, y * limit / level
    size = math.sqrt(x * x + y * y + z * z)
    bx, by, bz = x / size, y / size, z / size  # body z, pointing down
    up = (m[M_HOVER] - az * m[M_HOVER] / G) / bz
    thrust = min(max(up, g[THRUST_MIN]), g[THRUST_MAX])
    if g[ESTIMATE] != 0.0:
        learn_hover(attitude, g, m, dt)
    m[M_THRUST] = thrust
    # body y as level as the wanted heading allows
    cx, cy = -math.sin(yaw), math.cos(yaw)
    xx, xy, xz = cy * bz, -cx * bz, cx * by - cy * bx
    size = math.sqrt(xx * xx + xy * xy + xz * xz)
    size = size if size > 0.0 else 1.0
    xx, xy, xz = xx / size, xy / size, xz / size
    yx, yy, yz = by * xz - bz * xy, bz * xx - bx * xz, bx * xy - by * xx
    return thrust, matrix_to_quaternion(((xx, yx, bx), (xy, yy, by), (xz, yz, bz)))


def learn_hover(attitude, g, m, dt):
    """Follow the thrust that would hover, slowly, and not far from where it was set."""
    _, x, y, _ = attitude
    upright = 1.0 - 2.0 * (x * x + y * y)
    lift = G - m[M_ACCEL + 2]
    if upright < 0.9 or lift < 5.0 or m[M_THRUST] < 0.1:
        return
    observed = m[M_THRUST] * upright * G / lift
    hover = m[M_HOVER] + (observed - m[M_HOVER]) * dt / 2.0
    low, high = max(g[HOVER] - g[HOVER_RANGE], 0.1), min(g[HOVER] + g[HOVER_RANGE], 0.9)
    m[M_HOVER] = min(max(hover, low), high)


def rates_for(wanted, attitude, yaw_rate, g):
    """Body rates that turn towards `wanted`: the tilt directly; the heading error counts less."""
    error = multiply(conjugate(attitude), wanted)
    tilt = reduced_tilt(error)
    # what remains after the tilt is about body z
    twist = multiply(conjugate(tilt), error)
    weight = g[YAW_WEIGHT]
    half = math.asin(min(max(twist[3] if twist[0] >= 0 else -twist[3], -1.0), 1.0)) * weight
    error = multiply(tilt, (math.cos(half), 0.0, 0.0, math.sin(half)))
    sign = 2.0 if error[0] >= 0 else -2.0
    p, q = sign * error[1] * g[ATTITUDE], sign * error[2] * g[ATTITUDE + 1]
    r = sign * error[3] * g[ATTITUDE + 2] * (1.0 / max(weight, 0.1))
    r += 0.0 if math.isnan(yaw_rate) else yaw_rate
    return (
        min(max(p, -g[RATE_MAX]), g[RATE_MAX]),
        min(max(q, -g[RATE_MAX + 1]), g[RATE_MAX + 1]),
        min(max(r, -g[RATE_MAX + 2]), g[RATE_MAX + 2]),
    )


def turn(wanted, thrust, rates, g, m, dt):
    """m[M_OUT:] is the normalised torque for wanted body rates: P, I with a limit, D on filtered rates."""
    rates = low_passed(rates, g, m, dt)
    share = 1.0 - math.exp(-2 * math.pi * g[RATE_CUTOFF] * dt)
    for k in range(3):
        if m[M_TURNED] != 0.0:
            m[M_ALPHA + k] += share * ((rates[k] - m[M_LAST_RATES + k]) / dt - m[M_ALPHA + k])
        error = wanted[k] - rates[k]
        torque = g[RATE_P + k] * error + m[M_RATE_I + k] - g[RATE_D + k] * m[M_ALPHA + k]
        m[M_OUT + k] = min(max(torque + g[RATE_FF + k] * wanted[k], -1.0), 1.0)
        if thrust > 0.05:
            limit = g[RATE_LIMIT + k]
            step = g[RATE_I + k] * error * dt
            m[M_RATE_I + k] = min(max(m[M_RATE_I + k] + step, -limit), limit)
        m[M_LAST_RATES + k] = rates[k]
    m[M_TURNED] = 1.0


def low_passed(rates, g, m, dt):
    """What the loops see of the gyro: a second-order Butterworth at GYRO_CUTOFF (0: as it is)."""
    cutoff = g[GYRO_CUTOFF]
    if not 0.0 < cutoff < 0.45 / dt:
        return rates
    if m[M_TURNED] == 0.0:
        for k in range(3):
            for j in range(4):
                m[M_GYRO + 4 * k + j] = rates[k]
        return rates
    w = math.tan(math.pi * cutoff * dt)
    denominator = 1.0 + math.sqrt(2.0) * w + w * w
    gain, first = w * w / denominator, 2.0 * (w * w - 1.0) / denominator
    second = (1.0 - math.sqrt(2.0) * w + w * w) / denominator
    for k in range(3):
        at = M_GYRO + 4 * k
        r, x1, y1 = rates[k], m[at], m[at + 2]
        y = gain * (r + 2.0 * x1 + m[at + 1]) - first * y1 - second * m[at + 3]
        m[at], m[at + 1], m[at + 2], m[at + 3] = r, x1, y, y1
    return m[M_GYRO + 2], m[M_GYRO + 6], m[M_GYRO + 10]


def multiply(a, b):
    """Quaternion product."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def conjugate(q):
    """The inverse rotation."""
    return (q[0], -q[1], -q[2], -q[3])


def reduced_tilt(error):
    """The shortest turn that brings body z where `error` would bring it."""
    w, x, y, z = error
    zx, zy, zz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    if zz < -0.9999:
        return (0.0, 1.0, 0.0, 0.0)
    # between (0, 0, 1) and (zx, zy, zz): axis (-zy, zx, 0)
    size = math.sqrt((1 + zz) * (1 + zz) + zx * zx + zy * zy)
    return ((1 + zz) / size, -zy / size, zx / size, 0.0)


def matrix_to_quaternion(r):
    """Quaternion of a rotation matrix (3 rows), w >= 0 (Shepperd)."""
    trace = r[0][0] + r[1][1] + r[2][2]
    if trace > 0:
        s = 2.0 * math.sqrt(trace + 1.0)
        return (s / 4, (r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s)
    if r[0][0] >= r[1][1] and r[0][0] >= r[2][2]:
        s = 2.0 * math.sqrt(max(1.0 + r[0][0] - r[1][1] - r[2][2], 1e-12))
        w, x, y, z = (r[2][1] - r[1][2]) / s, s / 4, (r[1][0] + r[0][1]) / s, (r[2][0] + r[0][2]) / s
    elif r[1][1] >= r[2][2]:
        s = 2.0 * math.sqrt(max(1.0 + r[1][1] - r[2][2] - r[0][0], 1e-12))
        w, x, y, z = (r[0][2] - r[2][0]) / s, (r[0][1] + r[1][0]) / s, s / 4, (r[2][1] + r[1][2]) / s
    else:
        s = 2.0 * math.sqrt(max(1.0 + r[2][2] - r[0][0] - r[1][1], 1e-12))
        w, x, y, z = (r[1][0] - r[0][1]) / s, (r[0][2] + r[2][0]) / s, (r[1][2] + r[2][1]) / s, s / 4
    if w >= 0:
        return (w, x, y, z)
    return (-w, -x, -y, -z)


def euler(q):
    """Roll, pitch, yaw, rad."""
    w, x, y, z = q
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
