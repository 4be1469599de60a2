# mypy: disallow-untyped-defs=False
"""The exact law's arithmetic: least power for a wrench on polynomial rotors, speeds between bounds.

    min P(x) = sum_k q_u u_u + q_l u_l   subject to   W(x) = mu,   lo <= x <= hi

with strict priorities when no x delivers mu: axis j may be missed at the price of w_j |mu_j - W_j|, prices a
hundredfold apart (an exact penalty), so a lower axis is given up before a higher one is touched.

Sequential quadratic programming. The Hessian of the Lagrangian is a 2 x 2 block an arm, so a step is a sum
over arms of 4 x 4 Schur complements and one Cholesky factor; bounds and given-up axes are settled by a
primal-dual active set that starts from the last call's. A step is closed by corrections that reuse the
factor until the wrench error is gone.

Nothing here but floats, indexing and loops, and no allocation: the same functions run on lists in plain
Python and on arrays when numba compiles them (`exact.compiled`). Everything is normalised by `exact.problem`:
axes in order of priority and in units of the vehicle's authority, power in units of full power.

Arrays, K arms; a single rotor is an arm whose second speed is held at 0:
    c (K, 4, T)    coefficients of upper thrust, upper torque, lower thrust, lower torque; T = (nu+1)(nl+1)
    g (K, 16)      wrench of a unit of each load, 4 loads x 4 axes
    shape (4)      K, nu, nl, 1 if nu = nl = 2 and the upper rotor is deaf to the lower one
    lo, hi, x (2K) bounds and speeds, u_u then u_l of each arm
    act (2K)       -1 at lo, 0 free, 1 at hi
    lam, el (4)    price of each axis; 0 met, +1 given up below mu, -1 given up above mu
    cap, mu (4)    price caps, the wrench asked for
    work (K, ARM), sums (SUMS), box (6K)   scratch

Rows and constant places rather than computed offsets: both Python and the compiler are quicker at them.
"""

from __future__ import annotations

# a row of `work`: wrench (4), power, slopes of power, Hessian of the Lagrangian, slopes of the wrench,
# H^-1 J^T over the free speeds, the step's part that does not depend on the prices, the step
ARM = 30
P, GU, GL, HUU, HUL, HLL, JU, JL, YU, YL, BU, BL, DU, DL = 4, 5, 6, 7, 8, 9, 10, 14, 18, 22, 26, 27, 28, 29
# in `sums`: Schur complement (10, lower triangle by rows), its Cholesky factor (10), right side (4),
# wrench missing (4), power (1), slope of the dual (4), prices kept (4)
FACTOR, RIGHT, MISS, POWER, SLOPE, KEEP, SUMS = 10, 20, 24, 28, 29, 33, 37

