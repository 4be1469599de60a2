"""No door lets an effect of the rotor file be dropped in silence."""

import importlib
import inspect
import pkgutil
from dataclasses import replace

import numpy as np
import pytest

import coaxlink as cx
from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.files import example
from coaxlink.live.effects import LiveEffects
from coaxlink.live.mixer import LiveMixer
from coaxlink.live.mixer_core import MixCore
from coaxlink.mixer import LAWS, allocate, make_law, reduced_coefficients, standard_coefficients
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.fitted import FittedLaw, fit_table
from coaxlink.rotor import RotorModel, load_rotor_model, save_rotor_model
from coaxlink.rotor.model import EffectEntry
from coaxlink.tables.ardupilot import report_ap
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import Vehicle, load_vehicle

X8 = load_airframe(example("x8_paper.toml"))
CRM = load_rotor_model(example("rotor_paper.toml"))
WEAK = replace(
    CRM, effects=(EffectEntry("degraded_rotor", {"rotor": 3.0, "thrust_loss": 0.3, "torque_loss": 0.18}),)
)
HOVER = [196.133, 0.0, 0.0, 0.0]


def test_an_airframe_and_a_model_are_no_vehicle():
    for law in LAWS:
        with pytest.raises(TypeError):
            make_law(law, X8, WEAK)
        with pytest.raises(InputError, match="a Vehicle is expected"):
            make_law(law, X8)
    for door in (ExactLaw, FittedLaw, fit_table, MixCore, lambda *given: LiveMixer(None, *given)):
        for not_a_vehicle in (X8, WEAK):
            with pytest.raises(InputError, match="a Vehicle is expected"):
                door(not_a_vehicle)
        with pytest.raises((InputError, TypeError)):
            door(X8, WEAK)


def test_rooms_behind_the_doors_refuse_a_model_that_carries_effects():
    for door in (reduced_coefficients, standard_coefficients):
        with pytest.raises(InputError, match=r"degraded_rotor.*make a Vehicle"):
            door(WEAK)


@pytest.mark.slow
def test_no_public_function_takes_an_airframe_and_a_rotor_model_apart():
    """Where both stand beside each other an effect can be lost; what may still is named with its reason."""
    found = set()
    for module in pkgutil.walk_packages(cx.__path__, "coaxlink."):
        if module.name.startswith(("coaxlink.cli", "coaxlink.studies.paper")) or module.name.endswith(
            "__main__"
        ):
            continue
        loaded = importlib.import_module(module.name)
        for thing in vars(loaded).values():
            if getattr(thing, "__module__", None) != module.name or not hasattr(thing, "__name__"):
                continue
            methods = [m for n, m in vars(thing).items() if n == "__init__" or not n.startswith("_")]
            if thing.__name__.startswith("_"):
                continue
            for one in methods if inspect.isclass(thing) else [thing]:
                one = getattr(one, "__func__", one)
                kinds = " ".join(map(str, getattr(one, "__annotations__", {}).values()))
                if inspect.isfunction(one) and "Airframe" in kinds and "RotorModel" in kinds:
                    found.add(f"{module.name}.{one.__qualname__}")
    assert found == TAKE_BOTH


# each holds the declared airframe against the declared rotors, effects and all, or is called with a Vehicle's
TAKE_BOTH = {
    "coaxlink.vehicle.vehicle.Vehicle.__init__",
    "coaxlink.effects.static.StaticVehicle.__init__",  # a Vehicle that is being made
    "coaxlink.frames.FlightFrame.__init__",
    "coaxlink.channels.flight.flight_frame",  # tracing: effects are part of the prediction
    "coaxlink.channels.flight.flown",  # which stretches are long enough for it
    "coaxlink.rotor_update.coefficients.by_speed",  # logged speeds into commands, no load
    "coaxlink.rotor_update.coefficients.coefficients_from_flights",  # the prior it updates, effects and all
    "coaxlink.health.turning.speed_ratios",  # logged speeds against commands, no load
    "coaxlink.premises.magnets.miscounted",  # the declared vehicle against what a log shows
    "coaxlink.premises.rotation.turned_otherwise",  # how pairs turn, no load
    "coaxlink.premises.rotation.pairs_unmeasured",
    "coaxlink.premises.rotation.rotation_of",
    "coaxlink.residual.refine.refine",
    "coaxlink.premises.same_vehicle.Flown.__init__",  # the declared vehicle against what a log shows
    "coaxlink.vehicle.vehicle.usual_lift",  # in a Vehicle that is being made
    "coaxlink.setup.checks.check_airframe",  # full thrust against the weight, as the two files have it
}


