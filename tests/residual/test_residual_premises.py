"""What a doubtful premise takes is a name, never the voice: what the log holds is told all the same."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import read_flight_log
from coaxlink.premises import not_judged
from coaxlink.residual import refine
from coaxlink.residual.answer.mass_or_thrust import Scales, level_not_mass, weighing
from coaxlink.residual.refine import _whatever_lifts
from coaxlink.residual.result import Ambiguous, ChannelError, FoundEffect, Refinement, Series
from coaxlink.rotor import load_rotor_model

X8 = load_airframe(files.example("x8_paper.toml"))
WORLDS = Path(__file__).parents[3] / "shared" / "worlds" / "flight"
MODULE = sys.modules["coaxlink.residual.refine"]  # the package shows its function under that name


def found(*names):
    """An answer that names these effects of the height, 5 N in a noise of 1 N, the lift being 4 % off."""
    left = ChannelError("N", 1.0, 5.1, 1.0, (5.0, 5.2), (0.9, 1.1), 400, 5.1)
    effects = tuple(FoundEffect(n, ("force_z",), (), {"force_z": (5.1, 1.0)}, {}, "") for n in names)
    causes = {(n, "force_z"): ("height_m", np.zeros(1)) for n in (*names, "axial_inflow")}
    rows = np.zeros((1, 1))
    series = Series(np.zeros(1), ("force_z",), rows, rows, rows, causes, {"force_z": 1.0})
    answer = Refinement("flight", {"force_z": left}, effects, (), (), (), (), None, series=series)
    return replace(answer, corrections={"upper_thrust_level": 0.04, "lower_thrust_level": 0.04})


def test_what_a_withheld_name_explains_is_told_with_its_size():
    reason = not_judged("mass_kg", "the lift is 4 % off")
    reported = found("ground_effect").unnamed([reason])
    (end,) = reported.unexplained
    assert reported.effects == () and reported.cannot_judge == (reason,)
    assert (end.channel, end.depends_on) == ("force_z", ("height_m",)) and end.rmse == pytest.approx(
        5.0, 0.01
    )
    assert "ground_effect" in end.where and "mass_kg" in end.where
    group = replace(found(), ambiguous=(Ambiguous(("axial_inflow", "ground_effect"), ""),))
    assert [u.channel for u in group.unnamed([reason]).unexplained] == ["force_z"]
    assert found().unnamed([reason]).unexplained == ()


@pytest.mark.parametrize(
    ("moved", "source", "determined"),
    [
        (("ground_effect",), "declared", True),
        (("ground_effect", "mass_change"), "declared", True),
        (("axial_inflow",), "declared", False),  # the names hang on the mass
        (("ground_effect",), "estimated", False),  # nobody's word: it is to be measured first
    ],
)
def test_names_that_hang_on_no_mass_stay_where_the_lift_is_off(monkeypatch, moved, source, determined):
    frame = SimpleNamespace(
        thrust=np.full((9, 8), 24.5),
        keep=np.arange(9),
        airframe=replace(X8, sources={"mass_kg": source}),
        voltage=None,
    )
    weighed = []

    def judge(_, bare, __):
        weighed.append(bare.airframe.mass_kg)
        return found(*moved)

    monkeypatch.setattr(MODULE, "at_bounds", lambda *_: [not_judged("mass_kg", "4 % off")])
    monkeypatch.setattr(MODULE, "as_if", lambda frame, body: SimpleNamespace(airframe=body))
    monkeypatch.setattr(MODULE, "judge_flight", judge)
    reported = _whatever_lifts(found("ground_effect"), [], frame)
    assert (reported is not None) is determined
    if reported is not None:
        assert weighed == [pytest.approx(X8.mass_kg / 1.04)]
        assert [e.name for e in reported.effects] == ["ground_effect"] and reported.cannot_judge == ()
        (doubt,) = reported.ambiguous
        assert doubt.names == ("mass_change", "thrust_level") and "weigh it" in doubt.separate_by


def test_a_lift_that_is_missing_may_be_a_pack_that_nobody_logged():
    frame = SimpleNamespace(airframe=X8, voltage=None)
    assert weighing(frame, -0.04).names == ("mass_change", "thrust_level", "battery_voltage")
    assert weighing(frame, 0.04).names == ("mass_change", "thrust_level")
    assert weighing(SimpleNamespace(airframe=X8, voltage=np.full(9, 24.0)), -0.04).names == (
        "mass_change",
        "thrust_level",
    )


def test_a_mass_whose_torques_are_off_with_the_lift_is_a_doubt():
    frame = SimpleNamespace(airframe=X8, voltage=None)
    heavier, sigma = X8.mass_kg * 1.05, np.full(2, 0.002)

    def doubt(torque, sigma=sigma):
        return level_not_mass(frame, Scales(0.0, np.full(2, torque), sigma, 0.022), heavier)

    assert doubt(-0.05).names == ("mass_change", "thrust_level", "battery_voltage")
    assert doubt(0.0) is None and doubt(0.05) is None  # a mass turns nothing
    assert doubt(-0.05, 0.1 * np.ones(2)) is None  # too calm to see it
    assert doubt(-0.6) is None  # gusts, as the loops answer them


@pytest.mark.shared_data
@pytest.mark.slow
@pytest.mark.skipif(not WORLDS.is_dir(), reason="../shared/worlds is not here")
def test_a_lift_that_is_off_is_a_doubt_about_mass_and_level():
    """A stranger's flight that lifts 5.6 % off, by a mass; its pack is not logged."""
    log = read_flight_log(WORLDS / "logs" / "s1_08.csv")
    truth = json.loads((WORLDS / "truth.json").read_text())["s1_08"]
    reported = refine(
        log, load_airframe(WORLDS / truth["airframe"]), load_rotor_model(WORLDS / truth["rotor"])
    )
    assert reported.effects == ()
    assert [a.names for a in reported.ambiguous] == [("mass_change", "thrust_level", "battery_voltage")]
