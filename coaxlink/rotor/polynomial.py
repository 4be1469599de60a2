"""Polynomials in the two rotor speeds, and the names of their terms ("u_u^2 u_l").

A load of a coaxial pair is f(u_u, u_l) = sum_k c_k u_u^{a_k} u_l^{b_k}
(Berra, Trujillo and Heredia 2024, eq. 1-3), u_u and u_l the normalised upper and lower speeds.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_FACTOR = re.compile(r"^u_([ul])(?:\^(\d+))?$")

HIGHEST_POWER = 12  # a number that is surely a slip of the pen would keep a computer busy for good


def parse_term(name: str) -> tuple[int, int]:
    """Powers (a, b) of "u_u^a u_l^b"; "1" is (0, 0). Raises ValueError on any other text."""
    powers = {"u": 0, "l": 0}
    if name.strip() == "1":
        return 0, 0
    factors = name.split()
    for factor in factors:
        match = _FACTOR.match(factor)
        if not match:
            raise ValueError(f"'{name}' is not a term: write powers such as 'u_u^2 u_l', or '1'")
        powers[match[1]] += int(match[2] or 1)
    if max(powers.values()) > HIGHEST_POWER:
        raise ValueError(f"'{name}': powers up to {HIGHEST_POWER} are meant for a rotor")
    if not factors:
        raise ValueError("an empty term: write powers such as 'u_u^2 u_l', or '1'")
    return powers["u"], powers["l"]


def term_name(upper: int, lower: int) -> str:
    """The name of u_u^upper u_l^lower, as the rotor files write it."""
    factors = [
        name if power == 1 else f"{name}^{power}" for name, power in (("u_u", upper), ("u_l", lower)) if power
    ]
    return " ".join(factors) or "1"


def dictionary(order_upper: int, order_lower: int) -> list[str]:
    """All terms up to u_u^order_upper u_l^order_lower, the constant included (eq. 3)."""
    return [term_name(a, b) for a in range(order_upper + 1) for b in range(order_lower + 1)]


def rounder(order: int) -> list[str]:
    """The terms up to squares of both speeds (eq. 3), and beyond order 2 those of a total order."""
    powers = [(a, b) for a in range(order + 1) for b in range(order + 1)]
    return [term_name(a, b) for a, b in powers if max(a, b) <= 2 or a + b <= order]


def design_matrix(terms: Iterable[str], u_upper: ArrayLike, u_lower: ArrayLike) -> NDArray[np.float64]:
    """(rows, terms) matrix of the terms' values at the normalised speeds (rows,)."""
    upper, lower = np.broadcast_arrays(np.asarray(u_upper, float), np.asarray(u_lower, float))
    columns = [upper**a * lower**b for a, b in map(parse_term, terms)]
    if not columns:
        return np.empty((*upper.shape, 0))
    return np.stack(columns, axis=-1)


def _powers(u: NDArray[np.float64], highest: int) -> list[NDArray[np.float64]]:
    """u^0 .. u^highest by products: a fifth of the time of pow, which matters where a plant turns."""
    powers = [np.ones(()), u]
    for _ in range(highest - 1):
        powers.append(powers[-1] * u)
    return powers


@dataclass(frozen=True)
class Polynomial:
    """sum_k coefficients[k] u_u^exponents[k][0] u_l^exponents[k][1]."""

    exponents: tuple[tuple[int, int], ...]  # (K,) powers of u_u and u_l
    coefficients: tuple[float, ...]  # (K,) N or N m

    @classmethod
    def from_terms(cls, terms: Mapping[str, float]) -> Polynomial:
        """From {"u_u^2": 55.9, ...}. Raises ValueError on a name that is not a term."""
        return cls(tuple(parse_term(name) for name in terms), tuple(float(c) for c in terms.values()))

    def terms(self) -> dict[str, float]:
        """{"u_u^2": 55.9, ...}, in the order given."""
        return {term_name(*e): c for e, c in zip(self.exponents, self.coefficients, strict=True)}

    def __str__(self) -> str:
        """As it is written on paper: 55.9 u_u^2 + 22.45 u_u - 1.2."""
        parts = [
            f"{'-' if c < 0 else '+'} {abs(c):.4g}{'' if name == '1' else ' ' + name}"
            for name, c in self.terms().items()
        ]
        return " ".join(parts).removeprefix("+ ") or "0"

    def __call__(self, u_upper: ArrayLike, u_lower: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Value at normalised speeds, broadcast."""
        upper, lower = np.asarray(u_upper, float), np.asarray(u_lower, float)
        total = np.zeros(np.broadcast(upper, lower).shape)
        of_upper = _powers(upper, max((a for a, _ in self.exponents), default=0))
        of_lower = _powers(lower, max((b for _, b in self.exponents), default=0))
        for (a, b), c in zip(self.exponents, self.coefficients, strict=True):
            term = c * of_upper[a] if a else c
            total += term * of_lower[b] if b else term
        return total[()]

    def derivative(self, wrt: str) -> Polynomial:
        """Partial derivative with respect to "u_u" or "u_l"."""
        index = {"u_u": 0, "u_l": 1}[wrt]
        exponents, coefficients = [], []
        for powers, c in zip(self.exponents, self.coefficients, strict=True):
            if powers[index]:
                lowered = list(powers)
                lowered[index] -= 1
                exponents.append((lowered[0], lowered[1]))
                coefficients.append(c * powers[index])
        return Polynomial(tuple(exponents), tuple(coefficients))

    def scaled(self, factor: float) -> Polynomial:
        """Every coefficient times `factor`."""
        return Polynomial(self.exponents, tuple(factor * c for c in self.coefficients))