@pytest.mark.slow
def test_every_law_and_table_answers_for_the_weak_rotor():
    for law in LAWS:
        healthy, weak = (make_law(law, Vehicle(X8, m)).speeds(HOVER) for m in (CRM, WEAK))
        assert np.abs(weak - healthy).max() > 0.01, law
    assert report_px4(Vehicle(X8, WEAK), "fitted").params != report_px4(Vehicle(X8, CRM), "fitted").params


@pytest.mark.slow
def test_the_script_that_flew_the_healthy_rotor_flies_the_refined_one(tmp_path):
    """Load a refined model, make a law, make a table: in each the effect, or an error."""
    save_rotor_model(tmp_path / "refined.toml", WEAK)

    vehicle = cx.load_vehicle(example("x8_paper.toml"), tmp_path / "refined.toml")
    speeds = cx.make_law("exact", vehicle).speeds(HOVER)
    with pytest.raises(SafetyRefusal, match="a rotor is weak"):
        cx.make_table(vehicle, "px4")
    table = cx.make_table(vehicle, "px4", around_weak_rotor=True)

    pull, drag = X8.loads(CRM, speeds)
    pull[2], drag[2] = 0.7 * pull[2], 0.82 * drag[2]  # what rotor 3 has lost
    assert X8.wrench(pull, drag) == pytest.approx(HOVER, abs=1e-6)
    tipped = []
    for made in (table, cx.make_table(cx.Vehicle(X8, CRM), "px4")):
        pull, drag = X8.loads(CRM, made.speeds(0.0, 0.0, 0.0, 0.6))
        pull[2] *= 0.7
        tipped.append(np.abs(X8.wrench(pull, drag)[1:3]).max())
    assert tipped[0] < 0.5 * tipped[1]
    with pytest.raises((TypeError, cx.InputError)):
        cx.make_law("exact", cx.load_airframe(example("x8_paper.toml")), WEAK)
    with pytest.raises((TypeError, cx.InputError)):
        report_px4(X8, WEAK, "fitted")


def test_what_is_left_to_live_mixing_is_in_it_or_refused():
    live = Vehicle(X8, WEAK, measured_live=True)
    doors = (
        lambda: report_px4(live, "fitted"),
        lambda: report_ap(live, "reduced"),
        lambda: cx.make_table(live),
    )
    for door in doors:
        with pytest.raises(InputError, match="degraded_rotor: left to live mixing"):
            door()
    with pytest.raises(InputError, match="degraded_rotor: left to live mixing, and not in it"):
        MixCore(live)
    with pytest.raises(InputError, match="not in it"):
        MixCore(live, "exact", LiveEffects(None, Vehicle(X8, CRM, measured_live=True)))
    assert MixCore(live, "exact", LiveEffects(None, live)).vehicle is live


def test_what_no_mixer_can_hold_is_named(tmp_path):
    dragged = replace(
        CRM, effects=(EffectEntry("rotor_drag", {"drag_per_thrust_s_m": 0.02, "moment_share": 1.0}),)
    )
    vehicle = Vehicle(X8, dragged)
    assert "no rotor speed" in vehicle.left_out["rotor_drag"]
    assert "rotor_drag" in repr(vehicle)
    strange = replace(CRM, effects=(EffectEntry("phlogiston", {}),))
    assert Vehicle(X8, strange).left_out == {"phlogiston": "not known to the mixers"}


def test_a_vehicle_from_its_files(tmp_path):
    save_rotor_model(tmp_path / "weak.toml", WEAK)
    vehicle = load_vehicle(str(example("x8_paper.toml")), tmp_path / "weak.toml")
    assert set(vehicle.compensated) == {"degraded_rotor"} and vehicle.model.effects == ()
    result = allocate(make_law("exact", vehicle), vehicle, HOVER)
    assert result.error == pytest.approx(0.0, abs=1e-6)
    assert abs(result.speeds[2] - result.speeds[0]) > 0.05  # the weak one is not asked as the others are
    with pytest.raises(InputError, match="rotor_model"):
        text = example("x8_paper.toml").read_text().replace('rotor_model = "rotor_paper.toml"', "")
        (tmp_path / "bare.toml").write_text(text)
        load_vehicle(tmp_path / "bare.toml")


def test_a_rotor_alone_is_no_pair(tmp_path):
    save_rotor_model(tmp_path / "alone.toml", RotorModel.from_terms("srm", 5000.0, ALONE))
    with pytest.raises(InputError, match="a rotor alone was identified"):
        load_vehicle(example("x8_paper.toml"), tmp_path / "alone.toml")


ALONE = {
    "upper.thrust_N": {"u_u^2": 70.0},
    "upper.torque_Nm": {"u_u^2": 1.9},
    "lower.thrust_N": {},
    "lower.torque_Nm": {},
}
