# mypy: disallow-untyped-defs=False
"""The sure way through one quadratic problem of the exact law: Newton on its concave dual in four prices."""

from __future__ import annotations

from coaxlink.mixer.exact.loads import DL, DU, GL, GU, HLL, HUL, HUU, JL, JU, KEEP, MISS, RIGHT, SLOPE
from coaxlink.mixer.exact.schur import assemble, factor, substitute

RIDGE = 1e-9  # on the Schur complement where the free rotors cannot move an axis
CLIMBS, CUTS = 30, 40  # Newton steps on the dual; trials along each


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
