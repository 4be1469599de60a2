# mypy: disallow-untyped-defs=False
"""Where a call of the exact law starts: near the last solution, or at the one kept from before a jump."""

from __future__ import annotations

# rows of `past`: the last call (wrench demanded, whether a jump led to it, speeds before it); the solutions
# that stood before the last jump out of reach and before the last jump back (wrench, prices, given-up axes,
# speeds, active set)
LAST, WITHIN, BEYOND, ROWS = 0, 1, 2, 3
PRICES, GIVEN_UP, SPEEDS = 4, 8, 12  # places in a row
SMOOTH = 4  # in LAST: 1 if the last call's speeds were reached by a smooth motion, 0 if by a jump

JUMP = 0.02  # of the vehicle's authority, all axes together: more is no smooth motion
CLEARLY = 1.5  # times nearer: else the last solution, which the active set is surest of, serves
NEVER = 1e9  # further from any wrench than any wrench can be: nothing is kept there yet


def away(row, mu):
    """How far the row's wrench lies from mu."""
    return abs(mu[0] - row[0]) + abs(mu[1] - row[1]) + abs(mu[2] - row[2]) + abs(mu[3] - row[3])


def keep(row, last, n, x, act, lam, el):
    """Keep the solution of the last call."""
    for j in range(4):
        row[j], row[PRICES + j], row[GIVEN_UP + j] = last[j], lam[j], el[j]
    for i in range(n):
        row[SPEEDS + i], row[SPEEDS + n + i] = x[i], act[i]


def recall(row, n, x, act, lam, el):
    """Stand where `keep` stood."""
    for j in range(4):
        lam[j], el[j] = row[PRICES + j], int(row[GIVEN_UP + j])
    for i in range(n):
        x[i], act[i] = row[SPEEDS + i], int(row[SPEEDS + n + i])


def start(n, x, act, lam, el, mu, past):
    """Bring x, act, lam and el near the solution for mu.

    A smooth motion goes on as it went, which leaves the quadratic step nothing to correct. After a jump, into
    or out of reach above all, the nearer of the last solution and one kept from the other side serves.
    """
    last = past[LAST]
    jump = away(last, mu)
    if jump < JUMP:
        ahead = last[SMOOTH]
        for i in range(n):
            at = x[i]
            x[i], last[SPEEDS + i] = at + ahead * (at - last[SPEEDS + i]), at
        last[SMOOTH] = 1.0
    else:
        out = el[0] or el[1] or el[2] or el[3]
        if last[0] < NEVER:
            keep(past[BEYOND if out else WITHIN], last, n, x, act, lam, el)
        other = past[WITHIN if out else BEYOND]
        if CLEARLY * away(other, mu) < jump:
            recall(other, n, x, act, lam, el)
        last[SMOOTH] = 0.0
    last[0], last[1], last[2], last[3] = mu[0], mu[1], mu[2], mu[3]
