"""`coaxlink refine FOLDER`: logs of two simulated vehicles, one with a rotor that is weak."""

import json

import pytest
from cli_runs import coaxlink

from coaxlink.files import example
from sim.effects import HiddenEffect
from sim.flights import write_flight
from sim.physics.rotors import read_pair
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.vehicle import read_vehicle

CT = {f"CA_ROTOR{n}_CT": 60.0 if n < 4 else 45.0 for n in range(8)} | {"THR_MDL_FAC": 0.8}


@pytest.mark.slow
def test_the_ailing_rotor_of_a_fleet_is_named(tmp_path):
    airframe = example("x8_demo.toml")
    design = make_design(read_vehicle(airframe), read_pair(example("rotor_paper.toml")), CT)
    for vehicle, lost in (("good", 0.0), ("weak", 0.1)):
        (tmp_path / vehicle).mkdir()
        effects = (HiddenEffect("degraded_rotor", lost, 0.0, {"rotor": 5.0}),) if lost else ()
        for week in range(3):
            _, log = fly_quick(design, FlightWorld(effects, 10 + week, "wander", 20.0), 4)
            write_flight(tmp_path / vehicle / f"2026-01-{1 + 7 * week:02d}.csv", log)
    (tmp_path / "good" / "2026-03-01.csv").write_text("not a log")
    options = ["--airframe", airframe, "--workers", "1"]
    answer, page = tmp_path / "f.json", tmp_path / "f.html"
    done = coaxlink("refine", tmp_path, *options, "--json", answer, "--report", page)
    assert done.code == 0, done.err
    assert "weak: degraded_rotor, rotor 5: in 3 of 3 logs since 2026-01-01" in done.out
    assert "says nothing: good/2026-03-01.csv" in done.err and "Traceback" not in done.err
    believed = [f for f in json.loads(answer.read_text())["findings"] if f["believed"]]
    assert [(f["vehicle"], f["part"]) for f in believed] == [("weak", "rotor 5")]
    assert all(abs(value - 0.1) < 0.01 for value in believed[0]["values"])
    assert page.exists()


@pytest.mark.slow
def test_what_a_fleet_cannot_give_is_one_line(tmp_path):
    (tmp_path / "logs").mkdir()
    for arguments, reported in (
        ((tmp_path / "logs",), "no logs there"),
        ((tmp_path / "logs", tmp_path / "logs"), "a fleet is one folder"),
        ((tmp_path / "logs", "--out", tmp_path / "r.toml"), "a fleet has no one model"),
    ):
        ended = coaxlink("refine", *arguments)
        assert ended.code == 2 and reported in ended.err and "Traceback" not in ended.err, ended
