"""Flights of a world with its own physics: the hidden effect is named, sized, and the error falls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from residual_world import fly

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine
from coaxlink.rotor import RotorModel, load_rotor_model

# what is hidden: (the names that must come out, the channel it shows in most)
HIDDEN = {
    "clean": ({}, [], None),
    "battery": ({"battery": 0.08}, ["battery_voltage"], "force_z"),
    "drag": ({"drag": 0.06}, ["rotor_drag"], "force_x"),
    "weak upper": ({"weak": (3, 0.1)}, ["degraded_rotor"], "torque_x"),
    "centre": ({"cg": (0.006, -0.004)}, ["cg_offset"], "torque_y"),
    "drag and weak": ({"drag": 0.06, "weak": (2, 0.08)}, ["degraded_rotor", "rotor_drag"], "force_x"),
}


pytestmark = pytest.mark.slow  # one fixture flies and refines them all


@pytest.fixture(scope="module")
def flights():
    logs = fly([effects for effects, _, _ in HIDDEN.values()])
    return {name: Samples(log, name) for name, log in zip(HIDDEN, logs, strict=True)}


@pytest.fixture(scope="module")
def airframe():
    return replace(load_airframe(files.example("x8_paper.toml")), motor_lag_s=0.02)


def stand_identified(seed: int) -> RotorModel:
    """Eq. 17 as a stand would give it: levels off by a per cent, every term by half of one."""
    rng = np.random.default_rng(seed)
    exact = load_rotor_model(files.example("rotor_paper.toml"))
    terms = {}
    for load, named in exact.terms().items():
        level = 1 + 0.01 * rng.uniform(-1, 1)
        terms[load] = {t: c * level * (1 + 0.005 * rng.uniform(-1, 1)) for t, c in named.items()}
    return RotorModel.from_terms("crm", exact.speed_max_rpm, terms)


@pytest.fixture(scope="module")
def answers(flights, airframe):
    return {name: refine(log, airframe, stand_identified(i)) for i, (name, log) in enumerate(flights.items())}


def test_every_hidden_effect_is_named_and_nothing_else(answers):
    found = {name: sorted(e.name for e in answer.effects) for name, answer in answers.items()}
    assert found == {name: names for name, (_, names, _) in HIDDEN.items()}
    assert {name: a.ambiguous for name, a in answers.items() if a.ambiguous} == {}


def test_held_out_error_falls_to_about_the_noise_floor(answers):
    for name, (_, _, channel) in HIDDEN.items():
        for c in answers[name].channels.values():
            assert c.ci_after[0] <= c.rmse_after <= c.ci_after[1]
        if channel is None:
            continue
        shown = answers[name].channels[channel]
        assert shown.rmse_after < 0.55 * shown.rmse_before, name
        assert shown.rmse_after < 1.9 * shown.noise_floor, name


def value(answer, name):
    found = {p.name: p for e in answer.effects for p in e.parameters}
    return found[name].value


def test_sizes_come_out_right(answers):
    assert value(answers["weak upper"], "rotor") == 3
    assert value(answers["weak upper"], "thrust_loss") == pytest.approx(0.1, abs=0.01)
    assert value(answers["centre"], "offset_x_m") == pytest.approx(0.006, abs=0.0006)
    assert value(answers["centre"], "offset_y_m") == pytest.approx(-0.004, abs=0.0006)
    assert value(answers["battery"], "speed_exponent") == pytest.approx(0.92, abs=0.1)


def test_noise_floor_is_that_of_the_sensors(answers):
    # 0.05 m/s^2 of white noise at 50 Hz on 20 kg, through a zero-phase 4 Hz low-pass that keeps 13.4 % of it
    assert answers["clean"].channels["force_z"].noise_floor == pytest.approx(
        20 * 0.05 * np.sqrt(0.134), rel=0.1
    )


def test_a_model_that_knows_its_effect_leaves_nothing(answers, flights, airframe):
    for name in ("drag", "weak upper"):
        known = answers[name].model
        assert [e.name for e in known.effects] == HIDDEN[name][1]
        again = refine(flights[name], airframe, known)
        assert again.effects == (), name
        channel = HIDDEN[name][2]
        assert again.channels[channel].rmse_before < 0.6 * answers[name].channels[channel].rmse_before


def test_two_logs_together(flights, airframe):
    both = [flights["drag"], flights["drag"].with_columns(time_s=flights["drag"]["time_s"] + 500.0)]
    answer = refine(both, airframe, stand_identified(3))
    assert [e.name for e in answer.effects] == ["rotor_drag"]
    assert answer.channels["force_x"].held_out_rows > 1000


def test_what_is_not_logged_is_named_not_fitted(flights, airframe):
    log = flights["battery"]
    blind = Samples({k: v for k, v in log.columns.items() if k not in ("voltage_V", "height_m")}, "blind")
    why = {r.name: r.why for r in refine(blind, airframe, stand_identified(1)).rejected}
    assert "voltage_V" in why["battery_voltage"] and "not in the log" in why["battery_voltage"]
    assert "height_m" in why["ground_effect"]


def test_json_is_the_contracts(answers):
    import json

    for name, answer in answers.items():
        document = json.loads(json.dumps(answer.to_json(), allow_nan=False))
        assert document["kind"] == "flight"
        wanted = {
            "noise_floor",
            "rmse_before",
            "rmse_after",
            "ci_before",
            "ci_after",
            "held_out_rows",
            "unit",
        }
        assert set(document["channels"]) == {f"{a}_{b}" for a in ("force", "torque") for b in "xyz"}
        assert all(wanted <= set(c) for c in document["channels"].values())
        for effect in document["effects"]:
            assert {"name", "channels", "parameters", "rmse", "evidence", "source"} <= set(effect), name
            assert all(set(p) == {"name", "value", "ci", "unit"} for p in effect["parameters"])
        for key in ("unexplained", "ambiguous", "suspect_data", "rejected"):
            assert isinstance(document[key], list)


def test_a_missing_column_is_one_clear_error(flights, airframe):
    log = flights["clean"]
    without = Samples({k: v for k, v in log.columns.items() if k != "gyro_y_rad_s"}, "short.csv")
    with pytest.raises(InputError, match=r"short\.csv: column gyro_y_rad_s: missing"):
        refine(without, airframe, stand_identified(0))


def test_rows_of_two_stretches_are_not_sorted_into_one_another(flights, airframe):
    log = flights["clean"]
    back = log.with_columns(time_s=log["time_s"] - 9.3 * (np.arange(log.rows) >= 1600))
    with pytest.raises(InputError, match="row 1601, column time_s: time goes back"):
        refine(back, airframe, stand_identified(0))


def test_what_begins_in_a_short_flight_is_seen(airframe):
    """18 s, of which some 17 are judged: a third of a minute is what a test flight takes."""
    late, never = fly([{"weak": (3, 0.2), "onset": 9.0}, {}], seconds=18.0)
    found = refine(Samples(late, "late"), airframe, stand_identified(7))
    (weak,) = found.effects
    assert weak.name == "degraded_rotor" and {p.name: p.value for p in weak.parameters}[
        "onset_s"
    ] == pytest.approx(9.0, abs=1.0)
    assert not refine(Samples(never, "never"), airframe, stand_identified(7)).effects


def test_too_short_a_flight_is_refused(flights, airframe):
    with pytest.raises(InputError, match="in the air; 8 s are needed"):
        refine(flights["clean"].take(np.arange(300)), airframe, stand_identified(0))