NO_PIVOT = 1e-14
TINY_PIVOT = 1e-9  # of the Schur complement: the axis cannot be moved by the rotors still free
STEP_DONE = 2e-3  # the next quadratic step would be about its square
GIVEN_UP_DONE = 1e-6  # with axes given up the steps need not be quadratic
MISS_DONE = 1e-9  # of the vehicle's authority
RIDGE = 1e-9  # on the Schur complement where the free rotors cannot move an axis
CLIMBS, CUTS = 30, 40  # Newton steps on the dual; trials along each
ROUNDS = 6  # active-set rounds of one quadratic step
CORRECTIONS = 3
PERSIST = 60
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
    a, b, d, h = gain[0], gain[4], gain[8], gain[12]
    arm[0] = a * f + b * q + d * F + h * Q
    arm[JU + 0] = a * fu + b * qu + d * Fu + h * Qu
    arm[JL + 0] = a * fl + b * ql + d * Fl + h * Ql
    a, b, d, h = gain[1], gain[5], gain[9], gain[13]
    arm[1] = a * f + b * q + d * F + h * Q
    arm[JU + 1] = a * fu + b * qu + d * Fu + h * Qu
    arm[JL + 1] = a * fl + b * ql + d * Fl + h * Ql
    a, b, d, h = gain[2], gain[6], gain[10], gain[14]
    arm[2] = a * f + b * q + d * F + h * Q
    arm[JU + 2] = a * fu + b * qu + d * Fu + h * Qu
    arm[JL + 2] = a * fl + b * ql + d * Fl + h * Ql
    a, b, d, h = gain[3], gain[7], gain[11], gain[15]
    arm[3] = a * f + b * q + d * F + h * Q
    arm[JU + 3] = a * fu + b * qu + d * Fu + h * Qu
    arm[JL + 3] = a * fl + b * ql + d * Fl + h * Ql
    a = l0 * gain[0] + l1 * gain[1] + l2 * gain[2] + l3 * gain[3]
    b = l0 * gain[4] + l1 * gain[5] + l2 * gain[6] + l3 * gain[7]
    d = l0 * gain[8] + l1 * gain[9] + l2 * gain[10] + l3 * gain[11]
    h = l0 * gain[12] + l1 * gain[13] + l2 * gain[14] + l3 * gain[15]
    # power is q u + Q l: the torques' weights in it are the speeds themselves, less what their yaw is worth
    arm[P] = q * u + Q * l
    arm[GU] = q + qu * u + Qu * l
    arm[GL] = Q + ql * u + Ql * l
    b, h = u - b, l - h
    uu = 2.0 * qu + b * quu + h * Quu - a * fuu - d * Fuu
    ul = ql + Qu + b * qul + h * Qul - a * ful - d * Ful
    ll = 2.0 * Ql + b * qll + h * Qll - a * fll - d * Fll
    mean, half = 0.5 * (uu + ll), 0.5 * (uu - ll)
    least = mean - (half * half + ul * ul) ** 0.5
    shift = CURVATURE - least if least < CURVATURE else 0.0
    arm[HUU] = uu + shift
    arm[HUL] = ul
    arm[HLL] = ll + shift


def miss(c, g, shape, x, mu, sums):
    """The wrench still missing at x into MISS, the power into POWER; returns the largest miss of an axis."""
    nu, nl = shape[1], shape[2]
    m0, m1, m2, m3, power = mu[0], mu[1], mu[2], mu[3], 0.0
    for k in range(shape[0]):
        u, l = x[2 * k], x[2 * k + 1]  # noqa: E741
        load, gain = c[k], g[k]
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


def reduce_arm(arm, i, x, lo, hi, act):
    """The arm's step as B + Y lam for the present active set; adds its share to the Schur complement."""
    uu, ul, ll = arm[HUU], arm[HUL], arm[HLL]
    gu, gl = arm[GU], arm[GL]
    if act[i] == 0 and act[i + 1] == 0:
        det = uu * ll - ul * ul
        a, b, d = ll / det, -ul / det, uu / det
        bu, bl = -(a * gu + b * gl), -(b * gu + d * gl)
    else:
        a = b = d = 0.0
        bu = (lo[i] if act[i] < 0 else hi[i]) - x[i]
        bl = (lo[i + 1] if act[i + 1] < 0 else hi[i + 1]) - x[i + 1]
        if act[i] == 0:
            a = 1.0 / uu
            bu = -a * (gu + ul * bl)
        elif act[i + 1] == 0:
            d = 1.0 / ll
            bl = -d * (gl + ul * bu)
    u0, u1, u2, u3 = arm[JU], arm[JU + 1], arm[JU + 2], arm[JU + 3]
    l0, l1, l2, l3 = arm[JL], arm[JL + 1], arm[JL + 2], arm[JL + 3]
    y0, y1, y2, y3 = a * u0 + b * l0, a * u1 + b * l1, a * u2 + b * l2, a * u3 + b * l3
    z0, z1, z2, z3 = b * u0 + d * l0, b * u1 + d * l1, b * u2 + d * l2, b * u3 + d * l3
    arm[YU], arm[YU + 1], arm[YU + 2], arm[YU + 3] = y0, y1, y2, y3
    arm[YL], arm[YL + 1], arm[YL + 2], arm[YL + 3] = z0, z1, z2, z3
    arm[BU], arm[BL] = bu, bl
    return (
        u0 * y0 + l0 * z0,
        u1 * y0 + l1 * z0, u1 * y1 + l1 * z1,
        u2 * y0 + l2 * z0, u2 * y1 + l2 * z1, u2 * y2 + l2 * z2,
        u3 * y0 + l3 * z0, u3 * y1 + l3 * z1, u3 * y2 + l3 * z2, u3 * y3 + l3 * z3,
        u0 * bu + l0 * bl, u1 * bu + l1 * bl, u2 * bu + l2 * bl, u3 * bu + l3 * bl,
    )  # fmt: skip


