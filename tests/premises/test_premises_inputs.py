"""What is no reading is told before anything is judged by it, in every verb alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from residual_world import fly
from verb import run

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples, read_flight_log
from coaxlink.health.premises import judged
from coaxlink.instruments.flight.inputs import checked
from coaxlink.residual import refine
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor_update.coefficients import coefficients_from_flights
from coaxlink.rotor_update.premises import flown_by, update_hangs_on
from coaxlink.vehicle import Vehicle, load_vehicle

X8 = replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)
ROTORS = load_rotor_model(files.example("rotor_paper.toml"))
VEHICLE = Vehicle(X8, ROTORS)
FIELD = Path(__file__).parents[3] / "shared" / "field"


@pytest.fixture(scope="module")
def sound():
    return Samples(fly([{}], seconds=44.0)[0], "sound.csv")


def late(log, column, seconds):
    return {column: np.interp(log["time_s"] - seconds, log["time_s"], log[column])}


def held(log, column, since_s, seconds):
    time, values = log["time_s"], log[column].copy()
    at = (time >= since_s) & (time < since_s + seconds)
    values[at] = values[np.argmax(at)]
    return {column: values}


def test_readings_that_lie_are_told_by_health_refine_and_identify_alike(sound):
    with case_table() as case:
        for column, harm in (
            ("gyro_x_rad_s", {"gyro_x_rad_s": 1.1 * sound["gyro_x_rad_s"]}),
            ("roll_rad", {"roll_rad": -sound["roll_rad"]}),
            ("motor5", late(sound, "motor5", 0.04)),
        ):
            with case(column):
                log = sound.with_columns(**harm)
                found = judged([log], ["f"], VEHICLE)
                assert found.verdict == "cannot judge" and not found.suspects
                assert [r.premise for r in found.cannot_judge] == [column]
                assert [r.premise for r in flown_by(checked([log], X8), VEHICLE)] == [column]
                assert [s.column for s in refine(log, X8, ROTORS).suspect_data] == [column]


def test_what_is_no_reading_for_a_while_is_left_out_and_the_rest_is_judged(sound):
    still = held(sound, "height_m", 12.0, 99.0)
    before = judged([sound], ["f"], VEHICLE)
    assert before.verdict == "sound" and not before.suspect_data
    with case_table() as case:
        for column, harm in (("motor5", held(sound, "motor5", 20.0, 0.5)), ("height_m", still)):
            with case(column):
                found = judged([sound.with_columns(**harm)], ["f"], VEHICLE)
                assert found.verdict == "sound" and found.probability < 0.01
                assert [s.column for s in found.suspect_data] == [column]
                assert found.as_json()["suspect_data"][0]["column"] == column


def test_a_silent_esc_leaves_the_others(sound):
    rng = np.random.default_rng(0)
    determined = {
        f"rpm{n}": 5400.0 * sound[f"motor{n}"] + 3.0 * rng.standard_normal(sound.rows) for n in range(1, 9)
    }
    log = sound.with_columns(**determined)
    whole = coefficients_from_flights([log], X8, ROTORS).loads
    dead = {"rpm3": np.where(sound["time_s"] > 20.0, determined["rpm3"][1000], determined["rpm3"])}
    never = {"rpm3": np.full(sound.rows, np.nan)}
    with case_table() as case:
        for name, harm in (("from 20 s on", dead), ("from the first row on", never), ("not logged", None)):
            with case(name):
                harmed = log.without("rpm3") if harm is None else log.with_columns(**harm)
                inputs = checked([harmed], X8)
                assert not flown_by(inputs, VEHICLE)
                assert [s.column for s in inputs.suspects] == ["rpm3"] * (name == "from 20 s on")
                update = coefficients_from_flights(inputs.logs, X8, ROTORS)
                assert update.measured_speeds
                for load, (_, _, value, sd) in update.loads.items():
                    assert abs(value - whole[load][2]) < sd


def test_negative_speeds_are_speeds(tmp_path):
    rows = ["time_s,motor1,motor2,rpm1,rpm2," + ",".join(COLUMNS)]
    rows += [f"{0.02 * k},0.5,0.5,{2700 + k},{-2700 - k}," + ",".join("0" * len(COLUMNS)) for k in range(60)]
    path = tmp_path / "signed.csv"
    path.write_text("\n".join(rows))
    log = read_flight_log(path)
    assert np.array_equal(log["rpm1"], log["rpm2"]) and log.premises == ("signed_speeds",)


COLUMNS = [f"accel_{a}_m_s2" for a in "xyz"] + [f"gyro_{a}_rad_s" for a in "xyz"]
COLUMNS += ["roll_rad", "pitch_rad", "yaw_rad"]


@pytest.mark.skipif(not FIELD.is_dir(), reason="no ../shared/field: it is not redistributed")
@pytest.mark.shared_data
def test_field_escs_that_are_offline_frozen_or_negative(capsys):
    with case_table() as case:
        for file, words in (
            ("22-esc-gone-offline-keeps-its-rpm/esc_slot5_offline.ulg", "rpm3"),
            ("22-esc-gone-offline-keeps-its-rpm/esc5_frozen.bin", "rpm5"),
            ("29-negative-rpm/rpm_negative.bin", "negative"),
        ):
            with case(file):
                path = FIELD / file
                vehicle = load_vehicle(path.parent / "x8_paper.toml", path.parent / "rotor_paper.toml")
                inputs = checked([read_flight_log(path)], vehicle.declared)
                loads = coefficients_from_flights(inputs.logs, vehicle.declared, vehicle.rotors).loads
                for load, truth in (("upper.thrust_N", 21.0), ("lower.thrust_N", 28.1)):
                    _, _, value, sd = loads[load]
                    assert abs(value - truth) < 1.96 * sd
                frame, rotor = (path.parent / n for n in ("x8_paper.toml", "rotor_paper.toml"))
                code, _, reported = run(capsys, "identify", path, "--airframe", frame, "--rotor", rotor)
                assert code == 0 and words in reported


def test_identify_refuses_speeds_that_the_commands_contradict_and_loads_outside_their_prior(sound):
    t, noise = sound["time_s"], 3.0 * np.random.default_rng(1).standard_normal((8, sound.rows))
    determined = {f"rpm{n}": 5400.0 * sound[f"motor{n}"] + noise[n - 1] for n in range(1, 9)}
    wanders = {"rpm5": determined["rpm5"] * (1.0 + 0.2 * np.sin(t / 3.0))}
    log = sound.with_columns(**determined | wanders)
    assert not flown_by(checked([sound.with_columns(**determined)], X8), VEHICLE)
    (reason,) = flown_by(checked([log], X8), VEHICLE)
    assert reason.premise == "rpm" and "by the commands" in reason.why
    # and where nothing else told: what comes out is what the rotor file calls impossible
    frozen = {"rpm5": np.where(t > 10.0, 1.3 * determined["rpm5"][500], determined["rpm5"])}
    log = sound.with_columns(**determined | frozen)
    update = coefficients_from_flights([log], X8, ROTORS)
    reasons = update_hangs_on(update, [log], VEHICLE)
    assert {r.premise for r in reasons} == {"rotor_model"} and "in hover would be" in reasons[0].why
