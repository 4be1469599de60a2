"""What the loop puts into the mixer, and what it leaves alone; one flight mixed live, in lock-step."""

import json
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from coaxlink import data, files, residual, rotor
from coaxlink.airframe import load_airframe
from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.errors import CheckFailed, LinkError
from coaxlink.fly.commands import NotReached
from coaxlink.fly.trajectory import FlightPlan, Hold, Swing
from coaxlink.residual.allocation_error import AllocationErrors
from coaxlink.residual.experiments.manoeuvres import Manoeuvre
from coaxlink.residual.experiments.stand_run import Experiment
from coaxlink.residual.result import Ambiguous, ChannelError, FoundEffect, Refinement, Suspect, Unexplained
from coaxlink.rotor import load_rotor_model
from coaxlink.rotor.model import EffectEntry
from coaxlink.studies import flight_errors, flights
from coaxlink.studies import loop as closed_loop
from coaxlink.studies.flight_errors import FlightErrors
from coaxlink.vehicle import Vehicle

CHANNELS = {"force_z": ChannelError("N", 0.2, 0.2, 0.2, (0.1, 0.3), (0.1, 0.3), 500, 0.3)}
STRANGE = Unexplained("force_z", ("time_s",), 5.0, "time_s: +10 near 14")
BIASED = Suspect("gyro_x_rad_s", "100-900", "stands still while the vehicle turns")
RIVALS = ("mass_change", "battery_voltage")
PLANNED = Experiment(RIVALS, (Manoeuvre("up", 8.0, height_m=6.0, cycles=2),), 40.0, "force_z", kind="flight")
EITHER = Ambiguous(RIVALS, "a flight of 8 s", PLANNED)


def answer(model=None, effects=(), unexplained=(), ambiguous=(), suspects=()):
    return Refinement("flight", CHANNELS, effects, unexplained, ambiguous, suspects, (), model)


def found(name, parameters, suspects=()):
    """An answer that names one effect, of whatever model is refined."""
    effect = FoundEffect(name, ("force_z",), (), {"force_z": (1.0, 0.2)}, {}, "")

    def of(model):
        return answer(replace(model, effects=(EffectEntry(name, parameters),)), (effect,), suspects=suspects)

    return of


WEAK = ("degraded_rotor", {"rotor": 3.0, "thrust_loss": 0.3, "torque_loss": 0.2})


@pytest.fixture
def loop(monkeypatch, tmp_path):
    """The verb, no flight flown, with these answers of `refine`: (JSON, flights, logs that were refined)."""

    def go(answers, *options):
        flown, refined, left = [], [], list(answers)

        def fly(setup, flight, vehicle, name, table, *, refined=False):
            flown.append((name, flight, dict(table.params), setup.plan.duration_s, refined))
            return SimpleNamespace(log=setup.out / f"{name}.tlog")

        def refine(logs, airframe, model, **_):
            refined.append(logs if isinstance(logs, list) else [logs])
            made = left.pop(0)
            return made(model) if callable(made) else made

        intervals = ((0.9, 1.1), *[(0.09, 0.11)] * 3)
        errors = AllocationErrors(1.0, (0.1, 0.1, 0.1), (), 60.0, intervals, (0.2, 0.01, 0.01, 0.01))
        monkeypatch.setattr(closed_loop, "_fly_table", fly)
        monkeypatch.setattr(
            flight_errors, "errors_of_table", lambda *_: FlightErrors(errors, (0.1, 0.1, 0.1))
        )
        monkeypatch.setattr(data, "read_flight_log", lambda path: SimpleNamespace(has=lambda *_: False))
        monkeypatch.setattr(residual, "refine", refine)
        monkeypatch.setattr(rotor, "identify", lambda *_: SimpleNamespace(model=MODEL))
        out, result = tmp_path / "out", tmp_path / "loop.json"
        arguments = ["loop", "--seed", "1", "--out", str(out), "--json", str(result), *options]
        assert run(build_app(), arguments) == 0
        return json.loads(result.read_text()), flown, refined

    return go


NOTHING_DONE = {
    "nothing_found": (answer(), "nothing found, nothing changed"),
    "unexplained": (answer(unexplained=(STRANGE,)), "force_z still follows time_s"),
    "ambiguous": (answer(ambiguous=(EITHER,)), "ambiguous: "),
    "suspect_data": (found(*WEAK, suspects=(BIASED,)), BIASED.why),
}


