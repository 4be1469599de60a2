"""Real logs (not part of the repository): flights of real firmware, steps of a real stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import read_flight_log
from coaxlink.residual import refine
from coaxlink.rotor import load_rotor_model

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
FLIGHTS = DATA / "flights"
pytestmark = [
    pytest.mark.shared_data,
    pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the real logs are not beside the repository"),
]


def answer(name: str, lag_s: float = 0.02):
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=lag_s)
    return refine(
        read_flight_log(FLIGHTS / name), airframe, load_rotor_model(files.example("rotor_paper.toml"))
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["px4_null_fitted.ulg", "ap_null.bin"])
def test_a_flight_without_effects_gives_none(name):
    result = answer(name)
    assert result.effects == () and result.ambiguous == () and result.unexplained == ()


@pytest.mark.slow
def test_rotor_drag_is_found_alone_and_down_to_what_the_true_form_leaves():
    result = answer("px4_rotor_drag.ulg")
    assert [e.name for e in result.effects] == ["rotor_drag"]
    assert result.ambiguous == () and result.unexplained == ()
    # the motors are 2 ms slower than declared: that is little of the load, and no name
    assert any(r.name == "rotor_lag" and r.why.startswith("probability") for r in result.rejected)
    before = [result.channels[c].rmse_before for c in ("force_x", "force_y")]
    after = [result.channels[c].rmse_after for c in ("force_x", "force_y")]
    assert before == pytest.approx([6.5, 5.7], rel=0.1)
    assert after[0] < 0.32 and after[1] < 0.30  # the true form leaves 0.29 and 0.25
