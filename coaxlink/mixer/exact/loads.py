# mypy: disallow-untyped-defs=False
"""Loads of the rotors and their slopes, and the places of all scratch numbers (see `exact.kernel`)."""

from __future__ import annotations

from math import sqrt

# a row of `work`: wrench (4), power, slopes of power, Hessian of the Lagrangian, slopes of the wrench,
# H^-1 J^T over the free speeds, the step's part that does not depend on the prices, the step
ARM = 30
P, GU, GL, HUU, HUL, HLL, JU, JL, YU, YL, BU, BL, DU, DL = 4, 5, 6, 7, 8, 9, 10, 14, 18, 22, 26, 27, 28, 29
# in `sums`: Schur complement (10, lower triangle by rows), its factor (10), right side (4),
# wrench missing (4), power (1), slope of the dual (4), prices kept (4)
FACTOR, RIGHT, MISS, POWER, SLOPE, KEEP, SUMS = 10, 20, 24, 28, 29, 33, 37

CURVATURE = 0.05  # least curvature of a block


def surface(c, nu, nl, u, l):  # noqa: E741
    """(f, f_u, f_l, f_uu, f_ul, f_ll) of the coefficients, by rows of powers of u."""
    if nu == 2 and nl == 2:
        b1, b2 = c[1], c[2]
        m1, m2 = c[4], c[5]
        h1, h2 = c[7], c[8]
        t2 = h2 * l
        r0 = c[0] + l * (b1 + l * b2)
        r1 = c[3] + l * (m1 + l * m2)
        r2 = c[6] + l * (h1 + h2 * l)
        s1 = m1 + 2.0 * l * m2
        s2 = h1 + 2.0 * t2
        return (
            r0 + u * (r1 + u * r2),
            r1 + 2.0 * u * r2,
            b1 + 2.0 * l * b2 + u * (s1 + u * s2),
            2.0 * r2,
            s1 + 2.0 * u * s2,
            2.0 * (b2 + u * (m2 + u * h2)),
        )
    p0 = p1 = p2 = q0 = q1 = s0 = 0.0
    for a in range(nu, -1, -1):
        v0 = v1 = v2 = 0.0
        for b in range(nl, -1, -1):
            v2 = v2 * l + v1
            v1 = v1 * l + v0
            v0 = v0 * l + c[a * (nl + 1) + b]
        p2 = p2 * u + p1
        p1 = p1 * u + p0
        p0 = p0 * u + v0
        q1 = q1 * u + q0
        q0 = q0 * u + v1
        s0 = s0 * u + v2
    return p0, p1, q0, 2.0 * p2, q1, 2.0 * s0


def value(c, nu, nl, u, l):  # noqa: E741
    """f alone."""
    if nu == 2 and nl == 2:
        return (
            c[0] + l * (c[1] + l * c[2])
            + u * (c[3] + l * (c[4] + l * c[5]) + u * (c[6] + l * (c[7] + l * c[8])))
        )  # fmt: skip
    total = 0.0
    for a in range(nu, -1, -1):
        row = 0.0
        for b in range(nl, -1, -1):
            row = row * l + c[a * (nl + 1) + b]
        total = total * u + row
    return total


def line(c, u):
    """`surface` of a quadratic in u alone (nu = nl = 2)."""
    a1, a2 = c[3], c[6]
    t = a2 * u
    return c[0] + u * (a1 + t), a1 + 2.0 * t, 2.0 * a2


def value_of_one(c, u):
    """`value` of a quadratic in u alone (nu = nl = 2)."""
    return c[0] + u * (c[3] + u * c[6])


