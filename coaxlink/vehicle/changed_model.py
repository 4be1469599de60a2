"""A rotor model changed by what effects do to its surfaces, as polynomials again.

Effects may hold powers that are no integers; laws want polynomials. What an effect *changes* is fitted
over the speeds that fly and added to the base terms, so that a model without effects stays what it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.static import Change, Loads
from coaxlink.load import Load
from coaxlink.rotor import RotorModel
from coaxlink.rotor.polynomial import design_matrix, term_name

Array = NDArray[np.float64]
LOWEST, POINTS, ORDER = 0.1, 31, 4  # normalised speeds of the fit; total order of the change
SMALL = 1e-9  # N, N m: an effect that changes nothing


def changed_model(model: RotorModel, changes: Sequence[Change]) -> RotorModel:
    """The model with `changes` (each from the base model and the loads so far to new loads) in its terms."""
    axis = np.linspace(LOWEST, 1.0, POINTS)
    upper, lower = (x.ravel() for x in np.meshgrid(axis, axis, indexing="ij"))
    pair = model.loads(upper, lower)
    loads = Loads(upper, lower, *(pair[load] for load in Load))
    for change in changes:
        loads = change(model, loads)
    names = [term_name(a, t - a) for t in range(1, ORDER + 1) for a in range(t + 1)]
    matrix = design_matrix(names, upper, lower)
    added = {}
    for load in Load:
        difference = loads[load] - pair[load]
        if np.abs(difference).max() < SMALL:
            continue
        fit = np.linalg.lstsq(matrix, difference, rcond=None)[0]
        keep = np.abs(fit) > 1e-12 * np.abs(fit).max()
        added[load.key] = {name: float(c) for name, c, k in zip(names, fit, keep, strict=True) if k}
    return with_terms(model, added)


def with_terms(model: RotorModel, added: Mapping[str, Mapping[str, float]]) -> RotorModel:
    """The model with {load: {term: coefficient}} added to its terms."""
    terms = {load: dict(named) for load, named in model.terms().items()}
    for load, named in added.items():
        for name, c in named.items():
            terms[load][name] = terms[load].get(name, 0.0) + c
    return model.having(terms)
