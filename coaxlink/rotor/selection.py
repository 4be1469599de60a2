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

from coaxlink.constants import ONE_IN_A_THOUSAND
from coaxlink.rotor.fit import (
    FELT,
    HIGHEST,
    ROWS_A_TERM,
    Array,
    LoadFit,
    Options,
    SelectionStep,
    fit_all_terms,
    least_squares,
    load_terms,
    noise_weights,
    nonzero,
    order_of,
    orders,
    row_weights,
)
from coaxlink.rotor.lasso import lambda_grid, lasso_path, refitted
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import (
    ONE_STANDARD_ERROR,
    ROUNDING,
    SINGULAR,
    standard_errors_above,
    term_intervals,
)

PENALTIES = 50  # points of the path
FELT_SHARE = 0.2  # of the squared error of an upper load, that the lower rotor's speed explains


def fit_load(form: str, rows: LoadRows, options: Options) -> LoadFit:
    """Fit one load of a form; crm chooses order and terms on blocks left out."""
    return Selection(rows, options).fit() if form == "crm" else fit_all_terms(form, rows)


@dataclass(frozen=True)
class _Candidate:
    """The terms that one penalty keeps, refitted."""

    tried_at: int  # order of the dictionary that it was found in
    lam: float
    terms: dict[str, float]  # without the zeros
    order: int  # of the smallest dictionary that holds its terms


class Selection:
    """Terms of one load by the LASSO, from all its blocks or without one of them.

    Gram matrices of the blocks are made once, with one set of weights: a path found without two blocks serves
    both ways round.
    """

    def __init__(self, rows: LoadRows, options: Options) -> None:
        self._rows = rows
        tried = orders(rows.load, len(rows.y), options.max_order)
        designs = {o: rows.design(load_terms("crm", rows.load, o)) for o in tried}
        tried = [o for o in tried if o == tried[0] or _determined(designs[o])]
        richest = designs[tried[-1]]
        self._weights = noise_weights(richest, rows.y, row_weights(richest, rows.y))
        self._blocks = [int(b) for b in np.unique(rows.fold)]
        if rows.load.startswith("upper") and _felt(richest, rows, self._weights, options):
            designs[FELT] = rows.design(load_terms("crm", rows.load, FELT))
            tried.append(FELT)
        self._sums = {o: _Sums(designs[o], rows, self._weights, self._blocks) for o in tried}

    def fit(self, without: int | None = None) -> LoadFit:
        """The load on all rows, or on those outside a block."""
        kept = self._rows.fold != without
        rows = self._rows.among(kept)
        left = [b for b in self._blocks if b != without]
        candidates, errors = [], []
        for order, sums in self._sums.items():
            terms = load_terms("crm", rows.load, order)
            lowest = orders(rows.load, len(rows.y))[0]
            coefficients = sums.path([without])
            for lam, b in zip(sums.lambdas / len(rows.y), coefficients, strict=True):
                model = dict(nonzero(terms, b))
                own = max(lowest, order_of(rows.load, model))
                candidates.append(_Candidate(order, float(lam), model, own))
            errors.append(np.array([sums.error(sums.path([without, b]), b) for b in left]))
        return _one_standard_error(candidates, np.concatenate(errors, axis=1), rows, self._weights[kept])


class _Sums:
    """Gram matrices of one order's dictionary, a block each, and what follows from sums of them."""

    def __init__(self, X: Array, rows: LoadRows, weights: Array, blocks: Sequence[int]) -> None:
        self._scale = _term_scale(X)
        Z = X / self._scale
        self._G, self._c, self._yy = {}, {}, {}
        for block in blocks:
            inside = rows.fold == block
            weighted = Z[inside] * weights[inside, None]
            self._G[block], self._c[block] = weighted.T @ Z[inside], weighted.T @ rows.y[inside]
            self._yy[block] = float(weights[inside] @ rows.y[inside] ** 2)
        total = np.sum(list(self._c.values()), axis=0)
        self.lambdas = np.append(lambda_grid(total, PENALTIES), 0.0)  # the whole dictionary is a candidate
        self._paths: dict[frozenset[int | None], Array] = {}

    def path(self, without: Sequence[int | None]) -> Array:
        """(L, p) refitted coefficients of all penalties, found without these blocks."""
        key = frozenset(without) - {None}
        if key not in self._paths:
            kept = [b for b in self._G if b not in key]
            G, c = (np.sum([of[b] for b in kept], axis=0) for of in (self._G, self._c))
            self._paths[key] = refitted(G, c, lasso_path(G, c, self.lambdas)) / self._scale
        return self._paths[key]

    def error(self, path: Array, block: int) -> Array:
        """(L,) squared error of a path on a block that it has not seen."""
        scaled = path * self._scale
        error = (
            self._yy[block] - 2 * scaled @ self._c[block] + np.sum(scaled @ self._G[block] * scaled, axis=1)
        )
        # one model has one error, whatever a matrix product rounds from row to row
        new = np.append(True, np.any(path[1:] != path[:-1], axis=1))
        return np.asarray(
            np.maximum(error, 0.0)[np.maximum.accumulate(np.where(new, np.arange(len(path)), 0))]
        )


