"""The form `surface`: a load as a smooth surface over both speeds, where no short polynomial follows it.

The squares of the R-CRM (eq. 6) are free, and what they miss is a discrepancy (Kennedy and O'Hagan 2001):
Legendre polynomials of both speeds up to the sixth degree under a normal prior that shrinks by a factor a
degree. Its size, the factor and the noise are where the marginal likelihood is highest (MacKay 1992, Bayesian
interpolation; Rasmussen and Williams 2006, section 2.7).
A narrow structure (a resonance over one speed) is not followed: it stays a residual, for `refine` to name.

What comes out is a polynomial as any other form's, so every allocation, table and script takes it as it is.
Between and beside the rows it rises with a rotor's own speed and is not negative, as `rotor.physical` has it:
an allocation that inverts it must not meet a bump of the fit's own. The other rules of `rotor.physical` hold
where they are requested.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor import physical
from coaxlink.rotor.fit import (
    SURFACE_DEGREE,
    Array,
    Broken,
    LoadFit,
    Smooth,
    fit_all_terms,
    load_terms,
    row_weights,
)
from coaxlink.rotor.polynomial import parse_term
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import Intervals

FREE = 3.0  # standard deviation of a free coefficient over the largest load: nothing is held back
SIZES = (0.01, 0.03, 0.1, 0.3)  # of the largest load: to as much as a wake takes
SHRINKS = (0.2, 0.4, 0.6, 0.8)  # a degree: nearly a plane, to nearly as rough as degree six allows
NOISES = np.geomspace(1e-4, 0.3, 81)  # of the largest load: steps of a tenth
ODDS = float(np.log(50.0))  # before any row is seen, that squares do not follow: as of any effect
NORMAL_95 = 1.96


def fit_surface(rows: LoadRows, *, every_rule: bool = False) -> LoadFit:
    """Fit one load; `every_rule` holds it to all rules of rotors, else to those that an allocation needs."""
    terms = tuple(
        name
        for name in load_terms("surface", rows.load)
        if _varies(rows.upper, parse_term(name)[0]) and _varies(rows.lower, parse_term(name)[1])
    )
    into, degrees = _basis(rows.load, terms, max(1.0, float(rows.upper.max()), float(rows.lower.max())))
    X = rows.design(terms) @ into
    weights = row_weights(rows.design(_rich(terms, len(rows.y))), rows.y)
    largest = float(np.quantile(np.abs(rows.y), 0.99)) or 1.0
    A, z = X * np.sqrt(weights)[:, None], rows.y * np.sqrt(weights) / largest
    flat = _Posterior(A, z, _deviations(degrees, 0.0, 0.0))
    richer = [_Posterior(A, z, _deviations(degrees, s, k)) for s in SIZES for k in SHRINKS]
    best = max((flat, *richer), key=lambda p: p.evidence)
    evidence = best.evidence - flat.evidence
    if evidence < ODDS:
        # nothing smooth is there to be held: the R-CRM itself
        fit = fit_all_terms("rcrm", rows)
        noise = float(np.std(rows.y - fit.predict(rows.upper, rows.lower)))
        return replace(fit, smooth=Smooth(evidence, noise, 0.0))
    mean, covariance = best.solved()
    free = into @ (largest * mean)
    mean, broken = _sensible(best, largest * mean, terms, into, rows, weights, every_rule)
    coefficients = into @ mean
    error = largest * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", into, covariance, into), 0.0))
    half = NORMAL_95 * error
    bounds = {t: (float(b - h), float(b + h)) for t, b, h in zip(terms, coefficients, half, strict=True)}
    beyond = float(np.sqrt(np.mean((X[:, degrees >= 0] @ mean[degrees >= 0]) ** 2)))
    return LoadFit(
        terms,
        coefficients,
        SURFACE_DEGREE,
        Intervals(bounds, dict(zip(terms, map(float, error), strict=True))),
        alone=True,
        broken=broken,
        free=free if broken else None,
        smooth=Smooth(evidence, best.noise * largest, beyond),
    )


class _Posterior:
    """A posterior, its noise where the marginal likelihood is highest; loads over the largest."""

    def __init__(self, A: Array, z: Array, deviation: Array) -> None:
        """A (n, p) and z (n,) weighted, `deviation` (p,) of the coefficients, 0 for those left out."""
        self.deviation = deviation
        B = A * deviation
        self._values, self._vectors = np.linalg.eigh(B.T @ B)
        self._values = np.maximum(self._values, 0.0)
        self._target = self._vectors.T @ (B.T @ z)
        variance = NOISES[:, None] ** 2
        shared = variance + self._values
        evidence = -0.5 * (
            len(z) * np.log(2 * np.pi * variance[:, 0])
            + np.sum(np.log(shared / variance), axis=1)
            + (z @ z - np.sum(self._target**2 / shared, axis=1)) / variance[:, 0]
        )
        at = int(np.argmax(evidence))
        self.noise, self.evidence = float(NOISES[at]), float(evidence[at])

    def solved(self) -> tuple[Array, Array]:
        """(p,) mean and (p, p) covariance of the coefficients."""
        V = self._vectors * self.deviation[:, None]
        shared = self.noise**2 + self._values
        return V @ (self._target / shared), self.noise**2 * (V / shared) @ V.T


def _sensible(
    best: _Posterior,
    mean: Array,
    terms: tuple[str, ...],
    into: Array,
    rows: LoadRows,
    weights: Array,
    every_rule: bool,
) -> tuple[Array, tuple[Broken, ...]]:
    """The mean itself where it does what rotors do, else the likeliest that does, and what it broke."""
    u, v = physical.grid(rows.upper, rows.lower)
    rules = {
        name: C
        for name, C in physical.rules(rows.load, terms, u, v)
        if every_rule or name != physical.IN_THE_WAKE
    }
    broken = [physical.violation(name, C, into @ mean, u, v) for name, C in rules.items()]
    if not any(broken):
        return mean, ()
    held = best.deviation > 0
    count = int(held.sum())
    prior = np.diag(best.noise / best.deviation[held])  # as rows that were measured to be nothing
    X = rows.design(terms) @ into[:, held]
    C = np.concatenate(list(rules.values())) @ into[:, held]
    target, joint = np.append(rows.y, np.zeros(count)), np.append(weights, np.ones(count))
    found = physical.nearest(np.vstack([X, prior]), target, joint, C)
    if found is None:
        return mean, ()
    out = np.zeros(len(mean))
    out[held] = found
    return out, tuple(b for b in broken if b)


def _varies(speeds: Array, power: int) -> bool:
    """Whether a speed may enter with a power: one that never varied enters with none."""
    return power == 0 or bool(np.ptp(speeds) > 0)


def _basis(load: str, terms: tuple[str, ...], top: float) -> tuple[Array, NDArray[np.int64]]:
    """(terms, p) functions as powers of the speeds, and their degrees: -1 for the squares of the R-CRM."""
    powers = [parse_term(name) for name in terms]
    change = _to_powers(top)
    legendre = np.array([[change[p, a] * change[q, b] for a, b in powers] for p, q in powers])
    squares = [terms.index(name) for name in load_terms("rcrm", load) if name in terms]
    free = np.zeros((len(terms), len(squares)))
    free[squares, range(len(squares))] = 1.0
    degrees = [-1] * len(squares) + [a + b for a, b in powers]
    return np.hstack([free, legendre]), np.array(degrees)


def _deviations(degrees: NDArray[np.int64], size: float, shrink: float) -> Array:
    """(p,) prior deviations over the largest load."""
    return np.where(degrees < 0, FREE, size * shrink ** np.maximum(degrees, 0))


def _rich(terms: tuple[str, ...], rows: int) -> list[str]:
    """Terms that leave three rows each, lowest powers first: what a row is judged outlying against."""
    ordered = sorted(terms, key=lambda name: sum(parse_term(name)))
    return ordered[: max(rows // 3, 1)]


@cache
def _to_powers(top: float) -> Array:
    """(powers, degrees): Legendre polynomials on 0 to `top` as powers of a speed."""
    out = np.zeros((SURFACE_DEGREE + 1, SURFACE_DEGREE + 1))
    for k in range(SURFACE_DEGREE + 1):
        basis = np.polynomial.Legendre.basis(k, domain=[0.0, top])
        coefficients = basis.convert(kind=np.polynomial.Polynomial, domain=[-1, 1], window=[-1, 1]).coef
        out[: len(coefficients), k] = coefficients
    return out
