"""No verdict beyond its premises, on flights of a world of this project's own."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from case_table import case_table
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.channels.flight import flight_frame
from coaxlink.data import Samples
from coaxlink.data.samples import DAMAGED
from coaxlink.errors import InputError
from coaxlink.health.judge import Health
from coaxlink.health.premises import judged
from coaxlink.instruments.flight.inputs import checked
from coaxlink.premises import as_if, moves, other_vehicle, unseen
from coaxlink.premises.same_vehicle import Flown, differs
from coaxlink.residual import refine
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor_update.premises import flown_by
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Vehicle, load_vehicle
from sim.effects import HiddenEffect
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

X8 = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
ROTORS = load_rotor_model(files.example("rotor_paper.toml"))
GUESSED = {"inertia_kg_m2": "estimated", "motor_lag_s": "default"}
MEASURED = dict.fromkeys(("mass_kg", "inertia_kg_m2", "motor_lag_s"), "measured")
WEAK = 3


@pytest.fixture(scope="module")
def flights():
    """A sound flight, and one with a weak rotor."""
    seconds = 44.0  # hover, circles, a climb and down again
    sound, weak = fly([{}, {"weak": (WEAK, 0.25)}], seconds=seconds)
    return Samples(sound, "sound.csv"), Samples(weak, "weak.csv")


def body(airframe=X8, **changed):
    return Vehicle(replace(airframe, **changed), ROTORS)


def motors(log, order):
    """The log with `order[k]`'s command under the name of motor k."""
    return log.with_columns(**{f"motor{k}": log[f"motor{n}"] for k, n in enumerate(order, start=1)})


def rpm(log, order=range(1, 9), scale=1.0):
    rows = {f"rpm{k}": scale * 5400.0 * log[f"motor{n}"] for k, n in enumerate(order, start=1)}
    return log.with_columns(**rows)


def amperes(log, order=range(1, 9)):
    """Of each motor's shaft at 25 V, as `order[k]`'s ESC tells it under the name of motor k."""
    commands = np.stack([log[f"motor{k}"] for k in range(1, 9)], axis=1)
    shaft = X8.loads(ROTORS, commands)[1] * commands * ROTORS.speed_max_rpm * np.pi / 30
    rows = {f"current{k}_A": 0.3 + shaft[:, n - 1] / 20.0 for k, n in enumerate(order, start=1)}
    return log.with_columns(**rows)


def apart(log, share=0.8):
    """As a table flies whose lower rotors turn faster: motors with commands of their own."""
    return log.with_columns(**{f"motor{k}": share * log[f"motor{k}"] for k in range(1, 5)})


@pytest.mark.slow
def test_a_vehicle_that_is_not_this_one_is_told_by_its_number(flights):
    sound, _ = flights
    places = [(*np.sqrt(0.5) * np.array([x - y, x + y]), z) for x, y, z in (r.position_m for r in X8.rotors)]
    plus = tuple(replace(r, position_m=place) for r, place in zip(X8.rotors, places, strict=True))
    inertia = tuple(3.0 * x for x in X8.inertia_kg_m2)
    missing = sound.without(*(f"motor{k}" for k in range(5, 9)))
    refined = set()  # by one log of each check: it asks as health does
    with case_table() as case:
        for name, log, vehicle, check in (
            ("48 kg", sound, body(mass_kg=48.0), "lift"),
            ("16 kg", sound, body(mass_kg=16.0), "lift"),
            ("a quad's log", missing, body(), "motors"),
            ("arms turned by 45 degrees", sound, body(rotors=plus), "outputs"),
            ("three times the inertia", sound, body(inertia_kg_m2=inertia), "response"),
            ("two outputs exchanged", motors(sound, [2, 1, 3, 4, 5, 6, 7, 8]), body(), "outputs"),
            ("one pair exchanged", motors(sound, [6, 2, 3, 4, 5, 1, 7, 8]), body(), "outputs"),
            ("all outputs in turn", motors(sound, [2, 3, 4, 1, 6, 7, 8, 5]), body(), "outputs"),
            ("uppers for lowers", motors(sound, [6, 5, 8, 7, 2, 1, 4, 3]), body(), "response"),
            ("half the magnets", rpm(sound, scale=2.0), body(), "speeds"),
            ("12 magnets counted as 14", rpm(sound, scale=12 / 14), body(), "speeds"),
        ):
            with case(name):
                found = judged([log], ["f"], vehicle)
                assert found.verdict == "not this vehicle" and not found.suspects
                assert check in {d["check"] for d in found.as_json()["not_this_vehicle"]}
                if check not in refined:
                    refined.add(check)
                    reported = refine(log, vehicle.declared, ROTORS).to_json()
                    assert reported["verdict"] == "not this vehicle" and reported["effects"] == []
                checks = [
                    r.as_json().get("check") for r in flown_by(checked([log], vehicle.declared), vehicle)
                ]
                assert check in checks


