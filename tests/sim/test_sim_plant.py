"""The plant against closed forms: fall, hover, lag, energy, step size, and each effect's own law."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim.physics.pair import Pair
from sim.physics.plant import GRAVITY, Plant
from sim.physics.rotors import read_pair
from sim.truth import FORMS, HIDDEN, HiddenEffect, Truth, hidden_truth, read_truth, truth_text
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
HOVER = np.array([0.441] * 4 + [0.648] * 4)


@pytest.fixture
def plant() -> Plant:
    return Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(EXAMPLES / "rotor_paper.toml"))


def no_thrust(plant: Plant) -> Plant:
    return Plant(plant.vehicle, Pair(5400.0, np.zeros((4, 5, 5))))


def with_effects(plant: Plant, *effects: HiddenEffect) -> Plant:
    Truth(effects).act(plant)
    return plant


def spin_up(plant: Plant, u: np.ndarray, height: float = 5.0) -> None:
    """Rotors at speed, in the air, at rest and level."""
    plant.state[:] = 0.0
    plant.state[2], plant.state[6], plant.state[13] = -height, 1.0, 0.9
    plant.state[14] = 30.0
    plant.speeds[:] = u
    plant.advance(u, 0)


def eq17(u: float, v: float) -> tuple[float, float, float, float]:
    return (
        55.9517 * u * u + 22.4464 * u,
        1.2437 * u * u + 0.7155 * u,
        2.755 * u * u * v * v + 64.721 * v * v - 2.547 * u * v + 12.402 * v - 37.502 * u * u + 0.801,
        0.307 * u * v * v + 1.466 * v * v + 0.573 * v - 0.695 * u * u,
    )


def test_free_fall(plant: Plant) -> None:
    p = no_thrust(plant)
    spin_up(p, np.zeros(8), 50.0)
    p.advance(np.zeros(8), 1000)
    assert p.position[2] == pytest.approx(-50.0 + GRAVITY / 2, abs=1e-9)
    assert p.specific_force == pytest.approx([0, 0, 0], abs=1e-9)


def test_hover_is_equation_17(plant: Plant) -> None:
    fu, qu, fl, ql = eq17(0.441, 0.648)
    spin_up(plant, HOVER)
    assert plant.thrust == pytest.approx([fu] * 4 + [fl] * 4)
    assert plant.torque == pytest.approx([qu] * 4 + [ql] * 4)
    assert plant.specific_force == pytest.approx([0, 0, -4 * (fu + fl) / 20.0], abs=1e-9)


def test_moments_and_yaw_have_the_signs_of_frd(plant: Plant) -> None:
    for rotors, axis, sign in (((1, 2, 4, 7), 0, 1), ((0, 1, 4, 5), 1, 1), ((0, 2, 4, 6), 2, 1)):
        u = np.full(8, 0.5)
        u[list(rotors)] += 0.02  # left rotors up: roll right; front: pitch up; counter-clockwise: yaw right
        spin_up(plant, u)
        alpha = plant.out[3:6]
        assert sign * alpha[axis] > 0.02 and abs(alpha[axis]) > 5 * np.abs(np.delete(alpha, axis)).max()


def test_the_motors_lag_as_declared(plant: Plant) -> None:
    spin_up(plant, np.zeros(8))
    plant.advance(HOVER, 20)
    assert plant.speeds == pytest.approx(HOVER * (1 - math.exp(-1)), rel=1e-9)


def test_it_rests_on_the_ground(plant: Plant) -> None:
    plant.advance(np.zeros(8), 3000)
    assert plant.height == pytest.approx(0.2, abs=0.02)
    assert np.abs(plant.velocity).max() < 1e-3
    assert plant.specific_force[2] == pytest.approx(-GRAVITY, rel=1e-3)
    plant.state[5] = 2.0  # dropped again, it comes to rest again
    plant.advance(np.zeros(8), 3000)
    assert plant.height == pytest.approx(0.2, abs=0.02) and np.abs(plant.velocity).max() < 1e-2


def test_upside_down_it_rests_on_its_back(plant: Plant) -> None:
    spin_up(plant, np.zeros(8), 0.4)
    plant.state[6:10] = 0.1, 0.99, 0.0, 0.1
    plant.state[6:10] /= np.linalg.norm(plant.state[6:10])
    plant.advance(np.zeros(8), 6000)
    assert plant.height == pytest.approx(0.12, abs=0.03) and np.abs(plant.velocity).max() < 0.02
    assert plant.specific_force[2] == pytest.approx(GRAVITY, rel=0.02)


def test_free_rotation_keeps_energy_and_angular_momentum(plant: Plant) -> None:
    p = no_thrust(plant)
    spin_up(p, np.zeros(8), 500.0)
    p.state[10:13] = 3.0, -2.0, 1.5

    def invariants() -> np.ndarray:
        w, i = p.rates, p.vehicle.inertia_kg_m2
        return np.array([(i * w * w).sum() / 2, ((i * w) ** 2).sum()])

    before = invariants()
    p.advance(np.zeros(8), 5000)
    assert invariants() == pytest.approx(before, rel=1e-10)


def test_the_step_size_converges_with_fourth_order(plant: Plant) -> None:
    u = HOVER + np.array([0.01, -0.01, 0.02, 0.0, 0.01, 0.0, -0.02, 0.01])

    def end(step: float) -> np.ndarray:
        spin_up(plant, np.full(8, 0.5), 50.0)
        plant.state[10:13] = 4.0, -3.0, 2.0
        plant.advance(u, round(0.4 / step), step)
        return plant.state[:13].copy()

    exact = end(0.0005)
    errors = [np.abs(end(h) - exact).max() for h in (0.02, 0.01, 0.005)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([4.0, 4.0], abs=0.4)


def force(plant: Plant) -> np.ndarray:
    return plant.specific_force * plant.parameters[0]


def test_battery_voltage(plant: Plant) -> None:
    spin_up(with_effects(plant, HiddenEffect("battery_voltage", 0.4)), np.zeros(8))
    plant.parameters[plant.index.RESISTANCE] = 0.0
    plant.advance(HOVER, 400)
    # rotors settle where the sagging command says, at the voltage of a moment ago
    assert plant.speeds == pytest.approx(HOVER * (plant.voltage / 33.6) ** 0.4, rel=1e-3)
    assert plant.speeds[0] < 0.995 * HOVER[0]


def test_ground_effect(plant: Plant) -> None:
    spin_up(plant, HOVER, height=0.5)
    free = plant.thrust.copy()
    with_effects(plant, HiddenEffect("ground_effect", 0.2, 0.0, {"scale_m": 0.8}))
    plant.advance(HOVER, 0)
    height = 0.7 - plant.vehicle.position_m[:, 2]
    assert plant.thrust / free == pytest.approx(1 + 0.2 * np.exp(-height / 0.8))


def test_rotor_drag_pushes_back_at_the_hubs(plant: Plant) -> None:
    spin_up(with_effects(plant, HiddenEffect("rotor_drag", 1.2)), HOVER)
    plant.state[3:5] = 3.0, -1.0
    plant.advance(HOVER, 0)
    assert force(plant)[:2] == pytest.approx(-1.2 * HOVER.sum() * np.array([3.0, -1.0]))
    z = plant.vehicle.position_m[:, 2]
    drag = -1.2 * HOVER * 3.0
    assert plant.out[4] * 0.95 == pytest.approx((z * drag).sum(), abs=1e-9)


def test_axial_inflow_takes_thrust_in_a_climb(plant: Plant) -> None:
    spin_up(with_effects(plant, HiddenEffect("axial_inflow", 4.0)), HOVER)
    still = plant.thrust.copy()
    plant.state[5] = -2.0
    plant.advance(HOVER, 0)
    x = 4.0 * 2.0 / (5400 * math.pi / 30 * 0.235 * HOVER)
    assert plant.thrust / still == pytest.approx(1 - x / (1 + x))


def test_wind_pushes_until_the_vehicle_drifts_with_it(plant: Plant) -> None:
    extra = {"direction_deg": 90.0, "body_drag_kg_m": 0.1}
    spin_up(with_effects(plant, HiddenEffect("wind", 6.0, 0.0, extra)), HOVER)
    assert force(plant)[:2] == pytest.approx([0.0, 0.1 * 36.0])
    plant.state[4] = 6.0
    plant.advance(HOVER, 0)
    assert force(plant)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_rotor_inertia_reacts_to_spinning_up(plant: Plant) -> None:
    spin_up(plant, HOVER)
    plant.advance(HOVER + 0.05 * (plant.vehicle.spin > 0), 0)
    before = plant.out[5]
    with_effects(plant, HiddenEffect("rotor_inertia_torque", 0.002))
    plant.advance(HOVER + 0.05 * (plant.vehicle.spin > 0), 0)
    # four rotors turning counter-clockwise (about -z) faster push the body to +z
    expected = 4 * 0.002 * (5400 * math.pi / 30) * 0.05 / 0.02
    assert (plant.out[5] - before) * 1.60 == pytest.approx(expected)


def test_hidden_worlds_differ_and_repeat() -> None:
    drawn = [hidden_truth(seed, 8).effects[0] for seed in range(60)]
    assert {e.name for e in drawn} == set(HIDDEN) and len(HIDDEN) >= 5
    assert drawn == [hidden_truth(seed, 8).effects[0] for seed in range(60)]
    assert len({e.size for e in drawn}) > 50


def test_a_truth_survives_its_file(tmp_path: Path) -> None:
    truth = hidden_truth(4, 8)
    path = tmp_path / "truth.toml"
    path.write_text(truth_text(truth))
    assert read_truth(path).effects == truth.effects
    for example in EXAMPLES.glob("truth_[bd]*.toml"):
        assert all(e.name in FORMS for e in read_truth(example).effects)


def test_calm_air_is_the_general_case_with_nothing_in_it(plant: Plant) -> None:
    u = HOVER + np.array([0.01, -0.01, 0.02, 0.0, 0.01, 0.0, -0.02, 0.01])

    def end() -> np.ndarray:
        spin_up(plant, np.full(8, 0.5), 50.0)
        plant.state[10:13] = 1.0, -2.0, 0.5
        plant.advance(u, 800)
        return plant.state.copy()

    calm = end()
    plant.parameters[plant.index.ROTOR_INERTIA] = 1e-300  # nothing, yet no longer exactly nothing
    assert end() == pytest.approx(calm, rel=1e-9, abs=1e-9)


def test_other_rotors_and_higher_powers_take_the_general_way(tmp_path: Path) -> None:
    text = (EXAMPLES / "x8_demo.toml").read_text().replace('level = "upper"\npair = 6', 'level = "single"')
    text = text.replace('level = "lower"\npair = 1', 'level = "single"')
    (tmp_path / "x8.toml").write_text(text)
    cubic = read_pair(EXAMPLES / "rotor_paper.toml")
    cubic.coefficients[0, 3, 1] = 2.0
    p = Plant(read_vehicle(tmp_path / "x8.toml"), cubic)
    u = np.array([0.5, 0.45, 0.5, 0.45, 0.6, 0.65, 0.6, 0.65])
    spin_up(p, u)
    pairs = [eq17(a, b) for a, b in ((0.45, 0.6), (0.5, 0.65), (0.45, 0.6))]
    extra = [2.0 * a**3 * b for a, b in ((0.45, 0.6), (0.5, 0.65), (0.45, 0.6))]
    upper = [pairs[k][0] + extra[k] for k in range(3)]
    assert p.thrust[[1, 2, 3]] == pytest.approx([upper[0], upper[1], upper[2]])
    assert p.thrust[[0, 5]] == pytest.approx([eq17(0.5, 0)[0], eq17(0.65, 0)[0]])
