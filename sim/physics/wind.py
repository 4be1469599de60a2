# mypy: disallow-untyped-defs=False
"""Turbulence around the mean wind, passed at hover: the same function in plain Python and compiled.

First-order Dryden forms of one length; by law "dryden" the second-order ones across the wind and up
(MIL-F-8785C); by law "shear" the mean grows with height as (h / 4 m)^0.2.
"""

from __future__ import annotations

import math

from sim.physics.layout import WIND

# mean, state, slow state, size, law (0 first order, 1 dryden, 2 shear), on or off
W_MEAN, W_STATE, W_SLOW, W_SIZE, W_LAW, W_ON, GUSTS = 0, 3, 6, 9, 10, 11, 12
LENGTH_S = 2.5  # how long a gust lasts over a hovering vehicle
SHEAR, SHEAR_M = 0.2, 4.0


def rise(w, p):
    """Let gusts blow around the wind that blows now."""
    w[W_ON] = 1.0
    w[W_MEAN : W_MEAN + 3] = p[WIND : WIND + 3]


def blow(w, p, height, since, kick):
    """Move the air on by `since` seconds; kick (3) standard normal. Up and down it moves half as much."""
    if w[W_ON] == 0.0 or (w[W_SIZE] == 0.0 and w[W_LAW] != 2.0):
        return
    keep = math.exp(-max(since, 0.0) / LENGTH_S)
    fresh = w[W_SIZE] * math.sqrt(1.0 - keep * keep)
    for k in range(3):
        w[W_SLOW + k] = keep * w[W_SLOW + k] + (1.0 - keep) * w[W_STATE + k]
        w[W_STATE + k] = keep * w[W_STATE + k] + fresh * (0.5 if k == 2 else 1.0) * kick[k]
    a0, a1, a2 = w[W_STATE], w[W_STATE + 1], w[W_STATE + 2]
    m0, m1, m2 = w[W_MEAN], w[W_MEAN + 1], w[W_MEAN + 2]
    if w[W_LAW] == 1.0:  # (1 + sqrt 3 T s) / (1 + T s)^2 of white noise, but for the wind's own way
        root = math.sqrt(3.0)
        c0 = (root * a0 + (1.0 - root) * w[W_SLOW]) / math.sqrt(2.0)
        c1 = (root * a1 + (1.0 - root) * w[W_SLOW + 1]) / math.sqrt(2.0)
        c2 = (root * a2 + (1.0 - root) * w[W_SLOW + 2]) / math.sqrt(2.0)
        size = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        size = size if size > 0.0 else 1.0
        e0, e1, e2 = m0 / size, m1 / size, m2 / size
        along = e0 * (a0 - c0) + e1 * (a1 - c1) + e2 * (a2 - c2)
        a0, a1, a2 = c0 + e0 * along, c1 + e1 * along, c2 + e2 * along
    elif w[W_LAW] == 2.0:
        grown = (max(height, 0.1) / SHEAR_M) ** SHEAR
        m0, m1, m2 = m0 * grown, m1 * grown, m2 * grown
    p[WIND], p[WIND + 1], p[WIND + 2] = m0 + a0, m1 + a1, m2 + a2
