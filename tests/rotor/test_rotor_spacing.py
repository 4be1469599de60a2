"""Rotors at several distances: a wake that decays with the spacing, and one that does not."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_bench import grid, stand

from coaxlink.errors import InputError
from coaxlink.rotor import identify
from coaxlink.rotor.spacing import spacing_model

SPACINGS = (0.3, 0.5, 0.7, 0.9)


def at(spacing: float):
    """The R-CRM whose wake weakens by 20 N a unit of spacing."""

    def loads(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        wake = -45.0 + 20.0 * spacing
        return [77.65 * u**2, 1.93 * u**2, 69.89 * v**2 + wake * u**2, 2.0 * v**2 - 0.5 * u**2]

    return loads


def identified(worlds):
    return [identify(stand(i, w), "rcrm", compare=False) for i, w in enumerate(worlds)]


def test_a_wake_that_decays_is_found_and_predicts_between() -> None:
    model = spacing_model(identified(at(s) for s in SPACINGS), SPACINGS)
    assert model.slope["lower.thrust_N"]["u_u^2"] == pytest.approx(20.0, abs=2.0)
    assert model.rmse_with["lower.thrust_N"] < 0.6 < 1.0 < model.rmse_without["lower.thrust_N"]
    u, v = grid()
    rotor = model.at(0.6)
    assert np.abs(rotor.lower_thrust(u, v) - at(0.6)(u, v)[2]).max() < 0.5
    assert rotor.form == "rcrm" and rotor.identified["rotor_spacing"] == 0.6


def test_no_slope_where_the_spacing_does_not_matter() -> None:
    model = spacing_model(identified([at(0.5)] * 4), SPACINGS)
    for load, slopes in model.slope.items():
        assert max((abs(b) for b in slopes.values()), default=0.0) < (3.0 if "thrust" in load else 0.06)
    u, v = grid()
    assert np.abs(model.at(0.9).lower_thrust(u, v) - at(0.5)(u, v)[2]).max() < 1.0


def test_what_it_cannot_do_it_says() -> None:
    results = identified([at(0.5)] * 3)
    with pytest.raises(InputError, match="3 different spacings"):
        spacing_model(results, (0.5, 0.5, 0.7))
    model = spacing_model(results, (0.3, 0.5, 0.7))
    with pytest.raises(InputError, match="were measured, found 1"):
        model.at(1.0)
