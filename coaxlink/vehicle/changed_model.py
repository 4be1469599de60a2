"""A rotor model changed by what effects do to its surfaces, as polynomials again.

Effects may hold powers that are no integers; laws want polynomials. What an effect *changes* is fitted
over the speeds that fly and added to the base terms, so that a model without effects stays what it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.effects.static import Change, Loads
from coaxlink.load import Load
from coaxlink.rotor import RotorModel
from coaxlink.rotor.polynomial import Polynomial, design_matrix, term_name

Array = NDArray[np.float64]
LOWEST, POINTS, ORDER = 0.1, 31, 4  # normalised speeds of the fit; total order of the change
SMALL = 1e-9


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


def over_commands(model: RotorModel, rotors: RotorModel) -> RotorModel:
    """The model with u the throttle, where `rotors` knows what speeds (u of `model`) throttles give."""
    if not rotors.rpm_over_throttle:
        return model

    def bent(speeds: RotorModel, loads: Loads) -> Loads:
        turned = speeds.loads(rotors.turned(loads.upper, "upper"), rotors.turned(loads.lower, "lower"))
        return loads.plus({load: turned[load] - loads[load] for load in Load})

    return changed_model(model, [bent]).by_speed()


def scaled_speed(model: RotorModel, factor: float) -> RotorModel:
    """The same rotors in another unit of speed: u = 1 of the result is u = `factor` of `model`."""
    if factor == 1.0:
        return model

    def scaled(p: Polynomial) -> Polynomial:
        pairs = zip(p.exponents, p.coefficients, strict=True)
        return Polynomial(p.exponents, tuple(c * factor ** (a + b) for (a, b), c in pairs))

    surfaces: dict[str, Any] = {load.channel: scaled(model.surface(load)) for load in Load}
    return replace(model, speed_max_rpm=model.speed_max_rpm * factor, **surfaces)
