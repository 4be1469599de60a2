"""The exact law on a pair whose lower rotor pulls down in the wake: it never answers with less."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from coaxlink.airframe import load_airframe
from coaxlink.files import example
from coaxlink.library import identify
from coaxlink.live.mixer_core import MixCore
from coaxlink.mixer import make_law
from coaxlink.mixer.exact import ExactLaw
from coaxlink.rotor import RotorModel
from coaxlink.rotor.drive import Drive, SideDrive
from coaxlink.vehicle import Vehicle, load_vehicle

X8 = load_vehicle(example("x8_paper.toml"))
WEIGHT = 9.81 * X8.airframe.mass_kg
# lower thrust 60 l (l - 0.5 u): it falls with its own speed up to a quarter of the upper's
CORNER = RotorModel.from_terms(
    "crm",
    5400.0,
    {
        "upper.thrust_N": {"u_u^2": 60.0},
        "upper.torque_Nm": {"u_u^2": 1.2},
        "lower.thrust_N": {"u_l^2": 60.0, "u_u u_l": -30.0},
        "lower.torque_Nm": {"u_l^2": 1.4, "u_u u_l": -0.5},
    },
)
VEHICLE = Vehicle(X8.airframe, CORNER)


def delivered(u):
    """(4,) by the terms above, written out."""
    upper, lower = np.array([(0, 5), (1, 4), (2, 7), (3, 6)]).T
    pull, drag = np.zeros(8), np.zeros(8)
    a, b = u[upper], u[lower]
    pull[upper], drag[upper] = 60 * a * a, 1.2 * a * a
    pull[lower], drag[lower] = 60 * b * b - 30 * a * b, 1.4 * b * b - 0.5 * a * b
    place = np.array([r.position_m for r in X8.airframe.rotors])
    spin = np.array([1, -1, 1, -1, 1, -1, 1, -1])  # of x8_paper.toml
    return np.array([pull.sum(), -place[:, 1] @ pull, place[:, 0] @ pull, spin @ drag])


def easy(rows, seed):
    """Demands near the weight with small turns, between them rest and hard turns that cannot be had."""
    rng = np.random.default_rng(seed)
    near = rng.uniform([0.8, -3, -3, -0.3], [1.2, 3, 3, 0.3], (rows, 4)) * [WEIGHT, 1, 1, 1]
    for demand in near:
        yield demand
        if rng.random() < 0.4:
            yield np.zeros(4) if rng.random() < 0.5 else np.array([2 * WEIGHT, 60.0, -40.0, 9.0])


@pytest.mark.parametrize("before", [[0, 0, 0, 0], [3 * WEIGHT, 90, 90, 20], [1.2 * WEIGHT, 0.5, 0.5, 0.1]])
def test_hover_is_had_from_anywhere_at_the_power_of_a_new_law(before):
    law = ExactLaw(VEHICLE)
    new = law.speeds([WEIGHT, 0, 0, 0])
    power = law.certificate.power
    law.speeds(before)
    assert delivered(law.speeds([WEIGHT, 0, 0, 0])) == pytest.approx([WEIGHT, 0, 0, 0], abs=1e-5)
    assert law.certificate.power == pytest.approx(power, rel=1e-3)
    assert new.min() > 0.1


def test_easy_demands_are_met_whatever_came_before():
    law = ExactLaw(VEHICLE)
    for demand in easy(60, 3):
        missed = np.abs(delivered(law.speeds(demand)) - demand)
        if demand[0] and demand[0] < 1.5 * WEIGHT:
            assert missed.max() < 1e-4, demand


def test_least_power_is_no_more_than_that_of_the_linear_laws_at_what_they_deliver():
    for name in ("standard", "reduced"):
        u = make_law(name, VEHICLE).speeds([WEIGHT, 0, 0, 0])
        law = ExactLaw(VEHICLE)
        law.speeds([0, 0, 0, 0])
        law.speeds(delivered(u))
        _, torque = VEHICLE.airframe.loads(CORNER, u)
        assert law.certificate.power <= torque @ u * 1.003, name


def test_a_demand_out_of_reach_is_not_looked_at_again_while_it_stays():
    law = ExactLaw(VEHICLE)
    for _ in range(20):
        law.speeds([3 * WEIGHT, 5.0, 0.0, 0.0])
    assert law.certificate.looks <= 1 and law.certificate.steps == 1


def test_live_mixing_commands_what_the_drive_needs_for_the_speeds_of_the_law():
    drive = Drive(
        SideDrive((0.02, 0.5, 0.3), 0.08, range=(0.05, 1.0)),
        SideDrive((0.03, 0.5, 0.3), 0.06, range=(0.05, 1.0)),
    )
    core = MixCore(Vehicle(X8.airframe, dataclasses.replace(CORNER, drive=drive)))
    sent = np.array(core.step(1, 0, [0.02, -0.01, 0.01, 0.45]))
    assert np.abs(sent - core.speeds).max() > 0.05  # else the drive was straight
    torque = VEHICLE.airframe.loads(CORNER, core.speeds)[1]
    for i, (u, q) in enumerate(zip(core.speeds, torque, strict=True)):
        c0, r = (0.02, 0.08) if X8.airframe.rotors[i].level == "upper" else (0.03, 0.06)
        assert sent[i] == pytest.approx(c0 + 0.5 * u + 0.3 * u * u + r * q, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("dead", [3, 7])
def test_what_the_other_rotors_can_give_is_had_where_one_stands_still(tmp_path, dead):
    stand = Path(__file__).parents[3] / "shared" / "data" / "coax" / "mn4014_16in_zD07.csv"
    if not stand.exists():
        pytest.skip("the public stand maps are not here")
    text = example("x8_paper.toml").read_text().replace("mass_kg = 20.0", "mass_kg = 7.34")
    (tmp_path / "x8.toml").write_text(text.replace("0.1807", "0.3203"))
    vehicle = Vehicle(load_airframe(tmp_path / "x8.toml"), identify(str(stand)).model)
    law, frame = ExactLaw(vehicle, failed=[dead]), vehicle.airframe
    commands = np.random.default_rng(dead).random((500, 8))
    commands[:, dead - 1] = 0.0
    demands = frame.wrench(*frame.loads(vehicle.model, vehicle.turned(commands)))
    got = frame.wrench(*frame.loads(vehicle.model, law.many(demands)))
    off = np.abs(got - demands) / (7.34 * 9.81 * np.array([1.0, 0.45, 0.45, 0.45]))
    assert off.max() < 0.005, np.flatnonzero(off.max(axis=1) > 0.005)


class Idle:
    """A law that gives everything up."""

    name, dropped = "exact", ("thrust",)

    def speeds(self, wrench):
        return np.zeros(8)


def test_live_mixing_sends_the_reduced_laws_answer_where_the_law_gives_less():
    core = MixCore(VEHICLE, Idle())
    core.step(1, 0, [0.0, 0.0, 0.0, 0.4])
    assert delivered(np.array(core.speeds))[0] > 0.5 * core.wrench[0]
    assert core.counters.account(1.0)["reduced_mixer_flown"] == 1


@pytest.mark.parametrize("hard", [6.0, 9.0, 12.0, 20.0])
def test_after_a_hard_turn_no_rotor_stands_that_need_not(hard):
    law = ExactLaw(VEHICLE)
    for yaw in np.linspace(hard, 0.0, 60):
        u = law.speeds([WEIGHT, 0, 0, yaw])
        if yaw < 1.0:
            assert u.min() > 0.1, yaw
    assert u == pytest.approx(ExactLaw(VEHICLE).speeds([WEIGHT, 0, 0, 0]), abs=1e-3)


def test_no_rotor_turns_slower_than_its_stand_did():
    measured = {"upper": (0.12, 1.0), "lower": (0.1, 1.0)}
    slow = Vehicle(X8.airframe, dataclasses.replace(CORNER, identified={"measured": measured}))
    for demand in ([0, 0, 0, 0], [WEIGHT, 0, 0, 20.0], [0.3 * WEIGHT, 0, 0, 0]):
        u = ExactLaw(slow).speeds(demand)
        assert u[:4].min() > 0.12 - 1e-9, demand
    dead = ExactLaw(slow, failed=[2]).speeds([WEIGHT, 0, 0, 0])
    assert dead[1] == 0.0
