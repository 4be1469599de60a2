"""A rotor model with the distance between the rotors as a variable: coefficients that go linearly with it.

f(u_u, u_l, s) = sum_k (a_k + b_k (s - s_0)) u_u^{i_k} u_l^{j_k}

(not in the paper, whose stand has one spacing). The terms are those chosen at any of the spacings; a slope is
kept for a load only when it predicts a spacing that was left out better than no slope does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError
from coaxlink.rotor.fit import LoadFit, least_squares
from coaxlink.rotor.identification import Identification
from coaxlink.rotor.model import LOADS, RotorModel
from coaxlink.rotor.stand_data import LoadRows

Array = NDArray[np.float64]
FEWEST_SPACINGS = 3  # spacings: with two any slope fits


@dataclass(frozen=True)
class SpacingModel:
    """Rotor models over the spacing, in whatever unit the spacings were given."""

    form: str
    speed_max_rpm: float
    middle: float  # s_0
    spacings: tuple[float, ...]  # measured
    level: Mapping[str, Mapping[str, float]]  # load: term: a_k
    slope: Mapping[str, Mapping[str, float]]  # load: term: b_k; empty where no slope is supported
    rmse_without: Mapping[str, float]  # load: error on a spacing left out, one model for all
    rmse_with: Mapping[str, float]  # load: the same with slopes

    def at(self, spacing: float) -> RotorModel:
        """The rotor model at one spacing. Raises InputError outside the measured range."""
        low, high = min(self.spacings), max(self.spacings)
        if not low <= spacing <= high:
            raise InputError("`spacing`", "", f"{low:g} to {high:g} were measured, found {spacing:g}")
        away = spacing - self.middle
        terms = {
            load: {t: a + away * self.slope[load].get(t, 0.0) for t, a in self.level[load].items()}
            for load in LOADS
        }
        note = {"rotor_spacing": spacing, "spacings_measured": list(self.spacings)}
        return RotorModel.from_terms(self.form, self.speed_max_rpm, terms, identified=note)

    def as_json(self) -> dict[str, object]:
        """Plain numbers for the JSON report."""
        return {
            "spacings": list(self.spacings),
            "middle": self.middle,
            "level": {load: dict(t) for load, t in self.level.items()},
            "slope": {load: dict(t) for load, t in self.slope.items()},
            "rmse_without": dict(self.rmse_without),
            "rmse_with": dict(self.rmse_with),
        }


def spacing_model(results: Sequence[Identification], spacings: Sequence[float]) -> SpacingModel:
    """One model of identifications at several spacings, all with the same speed_max_rpm.

    Raises InputError for fewer than three spacings or different speeds at u = 1.
    """
    if len(set(spacings)) < FEWEST_SPACINGS:
        raise InputError(
            "`spacings`", "", f"{FEWEST_SPACINGS} different spacings at least, found {len(set(spacings))}"
        )
    if len({result.model.speed_max_rpm for result in results}) > 1:
        raise InputError("`speed_max_rpm`", "", "give one: the logs were normalised with different speeds")
    level: dict[str, dict[str, float]] = {}
    slope: dict[str, dict[str, float]] = {}
    without, with_slope = {}, {}
    middle = float(np.mean(sorted(set(spacings))))
    away = [s - middle for s in spacings]
    for load in LOADS:
        level[load], slope[load] = {}, {}
        fits = [result.fits.get(load) for result in results]
        terms = _terms([fit for fit in fits if fit is not None])
        if not terms or None in fits:
            continue
        rows = [result.data.rows(load) for result in results]
        without[load] = _left_out(rows, away, terms, sloped=False)
        with_slope[load] = _left_out(rows, away, terms, sloped=True)
        supported = with_slope[load] < without[load]
        a, b = _fit(rows, away, terms, sloped=supported)
        level[load] = dict(zip(terms, map(float, a), strict=True))
        slope[load] = dict(zip(terms, map(float, b), strict=True)) if supported else {}
    first = results[0].model
    return SpacingModel(
        first.form, first.speed_max_rpm, middle, tuple(spacings), level, slope, without, with_slope
    )


def _terms(fits: Sequence[LoadFit]) -> list[str]:
    """Every term that at least half of the spacings chose, in the order met."""
    chosen = [list(fit.polynomial.terms()) for fit in fits]
    every = dict.fromkeys(term for terms in chosen for term in terms)
    return [term for term in every if 2 * sum(term in terms for terms in chosen) >= len(chosen)]


def _fit(
    rows: Sequence[LoadRows], away: Sequence[float], terms: list[str], *, sloped: bool
) -> tuple[Array, Array]:
    """(p,) coefficients at the middle, (p,) slopes; `away` is each log's spacing from the middle."""
    designs = [r.design(terms) for r in rows]
    X = np.concatenate(designs)
    if sloped:
        X = np.column_stack([X, np.concatenate([d * s for d, s in zip(designs, away, strict=True)])])
    b = least_squares(X, np.concatenate([r.y for r in rows]))
    return b[: len(terms)], b[len(terms) :] if sloped else np.zeros(len(terms))


def _left_out(rows: Sequence[LoadRows], away: Sequence[float], terms: list[str], *, sloped: bool) -> float:
    """RMSE on each spacing by a model that has not seen it."""
    errors = []
    for out in sorted(set(away)):
        others = [i for i, s in enumerate(away) if s != out]
        a, b = _fit([rows[i] for i in others], [away[i] for i in others], terms, sloped=sloped)
        for r, s in zip(rows, away, strict=True):
            if s == out:
                errors.append(r.y - r.design(terms) @ (a + b * s))
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
