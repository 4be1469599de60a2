# mypy: disallow-untyped-defs=False
"""The Schur complement of one quadratic problem of the exact law, for a given active set."""

from __future__ import annotations

from coaxlink.mixer.exact.loads import (
    BL,
    BU,
    DL,
    DU,
    GL,
    GU,
    HLL,
    HUL,
    HUU,
    JL,
    JU,
    MISS,
    RIGHT,
    YL,
    YU,
    move,
)

NO_PIVOT = 1e-14
TINY_PIVOT = 1e-9  # the axis cannot be moved by the rotors still free


def reduce_arm(arm, i, x, lo, hi, act):
    """The arm's step as B + Y lam for the present active set; adds its share to the Schur complement."""
    uu, ul, ll = arm[HUU], arm[HUL], arm[HLL]
    gu, gl = arm[GU], arm[GL]
    if act[i] == 0 and act[i + 1] == 0:
        r = 1.0 / (uu * ll - ul * ul)
        a, b, d = r * ll, -r * ul, r * uu
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
    """L D L^T of the Schur complement, D inverted; -1, or the first axis that is stuck."""
    s0, s1, s2, s3, s4 = sums[0], sums[1], sums[2], sums[3], sums[4]
    s5, s6, s7, s8, s9 = sums[5], sums[6], sums[7], sums[8], sums[9]
    if s0 <= NO_PIVOT:
        return 0
    i0 = 1.0 / s0
    l1, l3, l6 = s1 * i0, s3 * i0, s6 * i0
    d = s2 - l1 * s1
    if d <= tiny * s2 or d <= NO_PIVOT:
        return 1
    i1 = 1.0 / d
    t4, t7 = s4 - l3 * s1, s7 - l6 * s1
    l4, l7 = t4 * i1, t7 * i1
    d = s5 - l3 * s3 - l4 * t4
    if d <= tiny * s5 or d <= NO_PIVOT:
        return 2
    i2 = 1.0 / d
    t8 = s8 - l6 * s3 - l7 * t4
    l8 = t8 * i2
    d = s9 - l6 * s6 - l7 * t7 - l8 * t8
    if d <= tiny * s9 or d <= NO_PIVOT:
        return 3
    sums[10], sums[11], sums[12], sums[13], sums[14] = i0, l1, i1, l3, l4
    sums[15], sums[16], sums[17], sums[18], sums[19] = i2, l6, l7, l8, 1.0 / d
    return -1


def substitute(b0, b1, b2, b3, sums):
    """Solve with the factor."""
    l10, l20, l21, l30, l31, l32 = sums[11], sums[13], sums[14], sums[16], sums[17], sums[18]
    y1 = b1 - l10 * b0
    y2 = b2 - l20 * b0 - l21 * y1
    v3 = (b3 - l30 * b0 - l31 * y1 - l32 * y2) * sums[19]
    v2 = y2 * sums[15] - l32 * v3
    v1 = y1 * sums[12] - l21 * v2 - l31 * v3
    return b0 * sums[10] - l10 * v1 - l20 * v2 - l30 * v3, v1, v2, v3


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
