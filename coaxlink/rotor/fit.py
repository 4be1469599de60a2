"""The ladder of rotor models, a dictionary of terms a load, and how one is fitted: options, result, weights.

srm      f = k u^2, one k for both rotors: a coaxial rotor is a rotor (eq. 18's standard mixer)
cpcm     f_u = k u_u^2, f_l = c k u_l^2: a constant penalty on the lower rotor (their reference 21)
rcrm     f_u = p_0u u_u^2, f_l = p_0l u_l^2 + p_1l u_u^2 (eq. 6)
crm      f_u a polynomial of u_u, f_l one of (u_u, u_l), terms chosen by LASSO up to an order (eq. 1-4)

Berra, Trujillo and Heredia 2024, section 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.rotor.polynomial import Polynomial, design_matrix, parse_term, rounder, term_name
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import Intervals, term_intervals

Array = NDArray[np.float64]

FORMS = ("srm", "cpcm", "rcrm", "crm")
HIGHEST = 4  # power of a speed
FELT = HIGHEST + 1  # the order of an upper load that feels the lower rotor: small spacings
LOWEST = 2  # order of the smallest dictionary: squares are what momentum theory asks for
HUBER = 2.5  # standard deviations within which a row counts in full
CHANCE = 10.83  # chi squared of one degree of freedom that chance exceeds once in a thousand
LEAST_VARIANCE = 0.05  # of the mean: a row at rest must not rule the fit
ROWS_A_TERM = 3  # that a dictionary needs


@dataclass(frozen=True)
class Options:
    """How a form is fitted."""

    max_order: int = HIGHEST  # highest power of each speed that crm may use


@dataclass(frozen=True)
class SelectionStep:
    """One tried support: the selection's history."""

    order: int
    lam: float
    terms: int
    rmse: float  # on the blocks left out
    excess: float  # error above the best, in standard errors of the paired difference
    chosen: bool = False


@dataclass(frozen=True)
class LoadFit:
    """A fitted load."""

    terms: tuple[str, ...]  # the dictionary, (p,)
    coefficients: Array  # (p,) least squares on the support, zero elsewhere
    order: int
    intervals: Intervals  # of the whole dictionary; of the terms themselves where none were chosen
    history: tuple[SelectionStep, ...] = ()
    alone: bool = False  # intervals take the kept terms for granted, though the data may show more

    @property
    def polynomial(self) -> Polynomial:
        """The load as a polynomial, without its zero terms."""
        return Polynomial.from_terms(nonzero(self.terms, self.coefficients))

    def predict(self, upper: Array, lower: Array) -> Array:
        """Value at normalised speeds (rows,)."""
        return np.asarray(design_matrix(self.terms, upper, lower) @ self.coefficients)


def nonzero(terms: Sequence[str], coefficients: Array) -> Mapping[str, float]:
    """{term: coefficient} without the zeros."""
    return {t: float(b) for t, b in zip(terms, coefficients, strict=True) if b != 0.0}


def load_terms(form: str, load: str, order: int = LOWEST) -> list[str]:
    """Names of the dictionary's terms for one load; `order` counts for crm only.

    Raises ValueError on an unknown form.
    """
    upper = load.startswith("upper")
    square = "u_u^2" if upper else "u_l^2"
    if form in ("srm", "cpcm"):
        return [square]
    if form == "rcrm":
        return [square] if upper else [square, "u_u^2"]
    if form == "crm":
        if upper and order <= HIGHEST:
            return [term_name(a, 0) for a in range(order + 1)]
        return rounder(3 if upper else order)
    raise ValueError(f"'{form}' is not a form: {', '.join(FORMS)}")


def order_of(load: str, terms: Iterable[str]) -> int:
    """The order of the smallest dictionary of crm that holds these terms."""
    powers = [parse_term(term) for term in terms]
    if load.startswith("upper") and any(b for _, b in powers):
        return FELT
    return max((sum(p) if max(p) > 2 else max(p) for p in powers), default=0)


