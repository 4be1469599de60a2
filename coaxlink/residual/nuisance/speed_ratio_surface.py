"""What polynomials of the lower loads miss, as a spline over the ratio of the two speeds.

Blades of one pair in one air see the same angles wherever the ratio of the two speeds is the same; then their
loads grow with the square of the speeds together (similarity, Leishman 2006, ch. 2: thrust coefficients
depend on the wake's inflow ratio alone). So a load of the lower rotor is (u_u^2 + u_l^2) f(ratio), and what
Reynolds number adds to that is slow and the polynomials' own. The curve bends hardest where the lower
rotor is slow in a strong wake and stalls or windmills: the knots lie densest there. A rotor at rest is
another thing than a slow one and has a number of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from coaxlink.effects.tracing import Array
from coaxlink.residual.regression.blocks import folds_of
from coaxlink.rotor.polynomial import design_matrix

Index = NDArray[np.intp]
KNOTS = (8, 12, 18)
SUPPORT = 5.0  # rows that a column must have under it
GAIN, VARIANTS = 0.85, 0.95  # a surface must leave less than this share of the held-out squares
REST = 0.005  # normalised speed


def raw_columns(speeds: Array, knots: int, first: float) -> Array:
    """(rows, K) of speeds (rows, 2): splines over the ratio from an angle on, times the squared speeds.

    The last is the rotor at rest.
    """
    upper, lower = np.maximum(speeds[:, 0], 0.0), np.maximum(speeds[:, 1], 0.0)
    angle = np.clip(np.arctan2(lower, upper), first, np.pi / 2 - 1e-9)
    at = first + (np.pi / 2 - first) * np.linspace(0.0, 1.0, knots) ** 2
    whole = np.concatenate([[at[0]] * 3, at, [at[-1]] * 3])
    splines = BSpline.design_matrix(angle, whole, 3).toarray() * (upper**2 + lower**2)[:, None]
    return np.column_stack([splines, np.where(lower < REST, upper**2, 0.0)])


@dataclass(frozen=True)
class Surface:
    """The surface of one load, beside polynomial terms that it holds nothing of on the log's own rows."""

    knots: int
    first: float  # angle of the ratio where the curve begins
    terms: tuple[str, ...]
    used: Array  # (K,) bool: columns with rows under them
    share: Array  # (T, k) of the used columns that the polynomials have already
    coefficients: Array  # (k,)
    scale: float  # largest believable coefficient

    def columns(self, speeds: Array) -> Array:
        """(rows, k) at speeds (rows, 2)."""
        poly = design_matrix(self.terms, speeds[:, 0], speeds[:, 1])
        return np.asarray(raw_columns(speeds, self.knots, self.first)[:, self.used] - poly @ self.share)

    def __call__(self, speeds: Array) -> Array:
        """(rows,) of the load."""
        return np.asarray(self.columns(speeds) @ self.coefficients)


def find_surface(speeds: Array, load: Array, terms: tuple[str, ...], gain: float = GAIN) -> Surface | None:
    """The surface that a load (rows,) asks for beyond polynomial terms, judged on held-out rows; or None.

    It must leave less than `gain` of the squares.
    """
    poly = design_matrix(terms, speeds[:, 0], speeds[:, 1])
    scale = 2.0 * float(np.quantile(np.abs(load), 0.95))
    if not (np.isfinite(poly).all() and np.isfinite(load).all() and scale > 0.0):
        return None  # damaged readings: powers beyond numbers, or a load that reads nothing
    fold = folds_of(20, 5)[np.arange(len(load)) * 20 // len(load)]
    plain = _held_out(poly, np.zeros((len(load), 0)), load, fold, scale)
    best: tuple[float, Surface] | None = None
    turning = speeds[speeds[:, 1] >= REST]
    lowest = float(np.min(np.arctan2(turning[:, 1], np.maximum(turning[:, 0], 0.0)), initial=np.pi / 4))
    for knots, first in ((knots, first) for knots in KNOTS for first in (0.0, lowest)):
        raw = raw_columns(speeds, knots, first)
        peak = np.maximum(np.abs(raw).max(axis=0), 1e-9)
        used = (np.abs(raw) > 0.2 * peak).sum(axis=0) >= SUPPORT
        used &= peak > 1e-3
        if poly.shape[1] + used.sum() > len(load) // 4:
            break
        left = _held_out(poly, raw[:, used], load, fold, scale)
        if left < gain * plain and (best is None or left < 0.9 * best[0]):
            share = np.asarray(np.linalg.lstsq(poly, raw[:, used], rcond=1e-10)[0], float)
            fit = _fit(poly, raw[:, used], load, scale)[poly.shape[1] :]
            best = left, Surface(knots, first, terms, used, share, fit, scale)
    return best[1] if best else None


def _fit(poly: Array, raw: Array, load: Array, scale: float) -> Array:
    """(T + k,) least squares, the surface's coefficients shrunk by what is believable."""
    noise = 0.01 * scale  # of the load, generously: the shrinking is to stop runaways, no more
    prior = np.zeros((raw.shape[1], poly.shape[1] + raw.shape[1]))
    prior[:, poly.shape[1] :] = np.eye(raw.shape[1]) * noise / scale
    x = np.vstack([np.column_stack([poly, raw]), prior])
    return np.asarray(np.linalg.lstsq(x, np.concatenate([load, np.zeros(raw.shape[1])]), rcond=1e-10)[0])


def _held_out(poly: Array, raw: Array, load: Array, fold: Index, scale: float) -> float:
    out = 0.0
    for f in range(5):
        train, test = fold != f, fold == f
        fit = _fit(poly[train], raw[train], load[train], scale)
        out += float(np.sum((load[test] - np.column_stack([poly[test], raw[test]]) @ fit) ** 2))
    return out
