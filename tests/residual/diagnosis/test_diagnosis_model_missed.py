"""What a rotor model left of its stand log is no effect of a flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.residual import refine
from coaxlink.rotor.model import Load

LAG_S = 0.02


def test_what_a_model_missed_is_its_held_out_error_beyond_the_noise(paper):
    channels = [load.channel for load in Load]
    errors = {name: {"rmse": 0.5} for name in channels[:3]}
    floors = {channels[0]: 0.3, channels[1]: 0.6}
    model = replace(paper, identified={"errors": errors, "noise_floor": floors})
    assert model.missed == pytest.approx({Load(0): 0.4, Load(2): 0.5})
    assert paper.missed == {}
    by_hand = {"errors": {channels[0]: "small", channels[1]: {"rmse": -1.0}}, "noise_floor": 3}
    assert replace(paper, identified=by_hand).missed == {}


def bent(paper, size_N: float, period: float):
    """The paper's model with upper rotors that pull so much more or less from one speed to the next."""
    u = np.linspace(0.35, 0.75, 500)
    wave = Polynomial.fit(u, size_N * np.sin(2.0 * np.pi * u / period), 12).convert().coef
    terms = paper.terms()
    own = terms["upper.thrust_N"]
    powers = {("1" if k == 0 else "u_u" if k == 1 else f"u_u^{k}"): c for k, c in enumerate(wave)}
    terms["upper.thrust_N"] = {t: powers.get(t, 0.0) + own.get(t, 0.0) for t in {**own, **powers}}
    return paper.having(terms)


@pytest.mark.slow
def test_a_bend_of_the_rotors_that_the_stand_left_open_is_not_found_again_as_an_effect(paper):
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=LAG_S)
    log, model = Samples(fly([{}], seed=3, lag=LAG_S)[0], "flown"), bent(paper, 0.5, 0.15)
    knowing = replace(model, identified={"errors": {"upper_thrust": {"rmse": 0.4}}})
    with_it, without = (refine(log, airframe, m) for m in (knowing, model))
    assert not with_it.effects and not with_it.unexplained
    assert without.effects or without.unexplained or without.ambiguous
