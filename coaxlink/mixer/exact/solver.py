# mypy: disallow-untyped-defs=False
"""The exact law's arithmetic: least power for a wrench on polynomial arms, coordinates between bounds.

    min P(x) = sum_k P_k(u, s)   subject to   W(x) = mu,   lo <= x <= hi

u is the upper rotor's speed, s where the lower one's lies between the least and the greatest it may have
beneath that (`exact.arms`): so the bounds are a box, and the corner where a lower rotor windmills is outside.

with strict priorities when no x delivers mu: axis j may be missed at the price of cap_j |mu_j - W_j|, caps a
hundredfold apart (an exact penalty), so a lower axis is given up before a higher one is touched.

Sequential quadratic programming, warm-started. Read from the bottom: `settled` (where to start from, and
where again when that fails), `solve` (steps until nothing is missed), `quadratic_step` (one quadratic
problem: active set and prices), `climb` (the sure way through one), `assemble` and `factor` (its 4 x 4 Schur
complement: the Hessian of the Lagrangian is a 2 x 2 block an arm), `expand` (surfaces and slopes).

Floats, indexing and loops, and no allocation: the same functions run on lists in plain Python and on arrays
when numba compiles them (`exact.compiled`). Everything is normalised by `exact.law`: axes in order of
priority and in units of the vehicle's authority, power in units of full power.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple


class Arms(NamedTuple):
    """A vehicle of K arms; a single rotor is an arm whose second coordinate is held at 0.

    x is (2K,): u and s of each arm. What an arm does to the body are M surfaces of these, as few as its four
    loads need: of an ordinary pair two, the sum of its thrusts and the difference of its torques.
    """

    size: int  # K
    surfaces: int  # M
    order_u: int  # highest power of u in any surface
    order_s: int
    power_u: int  # and in the power
    power_s: int
    surface: Any  # (K, M, T) coefficients by rows of powers of u
    power: Any  # (K, T')
    gain: Any  # (K, M, 4) wrench by axis of a unit of each surface
    lo: Any  # (2K,) bounds
    hi: Any
    cap: Any  # (4,) most that an axis is worth, in power
    squares: Any  # (2K, 4) of the reduced law: squared speeds per wrench
    line: Any  # (K, 4) least and greatest lower speed: at rest, and per unit of u, each
    home: Any  # (2K,) where the vehicle hovers
    within: Any  # (1,) of mu: what is missed without being a fault, of the vehicle's authority


class State(NamedTuple):
    """Where the law stands, and its scratch."""

    mu: Any  # (4,) the demanded wrench
    x: Any  # (2K,) speeds
    act: Any  # (2K,) -1 at lo, 0 free, 1 at hi
    price: Any  # (4,) of each axis
    gone: Any  # (4,) 0 met, +1 given up below mu, -1 given up above mu
    miss: Any  # (4,) demanded minus delivered
    power: Any  # (1,)
    slope: Any  # (2K,) of the power
    jacobian: Any  # (2K, 4) slopes of the wrench
    hessian: Any  # (K, 3) of the Lagrangian: upper-upper, upper-lower, lower-lower
    own: Any  # (2K,) the step's part that does not depend on the prices
    reply: Any  # (2K, 4) what a unit of each price adds to the step
    step: Any  # (2K,)
    schur: Any  # (4, 4) lower triangle
    factor: Any  # (4, 4) of it: L below the diagonal, 1 / D on it
    right: Any  # (4,) right side, or direction of the prices
    dual: Any  # (4,) slope of the dual: what the step leaves missing, to first order
    before: Any  # (4,) prices before a climb
    low: Any  # (2K,) trust region
    high: Any
    kept: Any  # (2K,) speeds to come back to
    old_mu: Any  # (3, 4) remembered wrenches: LAST, WITHIN, BEYOND
    old_price: Any  # (3, 4)
    old_gone: Any  # (3, 4)
    old_x: Any  # (3, 2K)
    old_act: Any  # (3, 2K)
    smooth: Any  # (1,) 1 if the last call's x was reached by a smooth motion, 0 by a jump, -1 by a leap
    best: Any  # (2K,) of all starts so far
    looked: Any  # (9,) of the last look all round: mu, what it gave up, and whether there was one: 1
    looks: Any  # (1,) how many were made


CURVATURE = 0.05  # least curvature of an arm's block
NO_PIVOT = 1e-14  # rounding of a double
TINY_PIVOT = 1e-9  # the axis cannot be moved by the rotors still free
RIDGE = 1e-9  # on the Schur complement where the free rotors cannot move an axis
ACTIVE_SET_ROUNDS = 6  # before the sure way
CLIMBS, CUTS = 30, 40  # Newton steps on the dual; trials along each
STEP_DONE = 2e-3  # the next quadratic step would be about its square
GIVEN_UP_DONE = 1e-6  # with axes given up the steps need not be quadratic
MISS_DONE = 1e-9  # of the vehicle's authority: what corrections must reach
CORRECTIONS = 3  # that reuse one factor
SETTLING, GRACE = 0.1, 3  # a step this small at the limit earns a few more: it shrinks by its square
SAME = 1e-6  # of the merit: two ends are one
PERSIST = 60  # steps inside a trust region
# stages of a call: from the last solution, from hover, from STARTS all round, from the best of them
NEAR, HOME, STARTS = 0, 1, 4
AGAIN = HOME + STARTS + 1
# remembered: the last call; the solutions that stood before the last jump out of reach, and before that back
LAST, WITHIN, BEYOND = 0, 1, 2
JUMP = 0.02  # of the vehicle's authority, all axes together: more is no smooth motion
LEAP = 0.1  # the same: more may end in another valley of the power
CLEARLY = 1.5  # times nearer: else the last solution, which the active set is surest of, serves
NEVER = 1e9  # further from any wrench than any wrench can be: nothing is remembered there yet


# surfaces and slopes


def surface(c, nu, nl, u, l):  # noqa: E741
    """(f, f_u, f_l, f_uu, f_ul, f_ll) of a surface's coefficients, by Horner's rule in both coordinates."""
    f = fu = fuu = fl = ful = fll = 0.0
    for a in range(nu, -1, -1):
        r = rl = rll = 0.0
        for b in range(nl, -1, -1):
            rll = rll * l + rl
            rl = rl * l + r
            r = r * l + c[a * (nl + 1) + b]
        fuu = fuu * u + fu
        fu = fu * u + f
        f = f * u + r
        ful = ful * u + fl
        fl = fl * u + rl
        fll = fll * u + rll
    return f, fu, fl, 2.0 * fuu, ful, 2.0 * fll


def value(c, nu, nl, u, l):  # noqa: E741
    """f alone."""
    f = 0.0
    for a in range(nu, -1, -1):
        r = 0.0
        for b in range(nl, -1, -1):
            r = r * l + c[a * (nl + 1) + b]
        f = f * u + r
    return f


def miss(p, s):
    """The wrench still missing at x."""
    m0, m1, m2, m3 = s.mu[0], s.mu[1], s.mu[2], s.mu[3]
    for k in range(p.size):
        u, l = s.x[2 * k], s.x[2 * k + 1]  # noqa: E741
        for n in range(p.surfaces):
            f, gain = value(p.surface[k][n], p.order_u, p.order_s, u, l), p.gain[k][n]
            m0 -= gain[0] * f
            m1 -= gain[1] * f
            m2 -= gain[2] * f
            m3 -= gain[3] * f
    s.miss[0], s.miss[1], s.miss[2], s.miss[3] = m0, m1, m2, m3


def cost(p, s):
    """The power at x."""
    power = 0.0
    for k in range(p.size):
        power += value(p.power[k], p.power_u, p.power_s, s.x[2 * k], s.x[2 * k + 1])
    s.power[0] = power


def expand(p, s):
    """Second-order expansion at x: slopes of wrench and power, the Lagrangian's Hessian, what is missing."""
    for j in range(4):
        s.miss[j] = s.mu[j]
    for k in range(p.size):
        expand_arm(p, s, k)


