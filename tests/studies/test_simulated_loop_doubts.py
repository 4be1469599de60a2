"""What the loop does with an answer that is none: nothing, and it says so. No flight is flown here."""

import json
from types import SimpleNamespace

import pytest

from coaxlink import data, residual
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.residual.allocation_error import AllocationErrors
from coaxlink.residual.experiments.manoeuvres import Manoeuvre
from coaxlink.residual.experiments.stand_run import Experiment
from coaxlink.residual.result import Ambiguous, ChannelError, FoundEffect, Refinement, Suspect, Unexplained
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor.model import Effect
from coaxlink.studies import allocation
from coaxlink.studies import loop as closed_loop
from coaxlink.studies.flight_errors import FlightErrors

CHANNELS = {"force_z": ChannelError("N", 0.2, 0.2, 0.2, (0.1, 0.3), (0.1, 0.3), 500, 0.3)}
WEAK = Effect("degraded_rotor", {"rotor": 3.0, "thrust_loss": 0.3, "torque_loss": 0.2})
FOUND = FoundEffect("degraded_rotor", ("force_z",), (), {"force_z": (1.0, 0.2)}, {}, "")
STRANGE = Unexplained("force_z", ("time_s",), 5.0, "time_s: +10 near 14")
LIAR = Suspect("gyro_x_rad_s", "100-900", "stands still while the vehicle turns")
PLAN = Experiment(("mass_change", "battery_voltage"), (Manoeuvre("up", 8.0, height_m=6.0, cycles=2),), 40.0,
                  "force_z", kind="flight")  # fmt: skip
EITHER = Ambiguous(("mass_change", "battery_voltage"), "a flight of 8 s", PLAN)


def answer(model=None, effects=(), unexplained=(), ambiguous=(), suspects=()):
    return Refinement("flight", CHANNELS, effects, unexplained, ambiguous, suspects, (), model)


class Flights:
    """In place of the simulator: what was flown, and what `refine` was asked."""

    def __init__(self, monkeypatch, answers):
        self.flown, self.refined, self.answers = [], [], list(answers)
        monkeypatch.setattr(closed_loop, "_fly_table", self.fly)
        monkeypatch.setattr(allocation, "errors_of_table", self.errors)
        monkeypatch.setattr(
            data, "read_flight_log", lambda path: SimpleNamespace(has=lambda *_: False, path=path)
        )
        monkeypatch.setattr(residual, "refine", self.refine)

    def fly(self, world, flight, airframe, name, report, rotor):
        self.flown.append((name, flight, dict(report.params), world.plan.duration_s, rotor.name))
        return SimpleNamespace(log=world.out / f"{name}.tlog")

    def errors(self, *_, **__):
        d = AllocationErrors(
            1.0, (0.1, 0.1, 0.1), (), 60.0, ((0.9, 1.1), *[(0.09, 0.11)] * 3), (0.2, 0.01, 0.01, 0.01)
        )
        return FlightErrors(d, (0.1, 0.1, 0.1))

    def refine(self, logs, airframe, model, **_):
        self.refined.append(logs if isinstance(logs, list) else [logs])
        made = self.answers.pop(0)
        return made(model) if callable(made) else made


def loop(tmp_path, *more):
    result = tmp_path / "loop.json"
    assert (
        run(
            build_app(), ["loop", "--seed", "1", "--out", str(tmp_path / "out"), "--json", str(result), *more]
        )
        == 0
    )
    return json.loads(result.read_text())


def weak(model):
    from dataclasses import replace

    return answer(replace(model, effects=(WEAK,)), (FOUND,))


@pytest.mark.parametrize(
    ("given", "outcome", "said"),
    [
        (answer(), "nothing_found", "nothing found, nothing changed"),
        (answer(unexplained=(STRANGE,)), "unexplained", "force_z still follows time_s"),
        (answer(ambiguous=(EITHER,)), "ambiguous", "coaxlink loop --separate"),
        (lambda m: answer(weak(m).model, (FOUND,), suspects=(LIAR,)), "suspect_data", LIAR.why),
    ],
)  # fmt: skip
def test_nothing_is_put_into_the_mixer_and_that_is_said(monkeypatch, tmp_path, capsys, given, outcome, said):
    flights = Flights(monkeypatch, [given])
    result = loop(tmp_path)
    assert result["outcome"] == outcome
    assert result["compensated"] == {} and result["way"] == "table"
    assert result["before"].keys() == result["after"].keys()
    before, after = flights.flown
    assert before[2] == after[2] and before[4] == after[4] == "rotor.toml"  # the same table, bit for bit
    assert before[1] != after[1]  # with other noise
    assert not (tmp_path / "out" / "rotor_refined.toml").exists()
    screen = capsys.readouterr().out.replace("\n", " ")
    assert said in screen and "what differs between them is chance" in screen
    assert said in (tmp_path / "out" / "report.html").read_text().replace("\n", " ")


def test_what_separates_is_flown_if_asked_and_then_used(monkeypatch, tmp_path, capsys):
    flights = Flights(monkeypatch, [answer(ambiguous=(EITHER,)), weak])
    result = loop(tmp_path, "--separate")
    assert [f[0] for f in flights.flown] == ["before", "separating", "after"]
    assert len({f[1] for f in flights.flown}) == 3
    before, separating, after = flights.flown
    assert separating[2] == before[2] != after[2]
    assert 8.0 < separating[3] < 20.0 < before[3]
    assert [len(logs) for logs in flights.refined] == [1, 2]
    assert result["outcome"] == "compensated" and list(result["compensated"]) == ["degraded_rotor"]
    assert result["log_separating"].endswith("separating.tlog")
    assert after[4] == "rotor_refined.toml"
    refined = load_rotor_model(tmp_path / "out" / "rotor_refined.toml")
    assert [e.name for e in refined.effects] == ["degraded_rotor"]


def test_what_no_mixer_can_take_back_is_named(monkeypatch, tmp_path, capsys):
    from dataclasses import replace

    wind = Effect("wind", {"north_m_s": 3.0, "east_m_s": 0.0, "drag_N_s_m": 1.0})
    found = FoundEffect("wind", ("force_x",), (), {}, {}, "")
    Flights(monkeypatch, [lambda m: answer(replace(m, effects=(wind,)), (found,))])
    result = loop(tmp_path)
    assert result["outcome"] == "not_compensable" and list(result["not_compensated"]) == ["wind"]
    assert "nothing could be put into the mixer" in capsys.readouterr().out
