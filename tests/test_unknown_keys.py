"""A misspelt key is refused by name in every TOML file that is read, with the key that was meant."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from case_table import case_table

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.cli.shared.rate_loops import _vehicle
from coaxlink.data import read_stand_log
from coaxlink.fly.plans import plan_of
from coaxlink.rotor import load_rotor_model
from coaxlink.studies.campaign.flights import known_effects
from coaxlink.studies.campaign.spec import read_spec
from coaxlink.vehicle import load_rotors
from firmware_params.keys import problem_of, unknown_key
from sim.manoeuvres import read_plan
from sim.physics.rotors import read_pair
from sim.stand.effects import read_bench
from sim.stand.schedule import read_schedule
from sim.truth import read_truth
from sim.vehicle import read_vehicle

AIRFRAME = files.example("x8_demo.toml").read_text()
ROTOR = files.example("rotor_paper.toml").read_text()
TRUTH = files.example("truth_weak_rotor.toml").read_text()
STAND = files.example("truth_stand_spacing.toml").read_text()
SCHEDULE = files.example("schedule_poor.toml").read_text()
EFFECT = ROTOR + '[[effects]]\nname = "degraded_rotor"\nparameters = { rotor = 3, thrust_loss = 0.1 }\n'
CAMPAIGN = "flights = 10\nmass_share = { low = 1, high = 2 }\n[effects.wind]\nsize = 1\nonset_s = 2\n"
PLAN = "height_m = 3.0\n[[pieces]]\nseconds = 2.0\nnorth_m = 1.0\n"


def columns_map(path: Path) -> object:
    log = path.with_name("log.csv")
    log.write_text("n1,n2\n1,2\n2,3\n")
    return read_stand_log(log, path)


def of_a_table(path: Path) -> object:
    folder = path.parent
    for name, text in (("airframe.toml", AIRFRAME), ("rotor.toml", ROTOR)):
        (folder / name).write_text(text)
    path.rename(folder / "conditions.toml")
    return _vehicle(folder)


def flight_plan(path: Path) -> object:
    return plan_of(str(path), 4.0, 2.0)


def campaign(path: Path) -> object:
    return read_spec(path, known_effects())


CASES = {
    "airframe": (load_airframe, AIRFRAME, "motor_lag_s", "motor_lag", "motor_lag: unknown; motor_lag_s?"),
    "airframe, case": (load_airframe, AIRFRAME, "mass_kg", "mass_KG", "mass_KG: unknown; mass_kg?"),
    "a rotor": (load_airframe, AIRFRAME, "level", "levell", "rotors[1].levell: unknown; level?"),
    "rotor model": (
        load_rotor_model, ROTOR, "\nspeed_max_rpm", "\nspeed_max", "speed_max: unknown; speed_max_rpm?",
    ),
    "load": (load_rotor_model, ROTOR, "upper.thrust_N", "upper.thrust", "upper.thrust: unknown; thrust_N?"),
    "rotor file of a vehicle": (
        load_rotors, ROTOR, "\nspeed_max_rpm", "\nspeed_max", "speed_max: unknown; speed_max_rpm?",
    ),
    "effect": (
        load_rotors, EFFECT, "degraded_rotor", "degraded_rotr", "effects[1].name: degraded_rotr: unknown; ",
    ),
    "effect's table": (
        load_rotors, EFFECT, "parameters", "parameter", "effects[1].parameter: unknown; parameters?",
    ),
    "effect's number": (
        load_rotors, EFFECT, "thrust_loss", "thrust_los",
        "effects[1].parameters.thrust_los: unknown; thrust_loss?",
    ),
    "campaign": (campaign, CAMPAIGN, "flights", "flight", "flight: unknown; flights?"),
    "campaign's range": (campaign, CAMPAIGN, "low", "lo", "mass_share.lo: unknown; low?"),
    "campaign's effect": (campaign, CAMPAIGN, "wind", "wnd", "effects.wnd: unknown; wind?"),
    "campaign's effect's key": (
        campaign, CAMPAIGN, "onset_s", "onset", "effects.wind.onset: unknown; onset_s?",
    ),
    "fly's plan": (flight_plan, PLAN, "height_m", "heigth_m", "heigth_m: unknown; height_m?"),
    "fly's pieces": (flight_plan, PLAN, "[[pieces]]", "[[piece]]", "piece: unknown; pieces?"),
    "fly's piece": (flight_plan, PLAN, "north_m", "north", "pieces[1].north: unknown; north_m?"),
    "columns": (
        columns_map, "upper_rpm = 'n1'\n", "upper_rpm", "uper_rpm", "uper_rpm: unknown; upper_rpm?",
    ),
    "a column": (
        columns_map, "upper_rpm = { column = 'n1', unit = 'rpm' }\n", "unit", "units",
        "upper_rpm.units: unknown; unit?",
    ),
    "conditions": (of_a_table, "voltage_V = 24.0\n", "voltage_V", "voltage", "voltage: unknown; voltage_V?"),
    "world": (read_vehicle, AIRFRAME, "motor_lag_s", "motor_lag", "motor_lag: unknown; motor_lag_s?"),
    "world's rotor": (read_vehicle, AIRFRAME, "spin", "spins", "rotors[1].spins: unknown; spin?"),
    "world's pair": (read_pair, ROTOR, "upper.thrust_N", "upper.thrust", "upper.thrust: unknown; thrust_N?"),
    "truth": (read_truth, TRUTH, "size", "sizes", "effects[1].sizes: unknown; size?"),
    "truth's tables": (read_truth, TRUTH, "[[effects]]", "[[effect]]", "effect: unknown; effects?"),
    "stand": (read_bench, STAND, "pattern", "patern", "stand.patern: unknown; pattern?"),
    "schedule": (read_schedule, SCHEDULE, "rate_hz", "rate", "rate: unknown; rate_hz?"),
    "piece": (read_schedule, SCHEDULE, "seconds", "second", "pieces[1].second: unknown; seconds?"),
    "plan": (read_plan, PLAN, "height_m", "heigth_m", "heigth_m: unknown; height_m?"),
    "plan's piece": (read_plan, PLAN, "north_m", "north", "pieces[1].north: unknown; north_m?"),
}  # fmt: skip


READERS = {
    *(f"coaxlink/{p}.py" for p in ("airframe", "cli/shared/rate_loops", "data/columns_map")),
    "coaxlink/studies/campaign/spec.py",
    *(f"coaxlink/{p}.py" for p in ("fly/plans",)),
    "coaxlink/rotor/model.py",
    *(f"sim/{p}.py" for p in ("manoeuvres", "physics/rotors", "truth", "vehicle")),
    *(f"sim/stand/{p}.py" for p in ("effects", "schedule")),
    "coaxlink/cli/loop.py",  # before the world reads it
    "coaxlink/cli/examples.py",  # which rotor file goes with a shipped airframe
    "coaxlink/studies/campaign/flights.py",  # what was read before, sent to a worker
    "coaxlink/residual/diagnosis/decide.py",  # the package's own, as the next
    "coaxlink/studies/paper/ledger.py", "sim/px4/store.py", "sim/ardupilot/store.py",  # the package's own
    "coaxlink/files.py", "sim/documents.py", "firmware_params/bounded.py",  # what all of these read with
}  # fmt: skip


def test_a_misspelt_key_is_refused_with_the_one_that_was_meant(tmp_path: Path) -> None:
    with case_table() as case:
        for number, (name, (read, text, right, wrong, line)) in enumerate(CASES.items()):
            path = tmp_path / str(number) / "file.toml"
            path.parent.mkdir()
            path.write_text(text)
            with case(name):
                assert right in text
                read(path)  # as it stands it is taken
                path.write_text(text.replace(right, wrong, 1))
                with pytest.raises(Exception, match="unknown; ") as refused:
                    read(path)
                assert line in str(refused.value) and "\n" not in str(refused.value)


def test_without_a_near_one_all_are_named() -> None:
    assert problem_of("zzz", ["mass_kg", "name"]) == "unknown; one of mass_kg, name is expected"
    assert unknown_key({"name": 1}, ["mass_kg", "name"]) is None


def test_an_effect_of_a_name_of_its_own_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "rotor.toml"
    path.write_text(EFFECT.replace("degraded_rotor", "blade_flutter"))
    assert [e.name for e in load_rotors(path).effects] == ["blade_flutter"]


def test_every_reader_of_toml_is_known_here() -> None:
    """A new one belongs into CASES: this list is what it is compared with."""
    root = Path(files.__file__).parents[1]
    found = {
        str(path.relative_to(root))
        for folder in ("coaxlink", "sim", "firmware_params")
        for path in (root / folder).rglob("*.py")
        if re.search(r"read_toml\(|parse_toml\(|read_document\(|tomllib\.loads\(", path.read_text())
    }
    assert found - READERS == set()