def expand_arm(p, s, k):
    """One arm's part. The Hessian's block is made positive by a shift of its diagonal."""
    u, l = s.x[2 * k], s.x[2 * k + 1]  # noqa: E741
    by_u, by_l, left, price = s.jacobian[2 * k], s.jacobian[2 * k + 1], s.miss, s.price
    for j in range(4):
        by_u[j] = by_l[j] = 0.0
    f, gu, gl, uu, ul, ll = surface(p.power[k], p.power_u, p.power_s, u, l)
    for n in range(p.surfaces):
        f, fu, fl, fuu, ful, fll = surface(p.surface[k][n], p.order_u, p.order_s, u, l)
        gain = p.gain[k][n]
        weight = 0.0  # of the surface in the Lagrangian
        for j in range(4):
            left[j] -= gain[j] * f
            by_u[j] += gain[j] * fu
            by_l[j] += gain[j] * fl
            weight -= gain[j] * price[j]
        uu += weight * fuu
        ul += weight * ful
        ll += weight * fll
    if uu < CURVATURE or ll < CURVATURE or (uu - CURVATURE) * (ll - CURVATURE) < ul * ul:
        half = 0.5 * (uu - ll)
        shift = CURVATURE - 0.5 * (uu + ll) + sqrt(half * half + ul * ul)
        uu += shift
        ll += shift
    s.slope[2 * k], s.slope[2 * k + 1] = gu, gl
    block = s.hessian[k]
    block[0], block[1], block[2] = uu, ul, ll


