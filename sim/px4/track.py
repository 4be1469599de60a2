# mypy: disallow-untyped-defs=False
"""One turn of PX4's loops, compiled: a goal and a reading to what the mixer is asked for."""

from __future__ import annotations

from sim.physics.compile_cache import OPTIONS, cached, inlined
from sim.physics.sensing import R_POS, R_QUAT, R_RATES, R_VEL
from sim.px4 import loops
from sim.px4.loops import D_ATTITUDE, D_RATES, D_THRUST, M_OUT

for _name in (
    "multiply", "conjugate", "reduced_tilt", "matrix_to_quaternion", "euler", "learn_hover", "low_passed",
    "accelerate", "point", "rates_for", "turn",
):  # fmt: skip
    inlined(getattr(loops, _name))


@inlined
def steer(goal, r, g, m, dt, demand):
    """Fill `demand` (DEMAND) with what PX4's loops make of a goal (GOAL) and a reading."""
    attitude = (r[R_QUAT], r[R_QUAT + 1], r[R_QUAT + 2], r[R_QUAT + 3])
    loops.accelerate(
        (goal[0], goal[1], goal[2]), (goal[3], goal[4], goal[5]), (goal[6], goal[7], goal[8]),
        (r[R_POS], r[R_POS + 1], r[R_POS + 2]), (r[R_VEL], r[R_VEL + 1], r[R_VEL + 2]), g, m, dt,
    )  # fmt: skip
    thrust, wanted = loops.point(goal[9], attitude, g, m, dt)
    rates = loops.rates_for(wanted, attitude, goal[10], g)
    loops.turn(rates, thrust, (r[R_RATES], r[R_RATES + 1], r[R_RATES + 2]), g, m, dt)
    demand[D_THRUST] = thrust
    for k in range(3):
        demand[k], demand[D_RATES + k] = m[M_OUT + k], rates[k]
    for k in range(4):
        demand[D_ATTITUDE + k] = wanted[k]


@cached(**OPTIONS)
def track(goal, r, g, m, dt, demand):
    """`steer` for one turn."""
    steer(goal, r, g, m, dt, demand)
