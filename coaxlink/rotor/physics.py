"""What physics holds of a pair's loads where an allocator may go, and a fit that keeps to it.

Over both speeds, the lower rotor above the speed at which the wake would turn it:

    upper thrust and torque     grow with the upper speed
    lower thrust and torque     grow with the lower speed; thrust does not grow with the upper one
    torques                     are not negative

Polynomials chosen by their errors on rows bend where there are none: between rest and the slowest row, and
from the fastest to full throttle. Where they do, the same terms and those of their order are fitted again by
a quadratic programme (cvxpy), unless the rows contradict it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.load import Load
from coaxlink.rotor.fit import LoadFit, load_terms, order_of, row_weights
from coaxlink.rotor.polynomial import design_matrix, parse_term, term_name
from coaxlink.rotor.stand_data import LoadRows, StandData

Array = NDArray[np.float64]
Matrix = Callable[[list[str]], Array]  # of terms: (points, terms)
SLOWEST, FASTEST, POINTS = 0.12, 1.03, 15  # normalised speeds of the grid; slower, everything is near nothing
MARGIN = 0.02  # of a load's usual slope: flat is no better than falling, for an allocator
TOLERATED = 1.15  # times the unconstrained error on the rows: beyond, they contradict it
WAKE_DRIVES = 0.02  # of the largest lower torque: less, and the wake turns the rotor
FAST = 0.3  # of the fastest upper speed: below, a wake turns nothing


@dataclass(frozen=True)
class Held:
    """A load that keeps to physics over the whole box, or why not."""

    fit: LoadFit
    bent: bool  # the terms chosen by errors alone did not
    contradicted: bool = False  # and the rows say so: left as it was


def windmilling_ratio(data: StandData) -> float:
    """Greatest lower over upper speed at which the wake turned the lower rotor; 0 where it was never seen."""
    torque = data.loads[Load.LOWER_TORQUE.key]
    u, v = data.speeds.upper, data.speeds.lower
    if not np.isfinite(torque).any() or not np.any(u > 0):
        return 0.0
    turned = (u > FAST * u.max()) & (v > 0) & (torque < WAKE_DRIVES * np.nanmax(torque))
    return float(np.max(v[turned] / u[turned], initial=0.0))


def held_to_physics(load: Load, fit: LoadFit, rows: LoadRows, ratio: float) -> Held:
    """The fit as it is where it keeps to physics, else the nearest that does.

    `ratio` is the lower over the upper speed above which a lower rotor is driven.
    """
    terms = list(fit.polynomial.terms())
    conditions = _conditions(load, ratio, bool(np.ptp(rows.lower) > 0) or load.rotor == 1)
    kept = [matrix(terms) for matrix in conditions]
    b = np.array([fit.polynomial.terms()[t] for t in terms])
    slack = MARGIN * float(np.nanmax(np.abs(rows.y), initial=0.0))
    floors = [slack if i < len(kept) - 1 else 0.0 for i in range(len(kept))]
    if all((A @ b >= 0.0).all() for A in kept):
        return Held(fit, bent=False)
    wide = list(dict.fromkeys([*terms, *_plain_terms(load, fit.order)]))
    wide = [t for t in wide if len(rows.y) > 3 * len(wide) or t in terms]
    X = rows.design(wide)
    weights = row_weights(X, rows.y)
    found = _programme(X, rows.y, weights, [matrix(wide) for matrix in conditions], floors)
    if found is None:
        return Held(fit, bent=True, contradicted=True)
    before = _rms(rows.y - fit.predict(rows.upper, rows.lower), weights)
    if _rms(rows.y - X @ found, weights) > TOLERATED * before:
        return Held(fit, bent=True, contradicted=True)
    order = max(fit.order, order_of(load.key, wide))
    return Held(replace(fit, terms=tuple(wide), coefficients=found, order=order), bent=True)


def physics_notes(held: Mapping[str, Held]) -> Iterator[str]:
    """What became of loads whose errors alone would have bent them."""
    bent = [load for load, h in held.items() if h.bent and not h.contradicted]
    against = [load for load, h in held.items() if h.contradicted]
    if bent:
        yield f"kept to physics between and beyond the rows, at their error: {', '.join(bent)}"
    if against:
        yield f"the rows contradict slopes that physics expects: {', '.join(against)} (left as measured)"


def _plain_terms(load: Load, order: int) -> list[str]:
    """Terms of an order without a constant, which an allocator would take for thrust at rest."""
    if load.rotor == 0:
        return [t for t in load_terms("crm", load.key, max(order, 3)) if t != "1"]
    most = max(order, 3)
    return [term_name(a, t - a) for t in range(1, most + 1) for a in range(t + 1)]


def _conditions(load: Load, ratio: float, both: bool) -> list[Matrix]:
    """Of terms, matrices whose product with the coefficients is not to be negative."""
    axis = np.linspace(SLOWEST, FASTEST, POINTS)
    u, v = (g.ravel() for g in np.meshgrid(np.append(0.0, axis), np.append(0.0, axis), indexing="ij"))
    if not both:
        u, v = axis, np.zeros_like(axis)
    driven = v >= ratio * u if load.rotor == 1 else np.ones(len(u), bool)
    moving = driven & ((v if load.rotor == 1 else u) >= SLOWEST)
    u, v = u[moving], v[moving]

    def slope(side: int, sign: float) -> Matrix:
        def of(terms: list[str]) -> Array:
            columns = []
            for a, b in map(parse_term, terms):
                p, q = (a - 1, b) if side == 0 else (a, b - 1)
                columns.append((a, b)[side] * u ** max(p, 0) * v ** max(q, 0))
            return sign * np.stack(columns, axis=1)

        return of

    own = slope(load.rotor, 1.0)
    found = [own]
    if load is Load.LOWER_THRUST:
        found.append(slope(0, -1.0))
    if load.quantity == "torque":
        found.append(lambda terms: design_matrix(terms, u, v))
    return found if len(found) > 1 else [own, lambda terms: np.zeros((1, len(terms)))]


def _programme(X: Array, y: Array, weights: Array, kept: list[Array], floors: list[float]) -> Array | None:
    import cvxpy as cp

    scale = np.sqrt(np.mean(X**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    root = np.sqrt(weights)[:, None]
    q, r = np.linalg.qr(X / scale * root)
    b = cp.Variable(X.shape[1])
    limits = [A / scale @ b >= floor for A, floor in zip(kept, floors, strict=True)]
    target = q.T @ (y * root[:, 0])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(r @ b - target) + 1e-9 * cp.sum_squares(b)), limits)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return None
    return None if b.value is None else np.asarray(b.value / scale, float)


def _rms(left: Array, weights: Array) -> float:
    return float(np.sqrt(np.average(left**2, weights=weights)))
