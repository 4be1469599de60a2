"""Flights by a stand's evidence: which rotor lost something, and what a flight would have shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.channels.flight import flight_frame
from coaxlink.data import Samples
from coaxlink.effects import effect
from coaxlink.frames import FLIGHT_CHANNELS
from coaxlink.residual import refine
from coaxlink.residual.answer import judge_flight as answers
from coaxlink.residual.diagnosis.flight import flight_channels
from coaxlink.residual.diagnosis.rotors import Place, places, undecided
from coaxlink.residual.experiments.manoeuvres import flight_experiment
from coaxlink.residual.experiments.stand_run import Rival
from coaxlink.residual.members import member
from coaxlink.rotor import load_rotor_model

pytestmark = pytest.mark.slow


CHIPPED, DRAGGED, SOUND = range(3)


@pytest.fixture(scope="module")
def flights():
    logs = fly([{"weak": (3, 0.15)}, {"drag": 0.08}, {}], seconds=16.0, seed=4)
    airframe = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
    model = load_rotor_model(files.example("rotor_paper.toml"))
    return [(Samples(log, "made"), airframe, model) for log in logs]


def weak(frame, rotor):
    weak = effect("degraded_rotor").flight
    return member(frame, weak, *weak.inverse(frame, {"rotor": rotor, "thrust_loss": 0.1, "torque_loss": 0.0}))


def test_the_partner_of_a_pair_is_weighed_wherever_the_search_began(flights, capfd):
    log, *vehicle = flights[CHIPPED]
    frame = flight_frame([log], *vehicle)
    first = places(flight_channels(frame), [weak(frame, 8.0)])[0]
    assert first.rotor == 3 and first.probability > 0.99
    assert first.member.parameters(frame)["thrust_loss"] == pytest.approx(0.15, abs=0.02)
    assert capfd.readouterr() == ("", "")  # nor has LAPACK anything to say


def test_two_rotors_that_nothing_decides_between_are_a_doubt_and_no_name(flights, monkeypatch):
    def open_ended(ch, members):
        frame = ch.bare
        return [Place(3, 0.75, weak(frame, 3.0)), Place(8, 0.25, weak(frame, 8.0))]

    monkeypatch.setattr(answers, "places", open_ended)
    reported = refine(*flights[CHIPPED])
    assert not reported.effects and reported.names == {"degraded_rotor"}
    (doubt,) = reported.ambiguous
    assert doubt.names == ("degraded_rotor of rotor 3", "degraded_rotor of rotor 8")
    sure, rest = doubt.probability  # as sure as the name is, shared as the rotors' are
    assert 0.6 < sure < 0.75 and sure == pytest.approx(3.0 * rest, abs=2e-4)


def test_a_rotor_is_claimed_where_all_others_together_are_improbable():
    def at(*shares):
        return [Place(k, p, None) for k, p in enumerate(shares, 1)]  # type: ignore[arg-type]

    assert [p.rotor for p in undecided(at(0.77, 0.21, 0.02))] == [1, 2, 3]
    assert undecided(at(0.995, 0.005)) == undecided(at(0.985, 0.009, 0.006)) == []


def test_where_no_rotor_explains_anything_all_stay_as_likely(flights):
    log, *vehicle = flights[SOUND]
    frame = flight_frame([log], *vehicle)
    found = places(flight_channels(frame), [weak(frame, 3.0)])
    assert found[0].probability < 0.99 and sum(p.probability for p in found) == pytest.approx(1.0)


def test_a_manoeuvre_that_does_not_show_a_rival_is_left_out_of_the_plan(flights):
    log, *vehicle = flights[SOUND]
    frame = flight_frame([log], *vehicle)
    numbers = {"axial_inflow": {"thrust_per_climb_N_s_m": 3.0}, "mass_change": {"mass_kg": 9.0}}
    plan = flight_experiment(frame, np.ones(6), [Rival(effect(n).flight, p) for n, p in numbers.items()])
    assert plan is None or not any("hover" in piece.what for piece in plan.pieces)


def test_what_would_have_been_shown_is_named_where_it_is_there(flights):
    sound = {w.name: w.share for w in refine(*flights[SOUND]).would_show}
    assert {"degraded_rotor", "rotor_drag", "cg_offset", "mass_change"} <= set(sound)
    assert all(0.0 < share < 0.3 for share in sound.values())
    dragged = refine(*flights[DRAGGED])
    (drag,) = dragged.effects
    assert drag.name == "rotor_drag" and 0.9 < drag.evidence["probability"] <= 1.0
    assert dragged.weighed[0]["numbers"]["tempered"] > 50.0
    assert "rotor_drag" not in {w.name for w in dragged.would_show}


def test_a_lag_that_hides_among_delays_is_not_promised(flights):
    """Commands ten times a second; every motor 20 ms slower than declared."""
    _, declared, model = flights[SOUND]
    log = Samples(fly([{"lag": 0.02}], log_rate=10.0)[0], "slower")
    found = refine(log, declared, model)
    shown = {w.name: (w.share, w.channel) for w in found.would_show}
    slower = replace(declared, motor_lag_s=declared.motor_lag_s + 0.02)
    there, due = (flight_frame([log], body, model) for body in (slower, declared))
    moved = np.quantile(np.abs(there.predicted - due.predicted), 0.95, axis=0) / due.reference
    least, channel = shown.get("rotor_lag", (np.inf, "force_z"))
    assert "rotor_lag" in found.names or moved[FLIGHT_CHANNELS.index(channel)] < least