def merit(p, s):
    """Power plus the price of what is missing, by the last `miss`."""
    cost(p, s)
    total = s.power[0]
    for j in range(4):
        total += p.cap[j] * abs(s.miss[j])
    return total


def move(p, s):
    """Take the step, inside the bounds."""
    for i in range(2 * p.size):
        s.x[i] = min(max(s.x[i] + s.step[i], p.lo[i]), p.hi[i])


def largest_step(p, s):
    """The largest part of the present step."""
    largest = 0.0
    for i in range(2 * p.size):
        largest = max(largest, abs(s.step[i]))
    return largest


def worst_met(s):
    """Largest miss among the axes that are not given up."""
    worst = 0.0
    for j in range(4):
        if s.gone[j] == 0:
            worst = max(worst, abs(s.miss[j]))
    return worst


def given_up(s):
    """How many axes are given up."""
    return abs(s.gone[0]) + abs(s.gone[1]) + abs(s.gone[2]) + abs(s.gone[3])


# the Schur complement of one quadratic problem, for a given active set


def assemble(p, s, lo, hi):
    """Each arm's step as own + reply . prices, and the Schur complement and right side over all arms."""
    schur, right = s.schur, s.right
    for i in range(4):
        right[i] = s.miss[i]
        for j in range(i + 1):
            schur[i][j] = 0.0
    for k in range(p.size):
        # the block's inverse over the speeds that are free
        uu, ul, ll = s.hessian[k][0], s.hessian[k][1], s.hessian[k][2]
        i, j = 2 * k, 2 * k + 1
        gu, gl = s.slope[i], s.slope[j]
        if s.act[i] == 0 and s.act[j] == 0:
            r = 1.0 / (uu * ll - ul * ul)
            a, b, d = r * ll, -r * ul, r * uu
            own_u, own_l = -(a * gu + b * gl), -(b * gu + d * gl)
        else:
            a = b = d = 0.0
            own_u = (lo[i] if s.act[i] < 0 else hi[i]) - s.x[i]
            own_l = (lo[j] if s.act[j] < 0 else hi[j]) - s.x[j]
            if s.act[i] == 0:
                a = 1.0 / uu
                own_u = -a * (gu + ul * own_l)
            elif s.act[j] == 0:
                d = 1.0 / ll
                own_l = -d * (gl + ul * own_u)
        s.own[i], s.own[j] = own_u, own_l
        by_u, by_l, reply_u, reply_l = s.jacobian[i], s.jacobian[j], s.reply[i], s.reply[j]
        for m in range(4):
            reply_u[m] = a * by_u[m] + b * by_l[m]
            reply_l[m] = b * by_u[m] + d * by_l[m]
            right[m] -= by_u[m] * own_u + by_l[m] * own_l
            row = schur[m]
            for n in range(m + 1):
                row[n] += by_u[m] * reply_u[n] + by_l[m] * reply_l[n]


