"""One load fitted on its dictionary: LASSO path, blocked cross-validation, one-standard-error rule, refit.

Berra, Trujillo and Heredia 2024, eq. 4, with what their own numbers ask for: terms standardised, because on
raw speeds the l1 norm keeps linear terms and drops squares; and least squares on the chosen support, because
l1 shrinks. Outliers get Huber weights. A support is taken only if each of its values lies in the interval
that the whole dictionary gives it: a value that its own data contradict is an artefact of what was left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.rotor import forms
from coaxlink.rotor.fit import Candidate, LoadFit, Options, least_squares, noise_weights, orders, row_weights
from coaxlink.rotor.intervals import ROUNDING, SINGULAR, term_intervals
from coaxlink.rotor.polynomial import design_matrix, parse_term

LOWEST = 2  # order of the smallest dictionary: squares are what momentum theory asks for


@dataclass(frozen=True)
class _Data:
    """The rows of one load."""

    form: str
    load: str
    upper: NDArray[np.float64]  # (n,)
    lower: NDArray[np.float64]  # (n,)
    y: NDArray[np.float64]  # (n,) N or N m
    fold: NDArray[np.int64]  # (n,)

    def terms(self, order: int = LOWEST) -> list[str]:
        return forms.load_terms(self.form, self.load, order)

    def design(self, terms: Sequence[str]) -> NDArray[np.float64]:
        return design_matrix(terms, self.upper, self.lower)


def fit_load(
    form: str,
    load: str,
    upper: NDArray[np.float64],
    lower: NDArray[np.float64],
    y: NDArray[np.float64],
    fold: NDArray[np.int64],
    options: Options,
) -> LoadFit:
    """Fit one load (rows,) of a form; crm and mutual choose order and terms on blocks left out.

    Raises InfeasibleTolerance when a tolerance is asked for that no coefficients reach.
    """
    if form == "surface":
        from coaxlink.rotor.smooth import fit_surface

        return fit_surface(load, upper, lower, y, options)
    data = _Data(form, load, upper, lower, y, fold)
    tolerance = options.tolerance(load)
    if not forms.is_selected(form):
        fit = _least_squares(data, options)
    elif tolerance is not None:
        fit = _by_tolerance(data, tolerance, options)
    else:
        fit = _by_cross_validation(data, options)
    if not options.physical:
        return fit
    from coaxlink.rotor.physical import constrained

    return constrained(fit, data.load, upper, lower, y, row_weights(data.design(fit.terms), y, options))


def _least_squares(data: _Data, options: Options) -> LoadFit:
    terms = data.terms()
    X = data.design(terms)
    weights = row_weights(X, data.y, options)
    b = least_squares(X, data.y, weights)
    return LoadFit(tuple(terms), b, LOWEST, 0.0, b, term_intervals(terms, X, data.y, weights))


@dataclass(frozen=True)
class _Path:
    order: int
    terms: list[str]
    lambdas: NDArray[np.float64]  # (L,)
    shrunk: NDArray[np.float64]  # (L, p)
    refitted: NDArray[np.float64]  # (L, p)
    errors: NDArray[np.float64]  # (K, L) squared error on each block

    def values(self, index: int) -> dict[str, float]:
        """The refitted model at one penalty, without its zero terms."""
        return {t: float(b) for t, b in zip(self.terms, self.refitted[index], strict=True) if b != 0.0}


def _by_cross_validation(data: _Data, options: Options) -> LoadFit:
    tried = orders(data.form, data.load, len(data.y), options)
    tried = [o for o in tried if o == tried[0] or _determined(data.design(data.terms(o)))]
    richest = data.design(data.terms(tried[-1]))
    weights = noise_weights(richest, data.y, row_weights(richest, data.y, options))
    paths = [_path(order, data, weights, options) for order in tried]
    return _one_standard_error(paths, data, weights)


def _determined(X: NDArray[np.float64]) -> bool:
    """Whether the rows tell every combination of the terms."""
    singular = np.linalg.svd(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300), compute_uv=False)
    return bool(singular[-1] > SINGULAR * singular[0])


def _path(order: int, data: _Data, weights: NDArray[np.float64], options: Options) -> _Path:
    from coaxlink.rotor import path

    terms = data.terms(order)
    X, y = data.design(terms), data.y
    scale = np.sqrt(np.mean(X**2, axis=0)) if options.standardised else np.ones(X.shape[1])
    scale = np.where(scale > 0, scale, 1.0)
    Z = X / scale
    G, c, yy = [], [], []
    for name in np.unique(data.fold):
        rows = data.fold == name
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


def _one_standard_error(paths: Sequence[_Path], data: _Data, weights: NDArray[np.float64]) -> LoadFit:
    """The lowest order, then the fewest of its terms, within one standard error (paired) of the best.

    The order is settled before the values are held against their intervals: choosing it by them would spoil
    what the intervals promise. Supports that the order's dictionary contradicts are passed over; when it
    contradicts all of them (collinear speeds), the intervals take the fewest terms for granted.
    """
    # (K, candidates); what rounding makes of a Gram matrix is no difference: a log without noise has no other
    rounding = ROUNDING**2 * float(weights @ data.y**2) / len(paths[0].errors)
    errors = np.maximum(np.concatenate([p.errors for p in paths], axis=1), rounding)
    candidates = [(p, i) for p in paths for i in range(len(p.lambdas))]
    models = [p.values(i) for p, i in candidates]
    total, excess = errors.sum(axis=0), _excess(errors)
    orders_of = np.array([_order(m, data) for m in models])
    order = int(orders_of[excess <= 1.0].min())
    allowed = sorted(
        np.flatnonzero((excess <= 1.0) & (orders_of == order)), key=lambda i: (len(models[i]), total[i])
    )
    rest = sorted(np.flatnonzero((excess > 1.0) & (orders_of == order)), key=lambda i: total[i])
    terms = data.terms(order)
    intervals = term_intervals(terms, data.design(terms), data.y, weights)
    agreed = next((int(i) for i in (*allowed, *rest) if intervals.holds(models[i])), None)
    chosen = int(allowed[0]) if agreed is None else agreed
    if agreed is None:
        own = list(models[chosen])
        intervals = term_intervals(own, data.design(own), data.y, weights)
    path, index = candidates[chosen]
    shrunk = dict(zip(path.terms, path.shrunk[index], strict=True))
    sizes = np.array([len(m) for m in models])
    return LoadFit(
        tuple(terms),
        np.array([models[chosen].get(term, 0.0) for term in terms]),
        order,
        float(path.lambdas[index]),
        np.array([shrunk.get(term, 0.0) for term in terms]),
        intervals,
        _history(candidates, sizes, np.sqrt(total / len(data.y)), excess, chosen),
        alone=agreed is None,
    )


def _order(model: dict[str, float], data: _Data) -> int:
    """Order of the smallest dictionary that holds a model's terms."""
    lowest = orders(data.form, data.load, len(data.y), Options())[0]
    return max([lowest, *(max(parse_term(term)) for term in model)])