def test_a_vehicle_on_its_back_lifts_no_multiple_of_its_weight():
    rows = np.zeros((200, 6)), np.zeros((200, 6))
    rows[0][:, 2], rows[1][:, 2] = -266.0, 45.0
    flown = Flown(X8, ROTORS, np.full((200, 8), 0.5), *rows, np.zeros(200, int), 0.02)
    (lift,) = (d for d in differs(flown) if d.check == "lift")
    assert "inf" not in lift.why and "-45" not in lift.why
    assert json.loads(json.dumps(lift.as_json(), allow_nan=False))["found"] is None


@pytest.mark.slow
def test_rpm_and_currents_of_exchanged_escs_lie_on_no_common_curve(flights):
    split = apart(flights[0])
    frame = flight_frame([flights[0]], X8, ROTORS)
    swapped = rpm(split, [6, 5, 8, 7, 2, 1, 4, 3])
    assert [f.check for f in other_vehicle(frame, [swapped])] == ["speeds"]
    assert other_vehicle(frame, [rpm(split)]) == ()
    assert other_vehicle(frame, [amperes(split)]) == ()
    linear = split.with_columns(
        **{f"current{k}_A": 1.0 + 15.0 * split[f"motor{k}"] ** 0.5 for k in range(1, 9)}
    )
    assert other_vehicle(frame, [linear]) == ()  # no power of theirs, in whatever order
    crossed = amperes(split, [6, 5, 8, 7, 2, 1, 4, 3])
    assert [f.check for f in other_vehicle(frame, [crossed])] == ["currents"]


@pytest.mark.slow
def test_a_fault_of_a_rotor_makes_no_other_vehicle_of_it(flights):
    for log in flights:
        assert other_vehicle(flight_frame([log], X8, ROTORS), [rpm(log)]) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("rotor", "seed"), [(7, 0), (7, 2)])
def test_a_rotor_that_is_weak_from_the_first_row_on_makes_no_other_vehicle_of_it(rotor, seed):
    """Its commands answer askew: roll to yaw, and as if two outputs were exchanged."""
    demo, pair = files.example("x8_demo.toml"), files.example("rotor_paper.toml")
    vehicle = load_vehicle(demo, pair)
    design = make_design(read_vehicle(demo), read_pair(pair), report_px4(vehicle, "fitted").params)
    weak = HiddenEffect("degraded_rotor", 0.3, 0.0, {"rotor": float(rotor)})
    log = Samples(fly_quick(design, FlightWorld((weak,), seed, "wander", 40.0), 8)[1], "weak")
    found = judged([log], ["weak"], vehicle)
    assert found.verdict == "ground it" and found.suspects[0].rotor == rotor


@pytest.mark.slow
def test_a_declared_vehicle_is_judged_as_before(flights):
    sound, weak = flights
    with case_table() as case:
        for sources in ({}, MEASURED):
            with case(str(sources)):
                vehicle = body(sources=sources)
                assert judged([sound], ["f"], vehicle).verdict == "sound"
                found = judged([weak], ["f"], vehicle)
                assert found.verdict == "ground it" and found.suspects[0].rotor == WEAK
                assert refine(sound, vehicle.declared, ROTORS).verdict == "nothing to mend"
                named = refine(weak, vehicle.declared, ROTORS)
                assert [e.name for e in named.effects] == ["degraded_rotor"]


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 1.8])
def test_a_guessed_inertia_ends_in_the_right_rotor_or_in_what_to_measure(flights, scale):
    inertia = tuple(scale * x for x in X8.inertia_kg_m2)
    vehicle = body(inertia_kg_m2=inertia, motor_lag_s=0.0, sources=GUESSED)
    for log, right in zip(flights, ("sound", "ground it"), strict=True):
        found = judged([log], ["f"], vehicle)
        if found.verdict == "cannot judge":
            assert {c.premise for c in found.cannot_judge} <= set(GUESSED) and not found.suspects
        else:
            assert found.verdict == right and (right == "sound" or found.suspects[0].rotor == WEAK)
    determined = refine(flights[1], vehicle.declared, ROTORS)
    if determined.cannot_judge:
        assert {c.premise for c in determined.cannot_judge} <= set(GUESSED) and determined.model is None
    else:
        assert "degraded_rotor" in {e.name for e in determined.effects}


