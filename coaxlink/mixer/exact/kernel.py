# mypy: disallow-untyped-defs=False
"""The exact law's arithmetic: least power for a wrench on polynomial rotors, speeds between bounds.

    min P(x) = sum_k q_u u_u + q_l u_l   subject to   W(x) = mu,   lo <= x <= hi

with strict priorities when no x delivers mu: axis j may be missed at the price of w_j |mu_j - W_j|, prices a
hundredfold apart (an exact penalty), so a lower axis is given up before a higher one is touched.

Sequential quadratic programming. The Hessian of the Lagrangian is a 2 x 2 block an arm, so a step is a sum
over arms of 4 x 4 Schur complements and one factor; bounds and given-up axes are settled by a
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
    cap, mu (4)    price caps, the demanded wrench
    work (K, ARM), sums (SUMS), box (6K)   scratch
    past (ROWS, 12 + 4K)   what `exact.warm` keeps from call to call

Rows and constant places rather than computed offsets: both Python and the compiler are quicker at them.
"""

from __future__ import annotations

from coaxlink.mixer.exact.dual import climb
from coaxlink.mixer.exact.loads import (
    DL,
    DU,
    GL,
    GU,
    HLL,
    HUL,
    HUU,
    MISS,
    SLOPE,
    expand,
    largest_step,
    merit,
    miss,
    move,
    worst_met,
)
from coaxlink.mixer.exact.quadratic import quadratic_step
from coaxlink.mixer.exact.schur import TINY_PIVOT, assemble, correct, factor, give_up
from coaxlink.mixer.exact.warm import start

STEP_DONE = 2e-3  # the next quadratic step would be about its square
GIVEN_UP_DONE = 1e-6  # with axes given up the steps need not be quadratic
MISS_DONE = 1e-9  # of the vehicle's authority: what corrections aim at
MISS_ENOUGH = MISS_DONE  # what they must have reached; single precision cannot do as much (exact.lua)
CORRECTIONS = 3  # that reuse one factor
SETTLING, GRACE = 0.1, 3  # a step this small at the limit earns a few more: it shrinks by its square
PERSIST = 60  # steps inside a trust region


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

    Returns (quadratic steps, negative when `limit` of them did not come near it; active-set rounds).
    """
    arms = shape[0]
    total = count = 0
    step = 0.0
    while count < limit or (count < limit + GRACE and step < SETTLING):
        count += 1
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
            if worst <= MISS_ENOUGH:
                return count, total
    return -count, total


def restart(lo, hi, x, act, lam, el):
    """The middle of the bounds, nothing held, nothing priced."""
    for i in range(len(x)):
        x[i] = 0.5 * (lo[i] + hi[i])
        act[i] = 0 if hi[i] > lo[i] else -1
    for j in range(4):
        lam[j], el[j] = 0.0, 0


def optimum(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, limit):
    """`solve` from where the last call stood; where that does not settle, the sure way from the middle.

    Returns (steps, negative when even that did not settle; active-set rounds). Whatever happens x is within
    its bounds, and MISS and POWER in `work` are those of x.
    """
    n = 2 * shape[0]
    start(n, x, act, lam, el, mu, past)
    for i in range(n):
        x[i] = min(max(x[i], lo[i]), hi[i])
        if hi[i] <= lo[i]:
            act[i] = -1
    steps, rounds = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if steps > 0:
        return steps, rounds
    spent = -steps
    # a jump back into reach: the middle serves better than the far edge that the last call stood at
    restart(lo, hi, x, act, lam, el)
    steps, rounds = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if steps > 0 and el[0] == 0 and el[1] == 0 and el[2] == 0 and el[3] == 0:
        return spent + steps, rounds
    spent += abs(steps)
    restart(lo, hi, x, act, lam, el)
    sure = persist(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box)
    miss(c, g, shape, x, mu, sums)
    before = merit(cap, sums)
    for i in range(n):
        box[2 * n + i] = x[i]
    steps, rounds = solve(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, limit)
    if merit(cap, sums) > before + 1e-11 or steps < 0:
        for i in range(n):
            x[i] = box[2 * n + i]
        miss(c, g, shape, x, mu, sums)
        return spent + sure if sure > 0 else sure - spent, rounds
    return spent + abs(sure) + steps, rounds


def batch(
    c, g, shape, lo, hi, x, act, lam, el, cap, demands, work, sums, box, past, limit, speeds, misses, steps
):
    """`optimum` for each row of `demands` (rows, 4), warm-started by the row before."""
    n = 2 * shape[0]
    for row in range(len(demands)):
        steps[row], _ = optimum(
            c, g, shape, lo, hi, x, act, lam, el, cap, demands[row], work, sums, box, past, limit
        )
        for i in range(n):
            speeds[row][i] = x[i]
        for j in range(4):
            misses[row][j] = sums[MISS + j]