def assemble(arms, x, lo, hi, act, work, sums):
    """Schur complement and right side over all arms."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = 0.0
    r0, r1, r2, r3 = sums[MISS], sums[MISS + 1], sums[MISS + 2], sums[MISS + 3]
    for k in range(arms):
        a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, b0, b1, b2, b3 = reduce_arm(work[k], 2 * k, x, lo, hi, act)
        s0 += a0
        s1 += a1
        s2 += a2
        s3 += a3
        s4 += a4
        s5 += a5
        s6 += a6
        s7 += a7
        s8 += a8
        s9 += a9
        r0 -= b0
        r1 -= b1
        r2 -= b2
        r3 -= b3
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4
    sums[5], sums[6], sums[7], sums[8], sums[9] = s5, s6, s7, s8, s9
    sums[RIGHT], sums[RIGHT + 1], sums[RIGHT + 2], sums[RIGHT + 3] = r0, r1, r2, r3


def give_up(el, cap, sums):
    """Turn each given-up axis into a row of the identity with its price on the right side."""
    for j in range(4):
        if el[j]:
            price = el[j] * cap[j]
            for i in range(4):
                at = i * (i + 1) // 2 + j if i > j else j * (j + 1) // 2 + i
                if i != j:
                    if not el[i]:
                        sums[RIGHT + i] -= sums[at] * price
                    sums[at] = 0.0
    for j in range(4):
        if el[j]:
            sums[j * (j + 1) // 2 + j] = 1.0
            sums[RIGHT + j] = el[j] * cap[j]


def factor(sums, tiny):
    """Cholesky factor of the Schur complement, diagonal inverted; -1, or the first axis that is stuck."""
    s0, s1, s2, s3, s4 = sums[0], sums[1], sums[2], sums[3], sums[4]
    s5, s6, s7, s8, s9 = sums[5], sums[6], sums[7], sums[8], sums[9]
    if s0 <= NO_PIVOT:
        return 0
    i0 = s0**-0.5
    l1, l3, l6 = s1 * i0, s3 * i0, s6 * i0
    d = s2 - l1 * l1
    if d <= tiny * s2 or d <= NO_PIVOT:
        return 1
    i1 = d**-0.5
    l4, l7 = (s4 - l3 * l1) * i1, (s7 - l6 * l1) * i1
    d = s5 - l3 * l3 - l4 * l4
    if d <= tiny * s5 or d <= NO_PIVOT:
        return 2
    i2 = d**-0.5
    l8 = (s8 - l6 * l3 - l7 * l4) * i2
    d = s9 - l6 * l6 - l7 * l7 - l8 * l8
    if d <= tiny * s9 or d <= NO_PIVOT:
        return 3
    sums[10], sums[11], sums[12], sums[13], sums[14] = i0, l1, i1, l3, l4
    sums[15], sums[16], sums[17], sums[18], sums[19] = i2, l6, l7, l8, d**-0.5
    return -1


def substitute(b0, b1, b2, b3, sums):
    """Solve with the factor."""
    i0, i1, i2, i3 = sums[10], sums[12], sums[15], sums[19]
    l10, l20, l21, l30, l31, l32 = (
        sums[11],
        sums[13],
        sums[14],
        sums[16],
        sums[17],
        sums[18],
    )
    y0 = b0 * i0
    y1 = (b1 - l10 * y0) * i1
    y2 = (b2 - l20 * y0 - l21 * y1) * i2
    y3 = (b3 - l30 * y0 - l31 * y1 - l32 * y2) * i3
    v3 = y3 * i3
    v2 = (y2 - l32 * v3) * i2
    v1 = (y1 - l21 * v2 - l31 * v3) * i1
    return (y0 - l10 * v1 - l20 * v2 - l30 * v3) * i0, v1, v2, v3


def step_arms(arms, lam, work):
    """The step of each arm for the prices."""
    l0, l1, l2, l3 = lam[0], lam[1], lam[2], lam[3]
    for k in range(arms):
        arm = work[k]
        du = arm[BU] + l0 * arm[YU] + l1 * arm[YU + 1] + l2 * arm[YU + 2] + l3 * arm[YU + 3]
        dl = arm[BL] + l0 * arm[YL] + l1 * arm[YL + 1] + l2 * arm[YL + 2] + l3 * arm[YL + 3]
        arm[DU], arm[DL] = du, dl


def revise(arms, x, lo, hi, act, lam, work):
    """Primal-dual update of the active set: hold what would leave its bounds, free what is pushed inward."""
    changed = 0
    for k in range(arms):
        arm, i = work[k], 2 * k
        du, dl = arm[DU], arm[DL]
        for side in range(2):
            n = i + side
            if hi[n] <= lo[n]:
                continue
            if act[n] == 0:
                to = x[n] + (dl if side else du)
                if to < lo[n] - 1e-12:
                    act[n] = -1
                    changed += 1
                elif to > hi[n] + 1e-12:
                    act[n] = 1
                    changed += 1
            else:
                j = JL if side else JU
                if side:
                    push = arm[HUL] * du + arm[HLL] * dl + arm[GL]
                else:
                    push = arm[HUU] * du + arm[HUL] * dl + arm[GU]
                push -= lam[0] * arm[j] + lam[1] * arm[j + 1] + lam[2] * arm[j + 2] + lam[3] * arm[j + 3]
                if push * act[n] > 1e-12:
                    act[n] = 0
                    changed += 1
    return changed


def box_arm(arm, i, x, lo, hi, act, lam):
    """The arm's best step inside its bounds for the prices: free, else the best of its four edges."""
    uu, ul, ll = arm[HUU], arm[HUL], arm[HLL]
    gu, gl = arm[GU], arm[GL]
    for j in range(4):
        gu -= lam[j] * arm[JU + j]
        gl -= lam[j] * arm[JL + j]
    u_lo, u_hi, l_lo, l_hi = lo[i] - x[i], hi[i] - x[i], lo[i + 1] - x[i + 1], hi[i + 1] - x[i + 1]
    det = uu * ll - ul * ul
    du, dl = (ul * gl - ll * gu) / det, (ul * gu - uu * gl) / det
    act_u = act_l = 0
    if not (u_lo <= du <= u_hi and l_lo <= dl <= l_hi) or u_hi <= u_lo or l_hi <= l_lo:
        best = 1e300
        for edge in range(4):
            if edge < 2:
                u, au = (u_lo, -1) if edge == 0 else (u_hi, 1)
                l, al = -(gl + ul * u) / ll, 0  # noqa: E741
                if l <= l_lo:
                    l, al = l_lo, -1  # noqa: E741
                elif l >= l_hi:
                    l, al = l_hi, 1  # noqa: E741
            else:
                l, al = (l_lo, -1) if edge == 2 else (l_hi, 1)  # noqa: E741
                u, au = -(gu + ul * l) / uu, 0
                if u <= u_lo:
                    u, au = u_lo, -1
                elif u >= u_hi:
                    u, au = u_hi, 1
            cost = u * (gu + 0.5 * uu * u + ul * l) + l * (gl + 0.5 * ll * l)
            if cost < best:
                best, du, dl, act_u, act_l = cost, u, l, au, al
    arm[DU], arm[DL] = du, dl
    act[i], act[i + 1] = act_u, act_l


