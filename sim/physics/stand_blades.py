"""The compiled equations of `blades` for one pair at a time, as a stand turns it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.physics.blade_numbers import Blades, constants, lift_slope, profile_drag
from sim.physics.blades import OPTIONS, blown, spun
from sim.physics.compile_cache import cached
from sim.physics.simd import both, lower, read, write

Floats = NDArray[np.float64]
STEPS, ROUNDS = 0.8, 4000


def pair_rows(b: Blades, tip_m_s: float, u: Floats, v: Floats, climb_m_s: float, edge_m_s: float) -> Floats:
    """(6, rows) loads and drag of the pair; u, v (rows,)."""
    speed = np.stack([u, v])
    out = np.empty((6, len(u)))
    numbers = constants(b, tip_m_s)
    _rows(speed, lift_slope(b, tip_m_s, speed), profile_drag(b, speed), numbers, climb_m_s, edge_m_s, out)
    return out


@cached(**OPTIONS)
def _rows(speed: Any, slope: Any, thin: Any, numbers: Any, climb: float, edge: float, out: Any) -> None:
    w, lanes, tip = np.empty(6), (0,), numbers[0]
    for r in range(speed.shape[1]):
        for k in range(2):
            w[k], w[2 + k], w[4 + k] = speed[k, r], slope[k, r], thin[k, r]
        u = read(w, 0, lanes)
        air = spun(u, read(w, 1, lanes), read(w, 2, lanes), numbers)
        edge2, up = u * 0.0 + edge * edge, u * 0.0 + climb
        flow = (u * 0.0, lower(u) * 0.0)
        pace = STEPS * numbers[3] / (tip + abs(climb) + abs(edge))
        for _ in range(ROUNDS):  # until the air has settled: Heun's steps, short against its time
            _, _, _, k1 = blown(flow, air, edge2, up, numbers)
            ahead = (flow[0] + k1[0] * pace, flow[1] + k1[1] * pace)
            _, _, _, k2 = blown(ahead, air, edge2, up, numbers)
            flow = (flow[0] + (k1[0] + k2[0]) * (0.5 * pace), flow[1] + (k1[1] + k2[1]) * (0.5 * pace))
            write(w, 0, k1[0])
            write(w, 1, both(k1[1], k1[1]))
            if max(abs(w[0]), abs(w[1]), abs(w[2])) * pace < 1e-11:
                break
        thrust, torque, pull, _ = blown(flow, air, edge2, up, numbers)
        write(w, 0, thrust)
        write(w, 1, torque)
        write(w, 2, pull)
        for k in range(2):
            out[2 * k, r], out[2 * k + 1, r], out[4 + k, r] = w[k], w[2 + k], w[4 + k]
