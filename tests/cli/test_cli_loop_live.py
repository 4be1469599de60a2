"""A live flight that the machine cannot keep up with is not read as a mixer's error."""

import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.cli import _demo, _loop
from coaxlink.errors import CheckFailed
from coaxlink.link.trajectory import paper_flight
from coaxlink.rotor import load_rotor_model

AIRFRAME = load_airframe(files.example("x8_demo.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))


def fly(monkeypatch, tmp_path, accounts):
    """(speeds flown at, flight) with a companion whose accounts these are, one a try."""
    speeds, left = [], list(accounts)

    def flown(world, speed, *_, **__):
        speeds.append(speed)
        return f"flight {len(speeds)}", _demo.Demands(), left.pop(0)

    monkeypatch.setattr(_demo, "fly_live", flown)
    plan = paper_flight()
    world = _loop.World([], 10.0, tmp_path, plan)
    whole = round(250 * plan.duration_s)
    for account in accounts:
        account["cycles"] = round(account["cycles"] * whole)
    flight, _ = _loop._fly_live(world, AIRFRAME, MODEL, "before", False, lambda _: None, lambda *_: None)
    return speeds, flight


def test_a_flight_with_all_demands_answered_is_taken(monkeypatch, tmp_path):
    good = {"cycles": 0.99, "hand_overs": 1}
    assert fly(monkeypatch, tmp_path, [good]) == ([4.0], "flight 1")


def test_it_is_flown_slower_until_the_machine_keeps_up(monkeypatch, tmp_path):
    late, handed = {"cycles": 0.6, "hand_overs": 1}, {"cycles": 0.97, "hand_overs": 5}
    good = {"cycles": 0.97, "hand_overs": 0}
    assert fly(monkeypatch, tmp_path, [late, handed, good]) == ([4.0, 2.0, 1.0], "flight 3")


def test_a_machine_that_never_keeps_up_is_told(monkeypatch, tmp_path):
    with pytest.raises(CheckFailed, match="too busy"):
        fly(monkeypatch, tmp_path, [{"cycles": 0.1, "hand_overs": 9} for _ in range(3)])
