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

from coaxlink.rotor.fit import (
    Array,
    LoadFit,
    Options,
    SelectionStep,
    fit_all_terms,
    load_terms,
    noise_weights,
    nonzero,
    orders,
    row_weights,
)
from coaxlink.rotor.lasso import block_errors, lambda_grid, lasso_path, refitted
from coaxlink.rotor.polynomial import parse_term
from coaxlink.rotor.stand_data import LoadRows
from coaxlink.rotor.uncertainty import (
    ONE_STANDARD_ERROR,
    ROUNDING,
    SINGULAR,
    standard_errors_above,
    term_intervals,
)

PENALTIES = 50  # points of the path


def fit_load(form: str, rows: LoadRows, options: Options) -> LoadFit:
    """Fit one load of a form; crm chooses order and terms on blocks left out."""
    return _by_cross_validation(rows, options) if form == "crm" else fit_all_terms(form, rows)


@dataclass(frozen=True)
class _Candidate:
    """The terms that one penalty keeps, refitted."""

    tried_at: int  # order of the dictionary that it was found in
    lam: float
    terms: dict[str, float]  # without the zeros
    order: int  # of the smallest dictionary that holds its terms


def _by_cross_validation(rows: LoadRows, options: Options) -> LoadFit:
    tried = orders(rows.load, len(rows.y), options.max_order)
    designs = {o: rows.design(load_terms("crm", rows.load, o)) for o in tried}
    tried = [o for o in tried if o == tried[0] or _determined(designs[o])]
    richest = designs[tried[-1]]
    weights = noise_weights(richest, rows.y, row_weights(richest, rows.y))
    found = [_candidates(order, designs[order], rows, weights) for order in tried]
    candidates = [c for of_order, _ in found for c in of_order]
    return _one_standard_error(candidates, np.concatenate([e for _, e in found], axis=1), rows, weights)


def _determined(X: Array) -> bool:
    """Whether the rows tell every combination of the terms."""
    singular = np.linalg.svd(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300), compute_uv=False)
    return bool(singular[-1] > SINGULAR * singular[0])


def _term_scale(X: Array) -> Array:
    """(p,) root mean squares of the terms, 1 for a term that is nothing."""
    scale = np.sqrt(np.mean(X**2, axis=0))
    return np.where(scale > 0, scale, 1.0)


def _candidates(order: int, X: Array, rows: LoadRows, weights: Array) -> tuple[list[_Candidate], Array]:
    """A candidate a penalty (L) of an order's design (n, p), and its squared error on each block (K, L)."""
    scale = _term_scale(X)
    Z, y = X / scale, rows.y
    G, c, yy = [], [], []
    for name in np.unique(rows.fold):
        block = rows.fold == name
        weighted = Z[block] * weights[block, None]
        G.append(weighted.T @ Z[block])
        c.append(weighted.T @ y[block])
        yy.append(weights[block] @ y[block] ** 2)
    G_blocks, c_blocks = np.array(G), np.array(c)
    G_all, c_all = G_blocks.sum(axis=0), c_blocks.sum(axis=0)
    lambdas = np.append(lambda_grid(c_all, PENALTIES), 0.0)  # the whole dictionary is a candidate
    coefficients = refitted(G_all, c_all, lasso_path(G_all, c_all, lambdas)) / scale
    terms, lowest = load_terms("crm", rows.load, order), orders(rows.load, len(y))[0]
    candidates = []
    for lam, b in zip(lambdas / len(y), coefficients, strict=True):
        model = dict(nonzero(terms, b))
        own_order = max([lowest, *(max(parse_term(term)) for term in model)])
        candidates.append(_Candidate(order, float(lam), model, own_order))
    return candidates, block_errors(G_blocks, c_blocks, np.array(yy), lambdas)


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