def orders(load: str, rows: int, max_order: int = Options.max_order) -> list[int]:
    """Orders of crm to try: those whose dictionary leaves three rows a term."""
    highest = range(LOWEST, max_order + 1)
    return [o for o in highest if ROWS_A_TERM * len(load_terms("crm", load, o)) <= rows] or [1]


def fit_all_terms(form: str, rows: LoadRows) -> LoadFit:
    """A form that keeps every term it names (rcrm, cpcm), by least squares."""
    terms = load_terms(form, rows.load)
    return least_squares_fit(terms, rows.design(terms), rows.y)


def fit_shared(rows: Sequence[LoadRows]) -> dict[str, LoadFit]:
    """One k for both rotors (srm): the rows of a quantity, of one rotor or of both."""
    own = [r.upper if r.load.startswith("upper") else r.lower for r in rows]
    x, y = np.concatenate(own)[:, None] ** 2, np.concatenate([r.y for r in rows])
    return {r.load: least_squares_fit(load_terms("srm", r.load), x, y) for r in rows}


def least_squares_fit(terms: Sequence[str], X: Array, y: Array) -> LoadFit:
    """All terms of a design (n, p), rows that do not fit weighted down."""
    weights = row_weights(X, y)
    b = least_squares(X, y, weights)
    return LoadFit(tuple(terms), b, LOWEST, term_intervals(terms, X, y, weights))


def least_squares(X: Array, y: Array, weights: Array | None = None) -> Array:
    """(p,) weighted least squares of a design (n, p), a target (n,) and weights (n,)."""
    root = np.ones(len(y)) if weights is None else np.sqrt(weights)
    return np.asarray(np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0])


def huber_weights(X: Array, y: Array) -> tuple[Array, float]:
    """(n,) weights in (0, 1] and the robust scale of the residuals about the robust fit."""
    weights, scale = np.ones(len(y)), 0.0
    degrees = max(len(y) - X.shape[1], 1)
    for _ in range(30):
        residual = y - X @ least_squares(X, y, weights)
        scale = SIGMA_PER_MAD * float(np.median(np.abs(residual))) * np.sqrt(len(y) / degrees)
        if scale <= 1e-12 * max(float(np.abs(y).max(initial=0.0)), 1e-300):
            return np.ones(len(y)), scale
        updated = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-300))
        if np.max(np.abs(updated - weights)) < 1e-6:
            break
        weights = updated
    return weights, scale


def row_weights(X: Array, y: Array) -> Array:
    """(n,) Huber weights where there are more rows than terms, else ones."""
    return huber_weights(X, y)[0] if len(y) > X.shape[1] else np.ones(len(y))


def noise_weights(X: Array, y: Array, weights: Array) -> Array:
    """(n,) weights times 1 / variance where the scatter about a rich fit grows with the load, else as is.

    Variance as a + b load^2, from the squared residuals, and only if they follow it beyond chance: Koenker's
    form of the Breusch-Pagan test at one in a thousand. `X` must hold every term that may matter: what a poor
    model misses is not noise.
    """
    degrees = len(y) - X.shape[1]
    if degrees < 20:
        return weights
    load = X @ least_squares(X, y, weights)
    squared = np.minimum(weights, 1.0) * (y - load) ** 2 * len(y) / degrees
    Z = np.stack([np.ones(len(y)), load**2], axis=1)
    a, b = np.linalg.lstsq(Z, squared, rcond=None)[0]
    explained = float(np.var(Z @ [a, b]) / max(np.var(squared), 1e-300))
    if b <= 0 or len(y) * explained < CHANCE:
        return weights
    variance = np.maximum(a, 0.0) + b * load**2
    inverse = 1.0 / np.maximum(variance, LEAST_VARIANCE * variance.mean())
    return np.asarray(weights * inverse / inverse.mean())