def _excess(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(candidates,) error above the best one's, in standard errors of their difference over blocks (K, .)."""
    total = errors.sum(axis=0)
    difference = errors - errors[:, [int(np.argmin(total))]]
    spread = (
        difference.std(axis=0, ddof=1) * np.sqrt(len(errors)) if len(errors) > 1 else np.zeros(len(total))
    )
    above = total - total.min()
    return np.where(spread > 0, above / np.where(spread > 0, spread, 1.0), np.where(above > 0, np.inf, 0.0))


def _history(
    candidates: Sequence[tuple[_Path, int]],
    sizes: NDArray[np.int64],
    rmse: NDArray[np.float64],
    excess: NDArray[np.float64],
    chosen: int,
) -> tuple[Candidate, ...]:
    """The best candidate of every order and size, and the chosen one."""
    best: dict[tuple[int, int], int] = {}
    for i, (p, _) in enumerate(candidates):
        key = (p.order, int(sizes[i]))
        if key not in best or rmse[i] < rmse[best[key]]:
            best[key] = i
    best[(candidates[chosen][0].order, int(sizes[chosen]))] = chosen
    return tuple(
        Candidate(
            order,
            float(candidates[i][0].lambdas[candidates[i][1]]),
            size,
            float(rmse[i]),
            float(min(excess[i], 1e9)),
            i == chosen,
        )
        for (order, size), i in sorted(best.items())
    )


def _by_tolerance(data: _Data, tolerance: float, options: Options) -> LoadFit:
    """The paper's own form: least l1 norm within a tolerance, order 2, refitted on the support.

    Its intervals are those of the terms it kept: a wide tolerance means to leave out what the data show.
    """
    from coaxlink.rotor.lasso import tolerance_form

    terms = data.terms(min(options.max_order, LOWEST))
    X = data.design(terms)
    scale = np.sqrt(np.mean(X**2, axis=0)) if options.standardised else np.ones(X.shape[1])
    scale = np.where(scale > 0, scale, 1.0)
    shrunk = tolerance_form(X / scale, data.y, tolerance) / scale
    support = shrunk != 0
    selected = [t for t, on in zip(terms, support, strict=True) if on]
    weights = row_weights(X[:, support], data.y, options)
    b = np.zeros(len(terms))
    b[support] = least_squares(X[:, support], data.y, weights)
    intervals = term_intervals(selected, X[:, support], data.y, weights)
    return LoadFit(tuple(terms), b, LOWEST, 0.0, shrunk, intervals, alone=True)