def fix_price(s, j, price):
    """Make row j of the Schur complement say that this price is known."""
    for i in range(4):
        if i > j:
            s.right[i] -= s.schur[i][j] * price
            s.schur[i][j] = 0.0
        elif i < j:
            s.right[i] -= s.schur[j][i] * price
            s.schur[j][i] = 0.0
    s.schur[j][j] = 1.0


def fix_given_up(p, s):
    """A given-up axis has its cap for a price."""
    for j in range(4):
        if s.gone[j]:
            fix_price(s, j, s.gone[j] * p.cap[j])
    for j in range(4):
        if s.gone[j]:
            s.right[j] = s.gone[j] * p.cap[j]


def factor(s, tiny):
    """L D L^T of the Schur complement; -1, or the first axis that is stuck. A stuck axis is left unmoved."""
    stuck = -1
    schur, l = s.schur, s.factor  # noqa: E741
    for j in range(4):
        # row j of L D, then of L
        d = schur[j][j]
        for n in range(j):
            t = schur[j][n]
            for m in range(n):
                t -= l[j][m] * l[n][m]
            l[j][n] = t
        for n in range(j):
            t = l[j][n]
            l[j][n] = t * l[n][n]
            d -= t * l[j][n]
        if d <= NO_PIVOT or d <= tiny * schur[j][j]:
            if stuck < 0:
                stuck = j
            l[j][j] = 0.0
        else:
            l[j][j] = 1.0 / d
    return stuck


def substitute(s, b0, b1, b2, b3):
    """Solve with the factor."""
    l1, l2, l3 = s.factor[1], s.factor[2], s.factor[3]
    b1 -= l1[0] * b0
    b2 -= l2[0] * b0 + l2[1] * b1
    b3 -= l3[0] * b0 + l3[1] * b1 + l3[2] * b2
    v3 = b3 * l3[3]
    v2 = b2 * l2[2] - l3[2] * v3
    v1 = b1 * l1[1] - l2[1] * v2 - l3[1] * v3
    v0 = b0 * s.factor[0][0] - l1[0] * v1 - l2[0] * v2 - l3[0] * v3
    return v0, v1, v2, v3


def correct(p, s):
    """Move along the factor's own directions until the axes that are met miss nothing (to first order)."""
    b0 = 0.0 if s.gone[0] else s.miss[0]
    b1 = 0.0 if s.gone[1] else s.miss[1]
    b2 = 0.0 if s.gone[2] else s.miss[2]
    b3 = 0.0 if s.gone[3] else s.miss[3]
    v0, v1, v2, v3 = substitute(s, b0, b1, b2, b3)
    for i in range(2 * p.size):
        reply = s.reply[i]
        s.step[i] = v0 * reply[0] + v1 * reply[1] + v2 * reply[2] + v3 * reply[3]
    move(p, s)


# one quadratic problem: prices, step, active set


def quadratic_step(p, s, lo, hi):
    """Settle bounds and given-up axes of one quadratic problem; returns the active-set rounds it took.

    A few primal-dual rounds from the last active set, nearly always one; else the sure way.
    """
    for rounds in range(ACTIVE_SET_ROUNDS):
        assemble(p, s, lo, hi)
        fix_given_up(p, s)
        if factor(s, TINY_PIVOT) >= 0:
            break
        v0, v1, v2, v3 = substitute(s, s.right[0], s.right[1], s.right[2], s.right[3])
        s.price[0], s.price[1], s.price[2], s.price[3] = v0, v1, v2, v3
        for i in range(2 * p.size):
            reply = s.reply[i]
            s.step[i] = s.own[i] + v0 * reply[0] + v1 * reply[1] + v2 * reply[2] + v3 * reply[3]
        if priced_out(p, s):
            break
        if revise(p, s, lo, hi) == 0:
            return rounds + 1
    rounds = ACTIVE_SET_ROUNDS + climb(p, s, lo, hi)
    # leave the factor of the settled set behind, for the corrections
    assemble(p, s, lo, hi)
    fix_given_up(p, s)
    factor(s, 1e-16)
    return rounds