@pytest.mark.slow
@pytest.mark.parametrize("outcome", NOTHING_DONE)
def test_nothing_is_put_into_the_mixer_and_that_is_said(loop, tmp_path, capsys, outcome):
    given, reported = NOTHING_DONE[outcome]
    result, (before, after), _ = loop([given])
    assert result["outcome"] == outcome and result["compensated"] == {} and result["way"] == "table"
    assert result["before"].keys() == result["after"].keys()
    assert before[2] == after[2] and not after[4]  # the same table, bit for bit, of the same rotor file
    assert before[1] != after[1]  # with other noise
    assert not (tmp_path / "out" / "rotor_refined.toml").exists()
    screen = capsys.readouterr().out.replace("\n", " ")
    assert reported in screen and "what differs between them is chance" in screen
    assert reported in (tmp_path / "out" / "report.html").read_text().replace("\n", " ")


@pytest.mark.slow
def test_what_no_mixer_can_take_back_is_named(loop, capsys):
    result, _, _ = loop([found("wind", {"north_m_s": 3.0, "east_m_s": 0.0, "drag_N_s_m": 1.0})])
    assert result["outcome"] == "not_compensable" and list(result["not_compensated"]) == ["wind"]
    assert "nothing could be put into the mixer" in capsys.readouterr().out


AIRFRAME = load_airframe(files.example("x8_demo.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))
HOVER, NORTH, UP = (0.0, 0.0, -3.0), (1.0, 0.0, -3.0), (0.0, 0.0, -4.2)
PLAN = FlightPlan(
    (Hold("hover", HOVER, 2.0), Swing("to and fro", HOVER, NORTH, 5.0, 2), Swing("up", HOVER, UP, 6.0, 3))
)
# the world's own law is another: thrust times 1 - r / (1 + |r|), r = 4 V / (u 105 m/s)
INFLOW = EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": 2.5, "by_thrust": 1.0, "levelling_s_m": 0.05})


@pytest.mark.slow
def test_an_inflow_is_taken_out_live_though_the_companion_sleeps(tmp_path):
    truth = tmp_path / "truth.toml"
    truth.write_text('[[effects]]\nname = "axial_inflow"\nsize = 4.0\n')
    hidden = ["--airframe", str(files.example("x8_demo.toml")), "--truth", str(truth)]
    vehicle, slept = Vehicle(AIRFRAME, MODEL), []

    def watch(segment, t):
        if t > 3.0 and not slept:  # many seconds of the vehicle's time, were it not to wait
            slept.append(t)
            time.sleep(0.5)

    errors = []
    for model in (MODEL, replace(MODEL, effects=(INFLOW,))):
        setup = closed_loop.LoopSetup(hidden, 1, 30.0, tmp_path, PLAN, vehicle, watch=watch)
        flies = Vehicle(AIRFRAME, model, measured_live=True)
        flight, demands = closed_loop._fly_live(setup, 1, flies, "live")
        errors.append(flight_errors.errors_of_live(flight, vehicle, demands).allocation)
    before, after = errors
    assert slept and before.thrust_error_N > 1.5  # the plan upsets thrust
    assert after.thrust_error_N < 0.5 * before.thrust_error_N


def test_a_flight_that_was_not_the_mixers_is_not_weighed(monkeypatch, tmp_path):
    vehicle = Vehicle(AIRFRAME, MODEL)
    setup = closed_loop.LoopSetup([], 1, 10.0, tmp_path, PLAN, vehicle)
    planned = round(250 * PLAN.duration_s)
    for cycles, hand_overs, good in ((0.6 * planned, 1, False), (planned, 5, False), (planned, 1, True)):
        account = {"cycles": cycles, "hand_overs": hand_overs}
        monkeypatch.setattr(flights, "fly_live", lambda *_, a=account, **__: ("flown", flights.Demands(), a))
        if good:
            assert closed_loop._fly_live(setup, 1, vehicle, "before")[0] == "flown"
        else:
            with pytest.raises(CheckFailed, match="not the mixer's flight"):
                closed_loop._fly_live(setup, 1, vehicle, "before")


def test_a_simulator_that_runs_away_from_the_machine_is_flown_slower(tmp_path):
    troubles = [LinkError("udpin:127.0.0.1:14550", "silent"), NotReached("take-off: 3 m not reached in 30 s")]
    speeds = []

    def flown(sim):
        speeds.append(sim.speed)
        if troubles:
            raise troubles.pop(0)
        return "flown"

    assert flights._slow_enough(flights.Simulation([], 9.0, tmp_path), flown) == "flown"
    assert speeds == [9.0, 3.0, 1.0]
