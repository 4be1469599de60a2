# mypy: disallow-untyped-defs=False
"""One quadratic problem of the exact law: prices, step, active set."""

from __future__ import annotations

from coaxlink.mixer.exact.dual import climb
from coaxlink.mixer.exact.loads import BL, BU, DL, DU, GL, GU, HLL, HUL, HUU, JL, JU, MISS, RIGHT, YL, YU
from coaxlink.mixer.exact.schur import TINY_PIVOT, assemble, factor, give_up, substitute

ROUNDS = 6  # active-set rounds before the sure way


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
