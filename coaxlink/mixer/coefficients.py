"""The numbers of the linear mixers: thrust and torque of each rotor per squared normalised speed.

Two sets from one rotor model: the *reduced* one of Berra, Trujillo and Heredia 2024, eq. 6, 7 and 15,
which keeps the wake of the upper rotor on the lower one, and the *standard* one of eq. 18, which takes
every rotor for a lone one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor import RotorModel
from coaxlink.rotor.polynomial import Polynomial
from coaxlink.vehicle import plain_rotors

Turned = Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]]  # speeds of both commands

# the paper's bench grid: 11 x 11 throttle levels over 0 .. 90 %
GRID = np.linspace(0.0, 0.9, 11)


@dataclass(frozen=True)
class ReducedCoefficients:
    """Loads of one coaxial pair as pure squares (eq. 6), N and N m per u^2.

    f_u = p_0u u_u^2, f_l = p_0l u_l^2 + p_1l u_u^2, and the torques with q alike.
    """

    p_0u: float
    p_0l: float
    p_1l: float
    q_0u: float
    q_0l: float
    q_1l: float

    @property
    def p_upper(self) -> float:
        """p~_u of eq. 7: what the *pair* gains in thrust (N) per u_u^2, the lower one's loss included."""
        return self.p_0u + self.p_1l

    @property
    def p_lower(self) -> float:
        """p_l of eq. 7, N per u_l^2."""
        return self.p_0l


@dataclass(frozen=True)
class StandardCoefficients:
    """Loads of a rotor that feels no other (eq. 18), N and N m per u^2; upper and lower are alike."""

    p: float
    q: float


def reduced_coefficients(model: RotorModel, *, of_commands: bool = False) -> ReducedCoefficients:
    """Pure-square terms of a rotor model (eq. 6), per squared speed; `of_commands`: per squared command.

    Where the model holds nothing but squares (form rcrm, srm) they are its own. Otherwise squares alone are
    fitted to its surface on GRID x GRID by least squares: on eq. 17 this gives 85.7, 80.4, -34.6 N, not the
    77.65, 69.89, -30.7 that the paper prints.
    """
    plain_rotors(model)
    upper, lower = (x.ravel() for x in np.meshgrid(GRID, GRID, indexing="ij"))
    none, turned = np.zeros_like(upper), model.turned if of_commands and model.drive else None
    p_0u, _ = _squares(model.upper_thrust, upper, none, turned)
    q_0u, _ = _squares(model.upper_torque, upper, none, turned)
    p_1l, p_0l = _squares(model.lower_thrust, upper, lower, turned)
    q_1l, q_0l = _squares(model.lower_torque, upper, lower, turned)
    return ReducedCoefficients(p_0u, p_0l, p_1l, q_0u, q_0l, q_1l)


def standard_coefficients(model: RotorModel, *, of_commands: bool = False) -> StandardCoefficients:
    """The lone rotor of eq. 18: f = p u^2 and tau = q u^2 of the upper rotor with the lower one removed,
    u the speed, or `of_commands` the command.

    Least squares over GRID where the model has more than squares.
    """
    plain_rotors(model)
    none, turned = np.zeros_like(GRID), model.turned if of_commands and model.drive else None
    (p, _), (q, _) = (_squares(load, GRID, none, turned) for load in (model.upper_thrust, model.upper_torque))
    return StandardCoefficients(p, q)


def _squares(
    load: Polynomial, upper: NDArray[np.float64], lower: NDArray[np.float64], turned: Turned | None
) -> tuple[float, float]:
    """(per u_u^2, per u_l^2): the polynomial's own terms if it has no others, else its least-squares fit."""
    terms = load.terms()
    if turned is None and set(terms) <= {"u_u^2", "u_l^2"}:
        return terms.get("u_u^2", 0.0), terms.get("u_l^2", 0.0)
    matrix = np.stack([upper**2, lower**2], axis=-1)
    speeds = (upper, lower) if turned is None else turned(upper, lower)
    fit, *_ = np.linalg.lstsq(matrix, load(*speeds), rcond=None)
    return float(fit[0]), float(fit[1])