def expand_arm(c, g, shape, k, u, l, lam, work):  # noqa: E741
    """Second-order expansion of arm k at (u, l): wrench, power, the Lagrangian's Hessian made positive."""
    nu, nl = shape[1], shape[2]
    load, gain, arm = c[k], g[k], work[k]
    l0, l1, l2, l3 = lam[0], lam[1], lam[2], lam[3]
    if shape[3]:
        f, fu, fuu = line(load[0], u)
        q, qu, quu = line(load[1], u)
        fl = ful = fll = ql = qul = qll = 0.0
    else:
        f, fu, fl, fuu, ful, fll = surface(load[0], nu, nl, u, l)
        q, qu, ql, quu, qul, qll = surface(load[1], nu, nl, u, l)
    F, Fu, Fl, Fuu, Ful, Fll = surface(load[2], nu, nl, u, l)
    Q, Qu, Ql, Quu, Qul, Qll = surface(load[3], nu, nl, u, l)
    a0, a1, a2, a3, b0, b1, b2, b3, d0, d1, d2, d3, h0, h1, h2, h3 = (
        gain[0], gain[1], gain[2], gain[3], gain[4], gain[5], gain[6], gain[7],
        gain[8], gain[9], gain[10], gain[11], gain[12], gain[13], gain[14], gain[15],
    )  # fmt: skip
    arm[0], arm[1], arm[2], arm[3] = (
        a0 * f + b0 * q + d0 * F + h0 * Q, a1 * f + b1 * q + d1 * F + h1 * Q,
        a2 * f + b2 * q + d2 * F + h2 * Q, a3 * f + b3 * q + d3 * F + h3 * Q,
    )  # fmt: skip
    arm[JU], arm[JU + 1], arm[JU + 2], arm[JU + 3] = (
        a0 * fu + b0 * qu + d0 * Fu + h0 * Qu, a1 * fu + b1 * qu + d1 * Fu + h1 * Qu,
        a2 * fu + b2 * qu + d2 * Fu + h2 * Qu, a3 * fu + b3 * qu + d3 * Fu + h3 * Qu,
    )  # fmt: skip
    arm[JL], arm[JL + 1], arm[JL + 2], arm[JL + 3] = (
        d0 * Fl + h0 * Ql, d1 * Fl + h1 * Ql, d2 * Fl + h2 * Ql, d3 * Fl + h3 * Ql,
    )  # fmt: skip
    a = l0 * a0 + l1 * a1 + l2 * a2 + l3 * a3
    b = l0 * b0 + l1 * b1 + l2 * b2 + l3 * b3
    d = l0 * d0 + l1 * d1 + l2 * d2 + l3 * d3
    h = l0 * h0 + l1 * h1 + l2 * h2 + l3 * h3
    # power is q u + Q l: the torques' weights in it are the speeds themselves, less what their yaw is worth
    arm[P] = q * u + Q * l
    arm[GU] = q + qu * u + Qu * l
    arm[GL] = Q + Ql * l
    b, h = u - b, l - h
    uu = 2.0 * qu + b * quu + h * Quu - a * fuu - d * Fuu
    ul = Qu + h * Qul - d * Ful
    ll = 2.0 * Ql + h * Qll - d * Fll
    if not shape[3]:
        arm[JL] += a0 * fl + b0 * ql
        arm[JL + 1] += a1 * fl + b1 * ql
        arm[JL + 2] += a2 * fl + b2 * ql
        arm[JL + 3] += a3 * fl + b3 * ql
        arm[GL] += ql * u
        ul += ql + b * qul - a * ful
        ll += b * qll - a * fll
    if uu < CURVATURE or ll < CURVATURE or (uu - CURVATURE) * (ll - CURVATURE) < ul * ul:
        half = 0.5 * (uu - ll)
        shift = CURVATURE - 0.5 * (uu + ll) + sqrt(half * half + ul * ul)
        uu += shift
        ll += shift
    arm[HUU], arm[HUL], arm[HLL] = uu, ul, ll


def expand(c, g, shape, x, lam, mu, work, sums):
    """`expand_arm` for all arms, and the wrench missing at x."""
    m0, m1, m2, m3 = mu[0], mu[1], mu[2], mu[3]
    for k in range(shape[0]):
        arm = work[k]
        expand_arm(c, g, shape, k, x[2 * k], x[2 * k + 1], lam, work)
        m0 -= arm[0]
        m1 -= arm[1]
        m2 -= arm[2]
        m3 -= arm[3]
    sums[MISS], sums[MISS + 1], sums[MISS + 2], sums[MISS + 3] = m0, m1, m2, m3


def miss(c, g, shape, x, mu, sums):
    """The wrench still missing at x into MISS, the power into POWER; returns the largest miss of an axis."""
    nu, nl = shape[1], shape[2]
    m0, m1, m2, m3, power = mu[0], mu[1], mu[2], mu[3], 0.0
    for k in range(shape[0]):
        u, l = x[2 * k], x[2 * k + 1]  # noqa: E741
        load, gain = c[k], g[k]
        if shape[3]:
            f, q = value_of_one(load[0], u), value_of_one(load[1], u)
        else:
            f, q = value(load[0], nu, nl, u, l), value(load[1], nu, nl, u, l)
        F, Q = value(load[2], nu, nl, u, l), value(load[3], nu, nl, u, l)
        m0 -= gain[0] * f + gain[4] * q + gain[8] * F + gain[12] * Q
        m1 -= gain[1] * f + gain[5] * q + gain[9] * F + gain[13] * Q
        m2 -= gain[2] * f + gain[6] * q + gain[10] * F + gain[14] * Q
        m3 -= gain[3] * f + gain[7] * q + gain[11] * F + gain[15] * Q
        power += q * u + Q * l
    sums[MISS], sums[MISS + 1], sums[MISS + 2], sums[MISS + 3] = m0, m1, m2, m3
    sums[POWER] = power
    return max(abs(m0), abs(m1), abs(m2), abs(m3))


def merit(cap, sums):
    """Power plus the price of what is missing, of the last `miss`."""
    return (
        sums[POWER]
        + cap[0] * abs(sums[MISS]) + cap[1] * abs(sums[MISS + 1])
        + cap[2] * abs(sums[MISS + 2]) + cap[3] * abs(sums[MISS + 3])
    )  # fmt: skip


def move(arms, x, lo, hi, work):
    """Take the step, inside the bounds."""
    for k in range(arms):
        arm, i = work[k], 2 * k
        x[i] = min(max(x[i] + arm[DU], lo[i]), hi[i])
        x[i + 1] = min(max(x[i + 1] + arm[DL], lo[i + 1]), hi[i + 1])


def largest_step(arms, work):
    """The largest part of the present step."""
    largest = 0.0
    for k in range(arms):
        arm = work[k]
        largest = max(largest, abs(arm[DU]), abs(arm[DL]))
    return largest


def worst_met(el, sums):
    """Largest miss among the axes that are not given up."""
    worst = 0.0
    for j in range(4):
        if el[j] == 0:
            worst = max(worst, abs(sums[MISS + j]))
    return worst