def priced_out(p, s):
    """How many axes are priced beyond their cap, or are given up though the step delivers them."""
    count = 0
    for j in range(4):
        if s.gone[j]:
            left = s.miss[j]
            for i in range(2 * p.size):
                left -= s.jacobian[i][j] * s.step[i]
            if left * s.gone[j] < 0.0:
                count += 1
        elif abs(s.price[j]) > p.cap[j]:
            count += 1
    return count


def revise(p, s, lo, hi):
    """Primal-dual update of the active set: hold what would leave its bounds, free what is pushed inward."""
    changed = 0
    price = s.price
    for i in range(2 * p.size):
        if hi[i] <= lo[i]:
            continue
        if s.act[i] == 0:
            to = s.x[i] + s.step[i]
            if to < lo[i] - 1e-12:
                s.act[i] = -1
                changed += 1
            elif to > hi[i] + 1e-12:
                s.act[i] = 1
                changed += 1
        else:
            block, by = s.hessian[i // 2], s.jacobian[i]
            if i % 2:
                push = block[1] * s.step[i - 1] + block[2] * s.step[i] + s.slope[i]
            else:
                push = block[0] * s.step[i] + block[1] * s.step[i + 1] + s.slope[i]
            push -= price[0] * by[0] + price[1] * by[1] + price[2] * by[2] + price[3] * by[3]
            if push * s.act[i] > 1e-12:
                s.act[i] = 0
                changed += 1
    return changed


# the sure way through one quadratic problem: Newton on its concave dual in four prices


def climb(p, s, lo, hi):
    """Newton steps on the dual, each cut where the dual stops rising. Returns their number."""
    for j in range(4):
        s.price[j] = min(max(s.price[j], -p.cap[j]), p.cap[j])
    dual_slope(p, s, lo, hi)
    for count in range(CLIMBS):
        worst = 0.0
        for j in range(4):
            s.gone[j] = 0
            if abs(s.price[j]) >= p.cap[j] and s.dual[j] * s.price[j] > 0.0:
                s.gone[j] = 1 if s.price[j] > 0.0 else -1
            else:
                worst = max(worst, abs(s.dual[j]))
        if worst < 1e-12:
            return count
        ascent(p, s, lo, hi)
        along(p, s, lo, hi)
    return CLIMBS


def dual_slope(p, s, lo, hi):
    """Steps of all arms for the prices; the wrench they still miss, to first order."""
    for j in range(4):
        s.dual[j] = s.miss[j]
    for k in range(p.size):
        box_arm(s, k, lo, hi)
        for i in range(2 * k, 2 * k + 2):
            for j in range(4):
                s.dual[j] -= s.jacobian[i][j] * s.step[i]


def box_arm(s, k, lo, hi):
    """The arm's best step inside its bounds for the prices: free, else the best of its four edges."""
    i = 2 * k
    uu, ul, ll = s.hessian[k][0], s.hessian[k][1], s.hessian[k][2]
    gu, gl = s.slope[i], s.slope[i + 1]
    for j in range(4):
        gu -= s.price[j] * s.jacobian[i][j]
        gl -= s.price[j] * s.jacobian[i + 1][j]
    u_lo, u_hi, l_lo, l_hi = lo[i] - s.x[i], hi[i] - s.x[i], lo[i + 1] - s.x[i + 1], hi[i + 1] - s.x[i + 1]
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
    s.step[i], s.step[i + 1] = du, dl
    s.act[i], s.act[i + 1] = act_u, act_l


def ascent(p, s, lo, hi):
    """Newton direction of the dual into `right`; a price that would be driven beyond its cap stays."""
    for _ in range(4):
        assemble(p, s, lo, hi)
        for j in range(4):
            s.right[j] = s.dual[j]
            s.schur[j][j] += RIDGE
        for j in range(4):
            if s.gone[j]:
                fix_price(s, j, 0.0)
                s.right[j] = 0.0
        factor(s, 0.0)
        v0, v1, v2, v3 = substitute(s, s.right[0], s.right[1], s.right[2], s.right[3])
        s.right[0], s.right[1], s.right[2], s.right[3] = v0, v1, v2, v3
        beyond = 0
        for j in range(4):
            if s.gone[j] == 0 and abs(s.price[j]) >= p.cap[j] and s.right[j] * s.price[j] > 0.0:
                s.gone[j] = 1 if s.price[j] > 0.0 else -1
                beyond += 1
        if beyond == 0:
            return


def along(p, s, lo, hi):
    """Move the prices along `right` to where the dual stops rising, or to the first cap."""
    reach, start, first = 1.0, 0.0, -1
    for j in range(4):
        d = s.right[j]
        if d != 0.0:
            most = ((p.cap[j] if d > 0.0 else -p.cap[j]) - s.price[j]) / d
            if most < reach:
                reach, first = most, j
        start += d * s.dual[j]
        s.before[j] = s.price[j]
    low, high, t = 0.0, reach, reach
    at_low, at_high = start, 0.0
    for cut in range(CUTS):
        for j in range(4):
            s.price[j] = s.before[j] + t * s.right[j]
        if first >= 0 and t == reach:
            s.price[first] = p.cap[first] if s.right[first] > 0.0 else -p.cap[first]
        dual_slope(p, s, lo, hi)
        rise = 0.0
        for j in range(4):
            rise += s.right[j] * s.dual[j]
        if abs(rise) <= 0.01 * start or (cut == 0 and rise >= 0.0):
            return
        if rise > 0.0:
            low, at_low = t, rise
        else:
            high, at_high = t, rise
        # false position, halved every other time: the dual bends sharply where a rotor leaves a bound
        t = 0.5 * (low + high) if cut % 2 else low + (high - low) * at_low / (at_low - at_high)


# from one quadratic problem to the next


def solve(p, s, limit):
    """Bring x to the optimum for mu, from wherever x, act, price and gone stand, by full steps.

    Returns (quadratic steps, negative when `limit` of them did not come near it; active-set rounds).
    """
    total = count = 0
    step = 0.0
    while count < limit or (count < limit + GRACE and step < SETTLING):
        count += 1
        expand(p, s)
        total += quadratic_step(p, s, p.lo, p.hi)
        step = largest_step(p, s)
        move(p, s)
        miss(p, s)
        worst = worst_met(s)
        if step < (GIVEN_UP_DONE if given_up(s) else STEP_DONE):
            for _ in range(CORRECTIONS):
                if worst <= MISS_DONE:
                    break
                correct(p, s)
                miss(p, s)
                worst = worst_met(s)
            if worst <= MISS_DONE:
                return count, total
    return -count, total


def persist(p, s):
    """The sure way to the optimum: steps inside a trust region that grows and shrinks with what they bring.

    Returns the steps taken, negative when there were too many.
    """
    n = 2 * p.size
    radius = 0.3
    miss(p, s)
    here = merit(p, s)
    for count in range(1, PERSIST + 1):
        expand(p, s)
        for i in range(n):
            s.low[i], s.high[i] = max(p.lo[i], s.x[i] - radius), min(p.hi[i], s.x[i] + radius)
            s.kept[i] = s.x[i]
        climb(p, s, s.low, s.high)
        gain, step = promise(p, s), largest_step(p, s)
        if gain < 1e-11 or step < 1e-10:
            return count
        move(p, s)
        miss(p, s)
        there = merit(p, s)
        if there > here - 0.5 * gain:
            # the wrench is curved: what the step broke to second order may be mended without a new expansion
            assemble(p, s, s.low, s.high)
            fix_given_up(p, s)
            if factor(s, TINY_PIVOT) < 0:
                correct(p, s)
                miss(p, s)
                there = merit(p, s)
        if there < here - 0.05 * gain:
            if there < here - 0.5 * gain and step > 0.7 * radius:
                radius = min(2.0 * radius, 1.0)
            here = there
        else:
            for i in range(n):
                s.x[i] = s.kept[i]
            radius = 0.3 * min(radius, step)
    return -PERSIST


def promise(p, s):
    """What the quadratic problem says that its step is worth in merit."""
    gain = 0.0
    for k in range(p.size):
        du, dl, block = s.step[2 * k], s.step[2 * k + 1], s.hessian[k]
        gain -= du * (s.slope[2 * k] + 0.5 * block[0] * du + block[1] * dl)
        gain -= dl * (s.slope[2 * k + 1] + 0.5 * block[2] * dl)
    for j in range(4):
        gain += p.cap[j] * (abs(s.miss[j]) - abs(s.dual[j]))
    return gain


# where a call starts: near the last solution, or at the one remembered from before a jump


def away(s, which):
    """How far a remembered wrench lies from mu."""
    distance = 0.0
    for j in range(4):
        distance += abs(s.mu[j] - s.old_mu[which][j])
    return distance


def remember(p, s, which):
    """Keep the solution of the last call."""
    for j in range(4):
        s.old_mu[which][j] = s.old_mu[LAST][j]
        s.old_price[which][j], s.old_gone[which][j] = s.price[j], s.gone[j]
    for i in range(2 * p.size):
        s.old_x[which][i], s.old_act[which][i] = s.x[i], s.act[i]


def recall(p, s, which):
    """Stand where `remember` stood."""
    for j in range(4):
        s.price[j], s.gone[j] = s.old_price[which][j], s.old_gone[which][j]
    for i in range(2 * p.size):
        s.x[i], s.act[i] = s.old_x[which][i], s.old_act[which][i]


def start(p, s):
    """Bring x, act, price and gone near the solution for mu, x within its bounds.

    A smooth motion goes on as it went, which leaves the quadratic step nothing to correct. After a jump, into
    or out of reach above all, the nearer of the last solution and one kept from the other side serves.
    """
    jump = away(s, LAST)
    if jump < JUMP:
        ahead, last = max(s.smooth[0], 0.0), s.old_x[LAST]
        for i in range(2 * p.size):
            at = s.x[i]
            s.x[i], last[i] = at + ahead * (at - last[i]), at
        s.smooth[0] = 1.0
    else:
        out = given_up(s)
        if s.old_mu[LAST][0] < NEVER:
            remember(p, s, BEYOND if out else WITHIN)
        other = WITHIN if out else BEYOND
        if CLEARLY * away(s, other) < jump:
            recall(p, s, other)
        s.smooth[0] = -1.0 if out or jump > LEAP else 0.0
    for j in range(4):
        s.old_mu[LAST][j] = s.mu[j]
    for i in range(2 * p.size):
        s.x[i] = min(max(s.x[i], p.lo[i]), p.hi[i])
        if p.hi[i] <= p.lo[i]:
            s.act[i] = -1


def stand(p, s, x):
    """Stand at x, nothing held, nothing priced."""
    for i in range(2 * p.size):
        s.x[i] = min(max(x[i], p.lo[i]), p.hi[i])
        s.act[i] = 0 if p.hi[i] > p.lo[i] else -1
    for j in range(4):
        s.price[j], s.gone[j] = 0.0, 0


def stand_reduced(p, s):
    """Stand where the reduced law would: squared speeds by its matrix, clipped."""
    for k in range(p.size):
        u = l = 0.0  # noqa: E741
        for j in range(4):
            u += p.squares[2 * k][j] * s.mu[j]
            l += p.squares[2 * k + 1][j] * s.mu[j]  # noqa: E741
        u, l = sqrt(max(u, 0.0)), sqrt(max(l, 0.0))  # noqa: E741
        u = min(max(u, p.lo[2 * k]), p.hi[2 * k])
        line = p.line[k]
        least, most = line[0] + line[1] * u, line[2] + line[3] * u
        s.step[2 * k], s.step[2 * k + 1] = u, (l - least) / (most - least) if most > least else 0.0
    stand(p, s, s.step)


def fault(p, s):
    """How much is missed beyond what is no fault, dearest axis first, as a merit without the power."""
    total = 0.0
    for j in range(4):
        total += p.cap[j] * max(abs(s.miss[j]) - p.within[0], 0.0)
    return total


def better(p, s, before):
    """Keep x, whose miss is known, if its merit is below `before`; the least of both."""
    here = merit(p, s)
    if here < before:
        for i in range(2 * p.size):
            s.best[i] = s.x[i]
        return here
    return before


def keep_working(p, s):
    """Keep the active set and the prices of x, which is in `best`."""
    for j in range(4):
        s.old_price[LAST][j], s.old_gone[LAST][j] = s.price[j], s.gone[j]
    for i in range(2 * p.size):
        s.old_act[LAST][i] = s.act[i]


def work_again(p, s):
    """Stand at `best` as `keep_working` left it."""
    for j in range(4):
        s.price[j], s.gone[j] = s.old_price[LAST][j], s.old_gone[LAST][j]
    for i in range(2 * p.size):
        s.x[i], s.act[i] = s.best[i], s.old_act[LAST][i]


def stand_at(p, s, which):
    """Where a look all round starts: hover, the reduced law's answer, both bounds."""
    if which == 0:
        stand(p, s, p.home)
    elif which == 1:
        stand_reduced(p, s)
    elif which == 2:
        stand(p, s, p.hi)
    else:
        stand(p, s, p.lo)


def known(p, s):
    """Whether the last look all round was so near that it still holds: what it missed is missed here."""
    distance, same = 0.0, True
    for j in range(4):
        distance += abs(s.mu[j] - s.looked[j])
        same = same and s.gone[j] == s.looked[4 + j]
    return s.looked[8] > 0.0 and same and distance < JUMP


def stands(p, s):
    """Whether an upper or a lone rotor that could turn is held at its least."""
    found = False
    for k in range(p.size):
        found = found or (s.act[2 * k] == -1 and p.hi[2 * k] > p.lo[2 * k])
    return found


def optimum(p, s, limit):
    """`settled`, and the power of what it came to."""
    found = settled(p, s, limit)
    cost(p, s)
    return found


def settled(p, s, limit):
    """`solve` from where the last call stood; after a jump, or where a rotor stands, from hover too; what
    misses, from all round.

    Returns (steps, negative when nothing settled; active-set rounds). Whatever happens x is in its bounds,
    `miss` is that of x, and it is no more than the reduced law's.
    """
    start(p, s)
    spent = rounds = steps = 0
    before, delivered, near, enough, stood = 1e300, False, False, False, False
    for stage in range(AGAIN + 1):
        if enough and stage < AGAIN:
            continue
        if stage == HOME:
            stand(p, s, p.home)
        elif HOME < stage < AGAIN:
            s.looks[0] += 1.0 if stage == HOME + 1 else 0.0
            stand_at(p, s, stage - HOME - 1)
            miss(p, s)
            before = better(p, s, before)
            spent += abs(persist(p, s))
            miss(p, s)
            before = better(p, s, before)
        elif stage == AGAIN:  # active set and prices of the best, for the next call
            stand(p, s, s.best)
        steps, more = solve(p, s, limit)
        spent, rounds = spent + abs(steps), rounds + more
        sound = steps > 0 and fault(p, s) == 0.0
        if stage == NEAR:
            stood = stands(p, s)
            if (sound and s.smooth[0] >= 0.0 and not stood) or (steps > 0 and known(p, s)):
                return spent, rounds
            delivered, near, before = sound, steps > 0, better(p, s, before)
            keep_working(p, s)
        elif stage == HOME and delivered:
            # after a jump the same wrench may be had at less power near hover; a rotor that stands has to
            # start again, and no stand has measured its pair: only where nothing else delivers
            turns = sound and stood and not stands(p, s)
            if not turns and (steps < 0 or better(p, s, before) == before):
                work_again(p, s)
                miss(p, s)
            return spent, rounds
        elif stage == HOME and sound:
            return spent, rounds
        else:
            here, there = merit(p, s), before
            before = better(p, s, before)
            # two ways to one end, or delivered: no other start can deliver more
            same = stage == HOME and near and steps > 0 and abs(here - there) < SAME * max(there, 1.0)
            enough = enough or same or (sound and stage <= HOME + 2)
    for j in range(4):
        s.looked[j], s.looked[4 + j] = s.mu[j], float(s.gone[j])
    s.looked[8] = 1.0
    for i in range(2 * p.size):
        s.x[i] = s.best[i]
    miss(p, s)
    return spent, rounds
