"""One load fitted on its dictionary: LASSO path, blocked cross-validation, one-standard-error rule, refit.

Berra, Trujillo and Heredia 2024, eq. 4, with what their own numbers ask for: terms standardised, because on
raw speeds the l1 norm keeps linear terms and drops squares; and least squares on the chosen support, because
l1 shrinks. Wild rows get Huber weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor import forms
from coaxlink.rotor.polynomial import Polynomial, design_matrix

HUBER = 2.5  # standard deviations within which a row counts in full
WILD = 6.0  # standard deviations beyond which a row is reported


@dataclass(frozen=True)
class Options:
    """How a form is fitted."""

    max_order: int = 4  # highest power of each speed that crm may use
    lambdas: int = 50  # points of the path
    standardised: bool = True  # terms to unit root mean square before the l1 norm sees them
    robust: bool = True  # Huber weights
    tolerance_N: float | None = None  # the paper's form of eq. 4 instead of cross-validation
    tolerance_Nm: float | None = None

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


@dataclass(frozen=True)
class LoadFit:
    """A fitted load."""

    terms: tuple[str, ...]  # the dictionary, (p,)
    coefficients: NDArray[np.float64]  # (p,) least squares on the support, zero elsewhere
    order: int
    lam: float
    shrunk: NDArray[np.float64]  # (p,) what the l1 problem itself gave
    history: tuple[Candidate, ...] = ()

    @property
    def polynomial(self) -> Polynomial:
        """The load as a polynomial, without its zero terms."""
        pairs = zip(self.terms, self.coefficients, strict=True)
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
        scale = 1.4826 * float(np.median(np.abs(residual))) * np.sqrt(len(y) / spare)
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
    """(p,) weighted least squares."""
    root = np.sqrt(weights)
    return np.asarray(np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0])


def orders(form: str, load: str, rows: int, options: Options) -> list[int]:
    """Orders to try: those whose dictionary leaves three rows a term."""
    tried = [o for o in range(2, options.max_order + 1) if 3 * len(forms.load_terms(form, load, o)) <= rows]
    return tried or [1]


def fit_load(
    form: str,
    load: str,
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    y: NDArray[np.float64],
    fold: NDArray[np.int64],
    options: Options,
) -> LoadFit:
    """Fit one load (rows,) of a form; crm and mutual choose order and terms on blocks left out."""
    if not forms.is_selected(form):
        terms = forms.load_terms(form, load)
        X = design_matrix(terms, upper, lower)
        b = least_squares(X, y, _weights(X, y, options))
        return LoadFit(tuple(terms), b, 2, 0.0, b)
    tolerance = options.tolerance(load)
    if tolerance is not None:
        return _by_tolerance(form, load, upper, lower, y, tolerance, options)
    tried = orders(form, load, len(y), options)
    terms_of = {o: forms.load_terms(form, load, o) for o in tried}
    widest = design_matrix(terms_of[tried[-1]], upper, lower)
    weights = _weights(widest, y, options)
    paths = [
        _path(o, terms_of[o], design_matrix(terms_of[o], upper, lower), y, weights, fold, options)
        for o in tried
    ]
    return _one_standard_error(paths, len(y))


def _weights(X: NDArray[np.float64], y: NDArray[np.float64], options: Options) -> NDArray[np.float64]:
    return huber_weights(X, y)[0] if options.robust and len(y) > X.shape[1] else np.ones(len(y))


@dataclass(frozen=True)
class _Path:
    order: int
    terms: list[str]
    lambdas: NDArray[np.float64]  # (L,)
    shrunk: NDArray[np.float64]  # (L, p)
    refitted: NDArray[np.float64]  # (L, p)
    errors: NDArray[np.float64]  # (K, L) squared error on each block


def _path(
    order: int,
    terms: list[str],
    X: NDArray[np.float64],
    y: NDArray[np.float64],
    weights: NDArray[np.float64],
    fold: NDArray[np.int64],
    options: Options,
) -> _Path:
    from coaxlink.rotor import path

    scale = np.sqrt(np.mean(X**2, axis=0)) if options.standardised else np.ones(X.shape[1])
    scale = np.where(scale > 0, scale, 1.0)
    Z = X / scale
    names = np.unique(fold)
    G, c, yy = [], [], []
    for name in names:
        rows = fold == name
        weighted = Z[rows] * weights[rows, None]
        G.append(weighted.T @ Z[rows])
        c.append(weighted.T @ y[rows])
        yy.append(weights[rows] @ y[rows] ** 2)
    G_blocks, c_blocks = np.array(G), np.array(c)
    G_all, c_all = G_blocks.sum(axis=0), c_blocks.sum(axis=0)
    lambdas = np.append(path.lambda_grid(c_all, options.lambdas), 0.0)  # the whole dictionary is a candidate
    shrunk = path.lasso_path(G_all, c_all, lambdas)
    errors = path.block_errors(G_blocks, c_blocks, np.array(yy), lambdas)
    refitted = path.refit_path(G_all, c_all, shrunk)
    return _Path(order, terms, lambdas / len(y), shrunk / scale, refitted / scale, errors)


def _one_standard_error(paths: Sequence[_Path], rows: int) -> LoadFit:
    """The fewest terms whose error is within one standard error, of the paired difference, of the best."""
    errors = np.concatenate([p.errors for p in paths], axis=1)  # (K, candidates)
    place = [(p, i) for p in paths for i in range(len(p.lambdas))]
    sizes = np.array([np.count_nonzero(p.refitted[i]) for p, i in place])
    total = errors.sum(axis=0)
    best = int(np.argmin(total))
    difference = errors - errors[:, [best]]
    spread = (
        difference.std(axis=0, ddof=1) * np.sqrt(len(errors)) if len(errors) > 1 else np.zeros(len(total))
    )
    excess = np.where(spread > 0, (total - total[best]) / np.where(spread > 0, spread, 1.0), 0.0)
    excess = np.where((spread <= 0) & (total > total[best]), np.inf, excess)
    allowed = np.flatnonzero(excess <= 1.0)
    chosen = int(min(allowed, key=lambda i: (sizes[i], total[i])))
    path, index = place[chosen]
    history = _history(place, sizes, np.sqrt(total / rows), excess, chosen)
    return LoadFit(
        tuple(path.terms),
        path.refitted[index],
        path.order,
        float(path.lambdas[index]),
        path.shrunk[index],
        history,
    )


def _history(
    place: Sequence[tuple[_Path, int]],
    sizes: NDArray[np.int64],
    rmse: NDArray[np.float64],
    excess: NDArray[np.float64],
    chosen: int,
) -> tuple[Candidate, ...]:
    """The best candidate of every order and size, and the chosen one."""
    kept: dict[tuple[int, int], int] = {}
    for i, (p, _) in enumerate(place):
        key = (p.order, int(sizes[i]))
        if key not in kept or rmse[i] < rmse[kept[key]]:
            kept[key] = i
    kept[(place[chosen][0].order, int(sizes[chosen]))] = chosen
    return tuple(
        Candidate(
            order, float(place[i][0].lambdas[place[i][1]]), size, float(rmse[i]), float(min(excess[i], 1e9))
        )
        for (order, size), i in sorted(kept.items())
    )


def _by_tolerance(
    form: str,
    load: str,
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    y: NDArray[np.float64],
    tolerance: float,
    options: Options,
) -> LoadFit:
    """The paper's own form: least l1 norm within a tolerance, order 2, refitted on the support."""
    from coaxlink.rotor.lasso import tolerance_form

    terms = forms.load_terms(form, load, min(options.max_order, 2))
    X = design_matrix(terms, upper, lower)
    scale = np.sqrt(np.mean(X**2, axis=0)) if options.standardised else np.ones(X.shape[1])
    shrunk = tolerance_form(X / scale, y, tolerance) / scale
    support = shrunk != 0
    b = np.zeros(len(terms))
    b[support] = least_squares(X[:, support], y, _weights(X[:, support], y, options))
    return LoadFit(tuple(terms), b, 2, 0.0, shrunk)
