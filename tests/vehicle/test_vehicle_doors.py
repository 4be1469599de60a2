"""No door lets an effect of the rotor file be dropped in silence."""

from dataclasses import replace

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.link.live_onboard import onboard_script
from coaxlink.link.mixing_core import MixCore
from coaxlink.link.tables import report_px4
from coaxlink.mixer import LAWS, allocate, make_law, reduced_coefficients, standard_coefficients
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.fitted import FittedLaw
from coaxlink.rotor import RotorModel, load_rotor_model, save_rotor_model
from coaxlink.rotor.model import Effect
from coaxlink.vehicle import Vehicle, load_vehicle

X8 = load_airframe(example("x8_paper.toml"))
CRM = load_rotor_model(example("rotor_paper.toml"))
WEAK = replace(
    CRM, effects=(Effect("degraded_rotor", {"rotor": 3.0, "thrust_loss": 0.3, "torque_loss": 0.18}),)
)
HOVER = [196.133, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("law", LAWS)
def test_an_airframe_and_a_model_are_no_vehicle(law):
    with pytest.raises(TypeError):
        make_law(law, X8, WEAK)
    with pytest.raises(InputError, match="a Vehicle is expected"):
        make_law(law, X8)


@pytest.mark.parametrize(
    "door",
    [
        lambda: ExactLaw(X8, WEAK),
        lambda: FittedLaw(X8, WEAK),
        lambda: reduced_coefficients(WEAK),
        lambda: standard_coefficients(WEAK),
        lambda: MixCore(X8, make_law("exact", Vehicle(X8, CRM)), WEAK),
    ],
)
def test_rooms_behind_the_doors_refuse_a_model_that_carries_effects(door):
    with pytest.raises(InputError, match=r"degraded_rotor.*make a Vehicle"):
        door()


@pytest.mark.parametrize("law", ["standard", "reduced", "coaxial", "exact", "fitted"])
def test_every_law_answers_for_the_weak_rotor(law):
    healthy, weak = (make_law(law, Vehicle(X8, m)).speeds(HOVER) for m in (CRM, WEAK))
    assert np.abs(weak - healthy).max() > 0.01


def test_tables_and_scripts_on_board_hold_the_effect_too():
    assert report_px4(Vehicle(X8, WEAK), "fitted").params != report_px4(Vehicle(X8, CRM), "fitted").params
    assert onboard_script(Vehicle(X8, WEAK)) != onboard_script(Vehicle(X8, CRM))


def test_what_no_mixer_can_hold_is_named(tmp_path):
    dragged = replace(
        CRM, effects=(Effect("rotor_drag", {"drag_per_thrust_s_m": 0.02, "moment_share": 1.0}),)
    )
    vehicle = Vehicle(X8, dragged)
    assert "no rotor speed" in vehicle.left_out["rotor_drag"]
    assert "rotor_drag" in repr(vehicle)
    strange = replace(CRM, effects=(Effect("phlogiston", {}),))
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


@pytest.mark.parametrize(
    ("name", "numbers", "said"),
    [
        ("degraded_rotor", {"rotor": 3.0}, "thrust_loss"),
        ("degraded_rotor", {"rotor": 12.0, "thrust_loss": 0.1}, "rotors 1 to 8"),
        ("degraded_rotor", {"rotor": 3.0, "thrust_loss": 1.5}, "0 to 1"),
        ("cg_offset", {"offset_x_m": 3.0, "offset_y_m": 0.0}, "-0.3 to 0.3 m"),
        ("mass_change", {"mass_kg": -2.0}, "mass_kg"),
    ],
)
def test_numbers_that_cannot_be_are_refused_with_their_key(name, numbers, said):
    with pytest.raises(InputError, match=said) as caught:
        Vehicle(X8, replace(CRM, effects=(Effect(name, numbers),)))
    assert f"effects.{name}" in str(caught.value)


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
