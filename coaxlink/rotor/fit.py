"""Options and result of a rotor fit, and least squares with Huber weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.rotor import forms
from coaxlink.rotor.intervals import Intervals
from coaxlink.rotor.polynomial import Polynomial, design_matrix

HUBER = 2.5  # standard deviations within which a row counts in full
ONE_IN_A_THOUSAND = 10.83  # of chi squared with one degree of freedom
LEAST_VARIANCE = 0.05  # of the mean: a row at rest must not rule the fit
OUTLYING = 6.0  # standard deviations beyond which a row is reported


@dataclass(frozen=True)
class Options:
    """How a form is fitted."""

    max_order: int = 4  # highest power of each speed that crm may use
    lambdas: int = 50  # points of the path
    standardised: bool = True  # terms to unit root mean square before the l1 norm sees them
    robust: bool = True  # Huber weights
    tolerance_N: float | None = None  # the paper's form of eq. 4 instead of cross-validation
    tolerance_Nm: float | None = None
    physical: bool = False  # loads that do what rotors' do (rotor.physical)

    def tolerance(self, load: str) -> float | None:
        """The tolerance for a load, None for the penalty form."""
        return self.tolerance_N if load.endswith("thrust_N") else self.tolerance_Nm


@dataclass(frozen=True)
class Candidate:
    """One tried support: the selection's history."""

    order: int
    lam: float
    terms: int
    rmse: float  # on the blocks left out
    excess: float  # error above the best, in standard errors of the paired difference
    chosen: bool = False


@dataclass(frozen=True)
class Broken:
    """A rule of rotors that a free fit breaks, where it does so most."""

    rule: str  # what the load does, in words
    worst: float  # N or N m, or those per unit of normalised speed
    upper: float  # normalised speeds of that place
    lower: float
    share: float  # of the speeds where it breaks it


@dataclass(frozen=True)
class Smooth:
    """What a surface holds beyond squares of the speeds."""

    evidence: float  # log marginal likelihood above that of squares alone, nats
    noise: float  # N or N m
    size: float  # RMS over the rows, N or N m


@dataclass(frozen=True)
class LoadFit:
    """A fitted load."""

    terms: tuple[str, ...]  # the dictionary, (p,)
    coefficients: NDArray[np.float64]  # (p,) least squares on the support, zero elsewhere
    order: int
    lam: float
    shrunk: NDArray[np.float64]  # (p,) what the l1 problem itself gave
    intervals: Intervals  # of the whole dictionary; of the terms themselves where none were chosen
    history: tuple[Candidate, ...] = ()
    alone: bool = False  # intervals take the kept terms for granted, though the data may show more
    moved: tuple[str, ...] = ()  # terms that physical sense moved out of what the data say
    broken: tuple[Broken, ...] = ()  # what the coefficients without physical sense do
    free: NDArray[np.float64] | None = None  # (p,) those coefficients, where others were put in their place
    smooth: Smooth | None = None  # of the form surface alone
    unmet: bool = False  # its terms cannot make sense: the free coefficients were kept

    @property
    def polynomial(self) -> Polynomial:
        """The load as a polynomial, without its zero terms."""
        pairs = zip(self.terms, self.coefficients, strict=True)
        return Polynomial.from_terms({t: float(b) for t, b in pairs if b != 0.0})

    @property
    def freely(self) -> Polynomial:
        """The load as the data alone have it, where physical sense was asked for."""
        values = self.coefficients if self.free is None else self.free
        pairs = zip(self.terms, values, strict=True)
        return Polynomial.from_terms({t: float(b) for t, b in pairs if b != 0.0})

    def predict(self, upper: NDArray[np.float64], lower: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value at normalised speeds (rows,)."""
        return np.asarray(design_matrix(self.terms, upper, lower) @ self.coefficients)


def huber_weights(X: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(n,) weights in (0, 1] and the robust scale of the residuals about the robust fit."""
    weights, scale = np.ones(len(y)), 0.0
    spare = max(len(y) - X.shape[1], 1)
    for _ in range(30):
        root = np.sqrt(weights)
        b = np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0]
        residual = y - X @ b
        scale = SIGMA_PER_MAD * float(np.median(np.abs(residual))) * np.sqrt(len(y) / spare)
        if scale <= 1e-12 * max(float(np.abs(y).max(initial=0.0)), 1e-300):
            return np.ones(len(y)), scale
        updated = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-300))
        if np.max(np.abs(updated - weights)) < 1e-6:
            break
        weights = updated
    return weights, scale


def least_squares(
    X: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(p,) weighted least squares of a design (n, p), a target (n,) and weights (n,)."""
    root = np.sqrt(weights)
    return np.asarray(np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0])


def row_weights(X: NDArray[np.float64], y: NDArray[np.float64], options: Options) -> NDArray[np.float64]:
    """(n,) Huber weights where the options ask for them and the rows allow it, else ones."""
    return huber_weights(X, y)[0] if options.robust and len(y) > X.shape[1] else np.ones(len(y))


def noise_weights(
    X: NDArray[np.float64], y: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) weights times 1 / variance where the scatter about a rich fit grows with the load, else as is.

    Variance as a + b load^2, from the squared residuals, and only if they follow it beyond chance: Koenker's
    form of the Breusch-Pagan test at one in a thousand. `X` must hold every term that may matter: what a poor
    model misses is not noise.
    """
    spare = len(y) - X.shape[1]
    if spare < 20:
        return weights
    load = X @ least_squares(X, y, weights)
    squared = np.minimum(weights, 1.0) * (y - load) ** 2 * len(y) / spare
    Z = np.stack([np.ones(len(y)), load**2], axis=1)
    a, b = np.linalg.lstsq(Z, squared, rcond=None)[0]
    explained = float(np.var(Z @ [a, b]) / max(np.var(squared), 1e-300))
    if b <= 0 or len(y) * explained < ONE_IN_A_THOUSAND:
        return weights
    variance = np.maximum(a, 0.0) + b * load**2
    inverse = 1.0 / np.maximum(variance, LEAST_VARIANCE * variance.mean())
    return np.asarray(weights * inverse / inverse.mean())


def orders(form: str, load: str, rows: int, options: Options) -> list[int]:
    """Orders to try: those whose dictionary leaves three rows a term."""
    tried = [o for o in range(2, options.max_order + 1) if 3 * len(forms.load_terms(form, load, o)) <= rows]
    return tried or [1]