def dual_slope(arms, x, lo, hi, act, lam, work, sums):
    """Steps of all arms for the prices; the wrench they still miss, to first order, into SLOPE."""
    for j in range(4):
        sums[SLOPE + j] = sums[MISS + j]
    for k in range(arms):
        box_arm(work[k], 2 * k, x, lo, hi, act, lam)
        arm = work[k]
        for j in range(4):
            sums[SLOPE + j] -= arm[JU + j] * arm[DU] + arm[JL + j] * arm[DL]


def ascent(arms, x, lo, hi, act, lam, el, cap, work, sums):
    """Newton direction of the dual into RIGHT; a price that would be driven beyond its cap stays."""
    for _ in range(4):
        assemble(arms, x, lo, hi, act, work, sums)
        for j in range(4):
            sums[RIGHT + j] = sums[SLOPE + j]
            sums[j * (j + 1) // 2 + j] += RIDGE
        for j in range(4):
            if el[j]:
                for i in range(4):
                    sums[(i * (i + 1) // 2 + j if i > j else j * (j + 1) // 2 + i)] = 0.0
                sums[j * (j + 1) // 2 + j] = 1.0
                sums[RIGHT + j] = 0.0
        factor(sums, 0.0)
        d0, d1, d2, d3 = substitute(sums[RIGHT], sums[RIGHT + 1], sums[RIGHT + 2], sums[RIGHT + 3], sums)
        sums[RIGHT], sums[RIGHT + 1], sums[RIGHT + 2], sums[RIGHT + 3] = d0, d1, d2, d3
        beyond = 0
        for j in range(4):
            if el[j] == 0 and abs(lam[j]) >= cap[j] and sums[RIGHT + j] * lam[j] > 0.0:
                el[j] = 1 if lam[j] > 0.0 else -1
                beyond += 1
        if beyond == 0:
            return


def along(arms, x, lo, hi, act, lam, cap, work, sums):
    """Move the prices along RIGHT to where the dual stops rising, or to the first cap."""
    reach, start, first = 1.0, 0.0, -1
    for j in range(4):
        d = sums[RIGHT + j]
        if d != 0.0:
            most = ((cap[j] if d > 0.0 else -cap[j]) - lam[j]) / d
            if most < reach:
                reach, first = most, j
        start += d * sums[SLOPE + j]
        sums[KEEP + j] = lam[j]
    low, high, t = 0.0, reach, reach
    at_low, at_high = start, 0.0
    for cut in range(CUTS):
        for j in range(4):
            lam[j] = sums[KEEP + j] + t * sums[RIGHT + j]
        if first >= 0 and t == reach:
            lam[first] = cap[first] if sums[RIGHT + first] > 0.0 else -cap[first]
        dual_slope(arms, x, lo, hi, act, lam, work, sums)
        rise = 0.0
        for j in range(4):
            rise += sums[RIGHT + j] * sums[SLOPE + j]
        if abs(rise) <= 0.01 * start or (cut == 0 and rise >= 0.0):
            return
        if rise > 0.0:
            low, at_low = t, rise
        else:
            high, at_high = t, rise
        # false position, halved every other time: the dual bends sharply where a rotor leaves a bound
        t = 0.5 * (low + high) if cut % 2 else low + (high - low) * at_low / (at_low - at_high)


def climb(arms, x, lo, hi, act, lam, el, cap, work, sums):
    """Settle one quadratic problem surely: Newton on its concave dual in the four prices, each step cut where
    the dual stops rising. Returns the number of Newton steps."""
    for j in range(4):
        lam[j] = min(max(lam[j], -cap[j]), cap[j])
    dual_slope(arms, x, lo, hi, act, lam, work, sums)
    for count in range(CLIMBS):
        worst = 0.0
        for j in range(4):
            slope = sums[SLOPE + j]
            el[j] = 0
            if abs(lam[j]) >= cap[j] and slope * lam[j] > 0.0:
                el[j] = 1 if lam[j] > 0.0 else -1
            else:
                worst = max(worst, abs(slope))
        if worst < 1e-12:
            return count
        ascent(arms, x, lo, hi, act, lam, el, cap, work, sums)
        along(arms, x, lo, hi, act, lam, cap, work, sums)
    return CLIMBS


def largest_step(arms, work):
    """The largest part of the present step."""
    largest = 0.0
    for k in range(arms):
        arm = work[k]
        largest = max(largest, abs(arm[DU]), abs(arm[DL]))
    return largest


def quadratic_step(arms, x, lo, hi, act, lam, el, cap, work, sums):
    """Settle bounds and given-up axes of one quadratic problem; returns the active-set rounds it took.

    A few primal-dual rounds from the last active set, nearly always one; else the sure way.
    """
    for rounds in range(ROUNDS):
        assemble(arms, x, lo, hi, act, work, sums)
        if el[0] or el[1] or el[2] or el[3]:
            give_up(el, cap, sums)
        if factor(sums, TINY_PIVOT) >= 0:
            break
        lam[0], lam[1], lam[2], lam[3] = substitute(
            sums[RIGHT], sums[RIGHT + 1], sums[RIGHT + 2], sums[RIGHT + 3], sums
        )
        changed = 0
        for j in range(4):
            if el[j] == 0 and abs(lam[j]) > cap[j]:
                changed += 1
        step_arms(arms, lam, work)
        for j in range(4):
            if el[j]:
                left = sums[MISS + j]
                for k in range(arms):
                    arm = work[k]
                    left -= arm[JU + j] * arm[DU] + arm[JL + j] * arm[DL]
                if left * el[j] < 0.0:
                    changed += 1
        if changed:
            break
        if revise(arms, x, lo, hi, act, lam, work) == 0:
            return rounds + 1
    rounds = ROUNDS + climb(arms, x, lo, hi, act, lam, el, cap, work, sums)
    # leave the factor of the settled set behind, for the corrections
    assemble(arms, x, lo, hi, act, work, sums)
    if el[0] or el[1] or el[2] or el[3]:
        give_up(el, cap, sums)
    factor(sums, 1e-16)
    return rounds


def move(arms, x, lo, hi, work):
    """Take the step, inside the bounds."""
    for k in range(arms):
        arm, i = work[k], 2 * k
        x[i] = min(max(x[i] + arm[DU], lo[i]), hi[i])
        x[i + 1] = min(max(x[i + 1] + arm[DL], lo[i + 1]), hi[i + 1])


def correct(arms, x, lo, hi, el, work, sums):
    """Move along the factor's own directions until the axes that are met miss nothing (to first order)."""
    b0 = 0.0 if el[0] else sums[MISS]
    b1 = 0.0 if el[1] else sums[MISS + 1]
    b2 = 0.0 if el[2] else sums[MISS + 2]
    b3 = 0.0 if el[3] else sums[MISS + 3]
    v0, v1, v2, v3 = substitute(b0, b1, b2, b3, sums)
    for k in range(arms):
        arm = work[k]
        arm[DU] = v0 * arm[YU] + v1 * arm[YU + 1] + v2 * arm[YU + 2] + v3 * arm[YU + 3]
        arm[DL] = v0 * arm[YL] + v1 * arm[YL + 1] + v2 * arm[YL + 2] + v3 * arm[YL + 3]
    move(arms, x, lo, hi, work)


def worst_met(el, sums):
    """Largest miss among the axes that are not given up."""
    worst = 0.0
    for j in range(4):
        if el[j] == 0:
            worst = max(worst, abs(sums[MISS + j]))
    return worst


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


def merit(cap, sums):
    """Power plus the price of what is missing, of the last `miss`."""
    return (
        sums[POWER]
        + cap[0] * abs(sums[MISS]) + cap[1] * abs(sums[MISS + 1])
        + cap[2] * abs(sums[MISS + 2]) + cap[3] * abs(sums[MISS + 3])
    )  # fmt: skip


def promise(arms, cap, work, sums):
    """What the quadratic problem says that its step is worth in merit."""
    gain = 0.0
    for k in range(arms):
        arm = work[k]
        du, dl = arm[DU], arm[DL]
        gain -= du * (arm[GU] + 0.5 * arm[HUU] * du + arm[HUL] * dl)
        gain -= dl * (arm[GL] + 0.5 * arm[HLL] * dl)
    for j in range(4):
        gain += cap[j] * (abs(sums[MISS + j]) - abs(sums[SLOPE + j]))
    return gain


def persist(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box):
    """The sure way to the optimum: steps inside a trust region that grows and shrinks with what they bring.

    `box` is scratch (6K): the region's low and high ends, the speeds to come back to. Returns the steps
    taken, negative when there were too many.
    """
    arms = shape[0]
    n = 2 * arms
    radius = 0.3
    miss(c, g, shape, x, mu, sums)
    here = merit(cap, sums)
    for count in range(1, PERSIST + 1):
        expand(c, g, shape, x, lam, mu, work, sums)
        for i in range(n):
            box[i], box[n + i] = max(lo[i], x[i] - radius), min(hi[i], x[i] + radius)
            box[2 * n + i] = x[i]
        climb(arms, x, box[:n], box[n : 2 * n], act, lam, el, cap, work, sums)
        gain, step = promise(arms, cap, work, sums), largest_step(arms, work)
        if gain < 1e-11 or step < 1e-10:
            return count
        move(arms, x, lo, hi, work)
        miss(c, g, shape, x, mu, sums)
        there = merit(cap, sums)
        if there > here - 0.5 * gain:
            # the wrench is curved: what the step broke to second order may be mended without a new expansion
            assemble(arms, x, box[:n], box[n : 2 * n], act, work, sums)
            give_up(el, cap, sums)
            if factor(sums, TINY_PIVOT) < 0:
                correct(arms, x, lo, hi, el, work, sums)
                miss(c, g, shape, x, mu, sums)
                there = merit(cap, sums)
        if there < here - 0.05 * gain:
            if there < here - 0.5 * gain and step > 0.7 * radius:
                radius = min(2.0 * radius, 1.0)
            here = there
        else:
            for i in range(n):
                x[i] = box[2 * n + i]
            radius = 0.3 * min(radius, step)
    return -PERSIST


def solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit):
    """Bring x to the optimum for mu, from wherever x, act, lam and el stand, by full steps.

    Returns (quadratic steps, negative when `limit` of them did not settle it; active-set rounds; last step).
    """
    arms = shape[0]
    total = 0
    step = 1.0
    for count in range(1, limit + 1):
        expand(c, g, shape, x, lam, mu, work, sums)
        total += quadratic_step(arms, x, lo, hi, act, lam, el, cap, work, sums)
        step = largest_step(arms, work)
        move(arms, x, lo, hi, work)
        miss(c, g, shape, x, mu, sums)
        worst = worst_met(el, sums)
        done = STEP_DONE
        if el[0] or el[1] or el[2] or el[3]:
            done = GIVEN_UP_DONE
        if step < done:
            for _ in range(CORRECTIONS):
                if worst <= MISS_DONE:
                    break
                correct(arms, x, lo, hi, el, work, sums)
                miss(c, g, shape, x, mu, sums)
                worst = worst_met(el, sums)
            if worst <= MISS_DONE:
                return count, total, step
    return -limit, total, step


def optimum(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, limit):
    """`solve` from where the last call stood; where that does not settle, the sure way from the middle.

    Returns (steps, negative when even that did not settle; active-set rounds). Whatever happens x is within
    its bounds, and MISS and POWER in `work` are those of x.
    """
    n = 2 * shape[0]
    for i in range(n):
        x[i] = min(max(x[i], lo[i]), hi[i])
        if hi[i] <= lo[i]:
            act[i] = -1
    steps, rounds, _ = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if steps > 0:
        return steps, rounds
    for i in range(n):
        x[i] = 0.5 * (lo[i] + hi[i])
        act[i] = 0 if hi[i] > lo[i] else -1
    for j in range(4):
        lam[j], el[j] = 0.0, 0
    sure = persist(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box)
    miss(c, g, shape, x, mu, sums)
    before = merit(cap, sums)
    for i in range(n):
        box[2 * n + i] = x[i]
    steps, rounds, _ = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if merit(cap, sums) > before + 1e-11 or steps < 0:
        for i in range(n):
            x[i] = box[2 * n + i]
        miss(c, g, shape, x, mu, sums)
        return limit + sure if sure > 0 else sure - limit, rounds
    return 2 * limit + steps, rounds


def batch(c, g, shape, lo, hi, x, act, lam, el, cap, demands, work, sums, box, limit, speeds, misses, steps):
    """`optimum` for each row of `demands` (rows, 4), warm-started by the row before."""
    n = 2 * shape[0]
    for row in range(len(demands)):
        steps[row], _ = optimum(
            c, g, shape, lo, hi, x, act, lam, el, cap, demands[row], work, sums, box, limit
        )
        for i in range(n):
            speeds[row][i] = x[i]
        for j in range(4):
            misses[row][j] = sums[MISS + j]