@pytest.mark.slow
def test_what_a_log_lacks_is_no_verdict(flights):
    sound, _ = flights
    slow = sound.take(np.arange(0, sound.rows, 16))  # 3 rows a second
    damaged = sound.on_premises(DAMAGED)
    alike = replace(ROTORS, rotation="co-rotating")
    for log, rotors, premise in (
        (slow, ROTORS, "log_rate"),
        (damaged, ROTORS, DAMAGED),
        (sound, alike, "rotation"),
    ):
        for found in (judged([log], ["f"], Vehicle(X8, rotors)), refine(log, X8, rotors)):
            assert found.verdict == "cannot judge"
            assert [c.premise for c in found.cannot_judge] == [premise]


def test_a_rotor_that_a_slide_would_explain_is_not_called_sound(flights, monkeypatch):
    answers = {True: ("sound", 0.99), False: ("ground it", 0.0)}

    def judge(*_, slides):
        verdict, slid = answers[slides]
        return replace(
            Health.withheld(()), verdict=verdict, slid=slid, suspects=(SimpleNamespace(rotor=WEAK),)
        )

    monkeypatch.setattr("coaxlink.health.premises.judge", judge)
    found = judged([flights[0]], ["f"], body(sources=MEASURED))
    assert [c.premise for c in found.cannot_judge] == ["payload"] and "rotor 3" in found.cannot_judge[0].why


@pytest.mark.slow
def test_a_lift_that_no_rotor_model_is_off_by_names_nothing(flights):
    light = refine(flights[0], replace(X8, mass_kg=1.1 * X8.mass_kg), ROTORS)
    assert light.verdict in ("found", "cannot judge")
    assert {e.name for e in light.effects} <= {"mass_change"}


@pytest.mark.slow
def test_a_moved_frame_is_the_frame_of_the_moved_vehicle(flights):
    frame = flight_frame([flights[0]], X8, ROTORS)
    for moved in moves(replace(X8, sources=GUESSED)):
        again = flight_frame([flights[0]], moved.airframe, ROTORS)
        rows = frame.keep[np.isin(frame.keep, again.keep)]
        quick = as_if(frame, moved.airframe)
        assert np.allclose(quick.measured[rows], again.measured[rows], rtol=1e-9, atol=1e-9)
        assert np.abs(quick.predicted[rows] - again.predicted[rows]).max() < 0.02 * frame.weight


def test_a_log_that_is_not_a_whole_flight_says_what_it_does_not_hold():
    time, motor = np.arange(0.0, 20.0, 0.02), np.full(1000, 0.5)
    whole = Samples({"time_s": time, "motor1": np.where((time > 2.0) & (time < 18.0), motor, 0.0)}, "f")
    holed = whole.take((time < 5.0) | (time > 9.0))
    with case_table() as case:
        for log, words in (
            (whole, ()),
            (whole.take(time > 3.0), ("begins in the air",)),
            (whole.take(time < 12.0), ("ends in the air, at 12.0 s",)),
            (holed, ("has a gap of 4.0 s",)),
            (whole.take((time < 1.0) | (time > 6.0)), ("has a gap of 5.0 s",)),
            (holed.take(holed["time_s"] > 3.0), ("begins in the air and has a gap of 4.0 s",)),
        ):
            with case(str(words)):
                reported = tuple(unseen([log]))
                assert len(reported) == len(words) and all(
                    w in s for w, s in zip(words, reported, strict=True)
                )


def test_every_stretch_of_a_log_is_judged_and_one_on_the_ground_is_named(flights):
    sound, weak = flights
    bench = sound.take(slice_of(sound, 0.0, 5.0))
    parts = {"stretch 1 of 3": sound, "stretch 2 of 3": bench, "stretch 3 of 3": weak}
    log = [replace(part, source=name, provenance=("3 stretches",)) for name, part in parts.items()]
    found = judged(log, list(parts), body(**{"sources": MEASURED}))
    assert found.verdict == "ground it" and found.suspects[0].rotor == WEAK
    assert found.suspects[0].since == "stretch 3 of 3" and len(found.flights) == 2
    assert found.premises[0] == "3 stretches" and "stretch 2 of 3 is not judged: " in found.premises[1]
    with pytest.raises(InputError, match="stretch 2 of 3"):
        judged([log[1], log[1]], ["a", "b"], body())


def slice_of(log, start_s, stop_s):
    """(rows,) those of so many seconds from the start."""
    time = log["time_s"] - log["time_s"][0]
    return (time >= start_s) & (time < stop_s)


def test_what_was_measured_is_not_moved():
    assert list(moves(replace(X8, sources=MEASURED))) == []
    assert {m.premise for m in moves(X8)} == {"mass_kg"}
    assert {m.premise for m in moves(replace(X8, sources=GUESSED))} == {"mass_kg", *GUESSED}
