"""What physics holds of a pair's loads where an allocator may go, and a fit that keeps to it.

Over both speeds, the lower rotor above the speed at which the wake would turn it:

    upper thrust and torque     grow with the upper speed
    lower thrust and torque     grow with the lower speed; thrust does not grow with the upper one
    torques                     are not negative

Polynomials chosen by their errors on rows bend where there are none: between rest and the slowest row, and
from the fastest to full throttle. Where they do, the same terms and those of their order are fitted again by
a quadratic programme. Whether rows contradict that is for held-out errors to say (`identification`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.constants import ONE_IN_A_THOUSAND
from coaxlink.load import Load
from coaxlink.rotor.fit import FELT, LoadFit, order_of, row_weights
from coaxlink.rotor.polynomial import design_matrix, parse_term, term_name
from coaxlink.rotor.stand_data import LoadRows, StandData

Array = NDArray[np.float64]
Matrix = Callable[[list[str]], Array]  # of terms: (points, terms)
SLOWEST, FASTEST, POINTS = 0.12, 1.05, 16  # normalised speeds of the grid; slower, everything is near nothing
MARGIN = 0.02  # of a load's usual slope: flat is no better than falling, for an allocator
WAKE_DRIVES = 0.02  # of the largest lower torque: less, and the wake turns the rotor
WAKE_TURNS = 0.3  # of the fastest upper speed: below, a wake turns nothing
ROWS_A_HELD_TERM = 2  # fewer than of a free fit: the conditions tell what rows do not
ROUNDED, RIDGE = 1e-9, 1e-12  # of a slope; of the programme's own size, for terms the rows cannot tell apart


def windmilling_ratio(data: StandData, among: NDArray[np.bool_] | None = None) -> float:
    """Greatest lower over upper speed at which the wake turned the lower rotor, of all rows or of a mask.

    0 where it was never seen.
    """
    among = np.ones(data.samples.rows, bool) if among is None else among
    torque = data.loads[Load.LOWER_TORQUE.key][among]
    u, v = data.speeds.upper[among], data.speeds.lower[among]
    if not np.isfinite(torque).any() or not np.any(u > 0):
        return 0.0
    turned = (u > WAKE_TURNS * u.max()) & (v > 0) & (torque < WAKE_DRIVES * np.nanmax(torque))
    return float(np.max(v[turned] / u[turned], initial=0.0))


def keeps_to_physics(load: Load, fit: LoadFit, rows: LoadRows, ratio: float) -> bool:
    """Whether a load does over the whole box; `ratio` is `windmilling_ratio`."""
    terms = list(fit.polynomial.terms())
    b = np.array([fit.polynomial.terms()[t] for t in terms])
    return not terms or all(
        (matrix(terms) @ b >= -ROUNDED).all() for matrix, _ in _conditions(load, rows, ratio)
    )


def held_to_physics(load: Load, fit: LoadFit, rows: LoadRows, ratio: float, order: int = 0) -> LoadFit:
    """The fit itself where it keeps to physics or nothing does, else the nearest that does.

    Of its own terms, and with an `order` of those of it as far as the rows tell them.
    """
    if keeps_to_physics(load, fit, rows, ratio):
        return fit
    own = list(fit.polynomial.terms())
    terms = list(dict.fromkeys([*own, *(_plain_terms(load, fit, order) if order else [])]))
    if len(rows.y) < ROWS_A_HELD_TERM * len(terms):
        terms = own
    X = rows.design(terms)
    conditions = [(matrix(terms), floor) for matrix, floor in _conditions(load, rows, ratio)]
    b = _programme(X, rows.y, row_weights(rows.design(own), rows.y), conditions)
    if b is None:
        return fit
    return replace(fit, terms=tuple(terms), coefficients=b, order=max(fit.order, order_of(load.key, terms)))


def misses_rows(held: LoadFit, free: LoadFit, rows: LoadRows) -> bool:
    """Whether a fit scatters about rows it saw by more than another, beyond chance: a test of variances."""
    from scipy.special import fdtrc

    scatter, freedom = [], []
    for fit in (held, free):
        freedom.append(max(len(rows.y) - len(fit.polynomial.terms()), 1))
        scatter.append(float(np.sum((rows.y - fit.predict(rows.upper, rows.lower)) ** 2)) / freedom[-1])
    return bool(fdtrc(*freedom, scatter[0] / max(scatter[1], 1e-300)) < ONE_IN_A_THOUSAND)


def _plain_terms(load: Load, fit: LoadFit, order: int) -> list[str]:
    """Terms of an order without a constant, which an allocator would take for thrust at rest."""
    if load.rotor == 0 and fit.order < FELT:
        return [term_name(a, 0) for a in range(1, order + 1)]
    return [term_name(a, t - a) for t in range(1, order + 1) for a in range(t + 1)]


def _conditions(load: Load, rows: LoadRows, ratio: float) -> list[tuple[Matrix, float]]:
    """Of terms, matrices whose product with the coefficients is to be at or above a floor."""
    axis = np.linspace(SLOWEST, FASTEST, POINTS)
    u, v = (g.ravel() for g in np.meshgrid(np.append(0.0, axis), np.append(0.0, axis), indexing="ij"))
    if load.rotor == 0 and np.ptp(rows.lower) == 0:
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

    found = [(slope(load.rotor, 1.0), MARGIN * float(np.max(np.abs(rows.y))))]
    if load is Load.LOWER_THRUST:
        found.append((slope(0, -1.0), 0.0))
    if load.quantity == "torque":
        found.append((lambda terms: design_matrix(terms, u, v), 0.0))
    return found


def _programme(X: Array, y: Array, weights: Array, kept: list[tuple[Array, float]]) -> Array | None:
    """(p,) least squares of a design (n, p) with every matrix times it at or above its floor; None: none is.

    Clarabel itself: cvxpy would take a second to load and to pose what stands here in its form.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    scale = np.sqrt(np.mean(X**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    Z = X / scale
    size = max(float(weights @ y**2), 1e-300)  # the programme's numbers near one
    P = (Z.T * weights) @ Z / size
    A = -np.concatenate([matrix / scale for matrix, _ in kept])
    floors = np.concatenate([np.full(len(matrix), -floor) for matrix, floor in kept])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        csc_matrix(np.triu(P + RIDGE * np.trace(P) * np.eye(len(P)))), -(Z.T * weights) @ y / size,
        csc_matrix(A), floors, [clarabel.NonnegativeConeT(len(floors))], settings,
    )  # fmt: skip
    found = solver.solve()
    return np.array(found.x) / scale if found.status == clarabel.SolverStatus.Solved else None
