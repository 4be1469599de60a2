"""Equations 5, 15, 16 and 18 from geometry and coefficients."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import Airframe
from coaxlink.constants import RAD_S_PER_RPM
from coaxlink.mixer import make_law
from coaxlink.rotor import RotorModel
from coaxlink.studies.paper.ledger import (
    CONTRADICTED,
    GRAVITY,
    IN_PART,
    REPRODUCED,
    Claim,
    Line,
    close,
    printed,
)
from coaxlink.vehicle import Vehicle

ROUNDING = 1e-3  # relative; the paper prints four digits
ARM = "contradiction 5: the arm that the printed matrices hold is not the printed arm"


def equation_15(airframe: Airframe) -> Claim:
    """The reduced mixer's matrix: a column is p~ (eq. 7), its arm times p~, and q~."""
    c, eq = printed()["rcrm"], printed()["eq_15"]
    upper = c["p_0u"] + c["p_1l"]
    arm = abs(airframe.rotors[0].position_m[1])
    lines = (
        Line("upper thrust p_0u + p_1l", eq["upper_thrust_N"], upper, "N"),
        Line("upper roll and pitch", eq["upper_roll_Nm"], arm * upper, "N m"),
        Line("lower thrust p_0l", eq["lower_thrust_N"], c["p_0l"], "N"),
        Line("lower roll and pitch", None, arm * c["p_0l"], "N m"),
        Line("upper yaw q_0u - q_1l", None, c["q_0u"] - c["q_1l"], "N m"),
        Line("lower yaw q_0l", None, c["q_0l"], "N m"),
    )
    agree = all(close(x.computed, x.printed, ROUNDING) for x in lines if x.printed and x.computed)
    return Claim(
        "eq-15",
        "Eq. 15, matrix of the Reduced Coaxial Mixer",
        REPRODUCED if agree else CONTRADICTED,
        f"the coefficients beside it give it to rounding, on an arm of {arm * math.sqrt(2):.4f} m",
        lines,
    )


def equation_16(airframe: Airframe) -> Claim:
    """The coaxial mixer's 4 x 16 matrix: geometry and spin alone, so its rank and its rows can be checked."""
    thrust, torque = airframe.effectiveness()
    matrix = np.hstack([thrust, torque])
    back = matrix @ np.linalg.pinv(matrix)
    lines = (
        Line("rank of the 4 x 16 matrix", 4.0, float(np.linalg.matrix_rank(matrix)), ""),
        Line("largest departure of A A+ from 1", 0.0, float(np.abs(back - np.eye(4)).max()), ""),
        Line("roll and pitch arm of every rotor", None, abs(float(thrust[1, 0])), "m"),
    )
    return Claim(
        "eq-16",
        "Eq. 16, matrix of the Coaxial Mixer",
        IN_PART,
        "it holds geometry and spin only; with the arm of eq. 15 it has full rank, but " + ARM,
        lines,
    )


def equation_18() -> Claim:
    """The standard mixer: one column for every rotor."""
    eq = printed()["eq_18"]
    arm = printed()["eq_15"]["upper_roll_Nm"] / printed()["eq_15"]["upper_thrust_N"]
    lines = (
        Line("roll and pitch", eq["roll_Nm"], arm * eq["thrust_N"], "N m"),
        Line("yaw", eq["yaw_row"], eq["torque_Nm"], "N m"),
    )
    return Claim(
        "eq-18",
        "Eq. 18, matrix of the Standard Mixer",
        CONTRADICTED,
        "thrust, roll and pitch agree with eq. 15's arm; the yaw row is a ratio (contradiction 4)",
        lines,
    )


def figure_5(crm: RotorModel) -> Claim:
    """Eq. 5 on the eq. 17 pair: thrust per shaft watt at equal speeds, Algorithm 1's and the best split."""
    thrust = np.linspace(20.0, 75.0, 12)
    equal = np.array([_at(crm, f, 1.0) for f in thrust])
    paper = np.array([_at(crm, f, _algorithm(crm, f)) for f in thrust])
    best = np.array([max(_at(crm, f, r) for r in np.linspace(0.4, 1.2, 161)) for f in thrust])
    gains = printed()["figure_5"]["gain_N_per_W"]
    lines = (
        Line("mean gain over equal speeds: the first printed, Algorithm 1 in hover", gains[0],
             float(np.mean(paper - equal)), "N/W"),
        Line("the second printed, the split of least power", gains[1], float(np.mean(best - equal)), "N/W"),
        Line("equal speeds at 49 N a pair", None, _at(crm, 49.05, 1.0), "N/W"),
        Line("least power at 49 N a pair", None, max(_at(crm, 49.05, r) for r in np.linspace(0.4, 1.2, 161)),
             "N/W"),
    )  # fmt: skip
    return Claim(
        "figure-5",
        "Eq. 5 and Fig. 5, efficiency over coaxial thrust",
        IN_PART,
        "the printed gains are of electrical watts, and neither currents nor voltages are printed; here are "
        "shaft watts, torque times speed, at an estimated 5400 rpm: the sign agrees, the size cannot be held "
        "against it",
        lines,
    )


def _algorithm(crm: RotorModel, thrust_N: float) -> float:
    """Ratio u_u / u_l at which both rotors carry half: what Algorithm 1's pseudo-inverse asks in hover."""

    def excess(ratio: float) -> float:
        loads = crm.loads(*_speeds(crm, thrust_N, ratio))
        return float(loads.upper_thrust - loads.lower_thrust)

    return _root(excess, 0.3, 1.5)


def _speeds(crm: RotorModel, thrust_N: float, ratio: float) -> tuple[float, float]:
    """(u_u, u_l) with u_u = ratio u_l that give the pair's thrust."""

    def excess(lower: float) -> float:
        loads = crm.loads(ratio * lower, lower)
        return float(loads.upper_thrust + loads.lower_thrust) - thrust_N

    lower = _root(excess, 0.05, 1.5)
    return ratio * lower, lower


def _at(crm: RotorModel, thrust_N: float, ratio: float) -> float:
    """Thrust per shaft watt."""
    upper, lower = _speeds(crm, thrust_N, ratio)
    loads = crm.loads(upper, lower)
    rad_s = crm.speed_max_rpm * RAD_S_PER_RPM
    return thrust_N / float(rad_s * (loads.upper_torque * upper + loads.lower_torque * lower))


def _root(f, low: float, high: float) -> float:  # type: ignore[no-untyped-def]
    from scipy.optimize import brentq

    return float(brentq(f, low, high))


def hover_error(
    law: str, airframe: Airframe, model: RotorModel, crm: RotorModel
) -> tuple[float, NDArray[np.float64]]:
    """What a law made from `model` misses of the weight on `crm` (N), and its speeds (N,)."""
    from coaxlink.mixer import allocate

    weight = printed()["geometry"]["mass_kg"] * GRAVITY
    law_made = make_law(law, Vehicle(airframe, model))
    a = allocate(law_made, Vehicle(airframe, crm), [weight, 0.0, 0.0, 0.0])
    return float(a.error[0]), a.speeds