def _felt(X: Array, rows: LoadRows, weights: Array, options: Options) -> bool:
    """Whether an upper load goes with the lower rotor's speed, beyond chance and by more than a tenth."""
    from scipy.special import fdtrc

    if options.max_order < HIGHEST or np.ptp(rows.lower) == 0.0:
        return False
    more = np.column_stack([X, rows.design(["u_l", "u_l^2", "u_u u_l"])])
    freedom = len(rows.y) - more.shape[1]
    if freedom < ROWS_A_TERM * 3 or not _determined(more):
        return False
    root = np.sqrt(weights)
    left = [float(np.sum((root * (rows.y - M @ least_squares(M, rows.y, weights))) ** 2)) for M in (X, more)]
    gain = left[0] - left[1]
    if gain < FELT_SHARE * left[0]:
        return False
    return bool(fdtrc(3, freedom, gain / 3 / max(left[1] / freedom, 1e-300)) < ONE_IN_A_THOUSAND)


def _determined(X: Array) -> bool:
    """Whether the rows tell every combination of the terms."""
    singular = np.linalg.svd(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300), compute_uv=False)
    return bool(singular[-1] > SINGULAR * singular[0])


def _term_scale(X: Array) -> Array:
    """(p,) root mean squares of the terms, 1 for a term that is nothing."""
    scale = np.sqrt(np.mean(X**2, axis=0))
    return np.where(scale > 0, scale, 1.0)


def _one_standard_error(
    candidates: Sequence[_Candidate], errors: Array, rows: LoadRows, weights: Array
) -> LoadFit:
    """The lowest order, then the fewest of its terms, within one standard error (paired) of the best.

    The order is settled before the values are held against their intervals: choosing it by them would spoil
    what the intervals promise. Supports that the order's dictionary contradicts are passed over; when it
    contradicts all of them (collinear speeds), the intervals take the fewest terms for granted.
    """
    # what rounding makes of a Gram matrix is no difference (ten digits of the sums): one model is found at
    # many penalties and orders
    rounding = ROUNDING**2 * float(weights @ rows.y**2) / len(errors)
    errors = np.maximum(errors, rounding)
    total = np.array([float(f"{t:.10g}") for t in errors.sum(axis=0)])
    best = errors[:, [int(np.argmin(total))]]
    errors = np.where(np.abs(errors - best) > rounding, errors, best)
    excess = standard_errors_above(errors, best[:, 0])
    order = min(c.order for c, e in zip(candidates, excess, strict=True) if e <= ONE_STANDARD_ERROR)
    of_order = [i for i, c in enumerate(candidates) if c.order == order]
    allowed = sorted(
        (i for i in of_order if excess[i] <= ONE_STANDARD_ERROR),
        key=lambda i: (len(candidates[i].terms), total[i]),
    )
    rest = sorted((i for i in of_order if excess[i] > ONE_STANDARD_ERROR), key=lambda i: total[i])
    terms = load_terms("crm", rows.load, order)
    intervals = term_intervals(terms, rows.design(terms), rows.y, weights)
    agreed = next((i for i in (*allowed, *rest) if intervals.holds(candidates[i].terms)), None)
    chosen = allowed[0] if agreed is None else agreed
    model = candidates[chosen].terms
    if agreed is None:
        intervals = term_intervals(list(model), rows.design(list(model)), rows.y, weights)
    return LoadFit(
        tuple(terms),
        np.array([model.get(term, 0.0) for term in terms]),
        order,
        intervals,
        _history(candidates, np.sqrt(total / len(rows.y)), excess, chosen),
        alone=agreed is None,
    )


def _history(
    candidates: Sequence[_Candidate], rmse: Array, excess: Array, chosen: int
) -> tuple[SelectionStep, ...]:
    """The best candidate of every order and size, and the chosen one."""
    best: dict[tuple[int, int], int] = {}
    for i, c in enumerate(candidates):
        key = (c.tried_at, len(c.terms))
        if key not in best or rmse[i] < rmse[best[key]]:
            best[key] = i
    best[candidates[chosen].tried_at, len(candidates[chosen].terms)] = chosen
    return tuple(
        SelectionStep(order, candidates[i].lam, size, float(rmse[i]), float(min(excess[i], 1e9)), i == chosen)
        for (order, size), i in sorted(best.items())
    )
