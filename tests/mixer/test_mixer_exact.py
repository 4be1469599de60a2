"""The exact law: exact where it can be, bounded and in order of priority where it cannot, least power."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from coaxlink.airframe import Airframe, Rotor, load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import allocate, make_law
from coaxlink.mixer.exact import ExactLaw
from coaxlink.rotor import RotorModel
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
X8 = load_airframe(EXAMPLES / "x8_paper.toml")
FRAMES = ("x8_paper", "y6", "coax_quad_plus", "coax_tilted", "mixed_hexa")


@lru_cache
def frame(name: str) -> Airframe:
    return load_airframe(EXAMPLES / f"{name}.toml")


def wrench_at(airframe: Airframe, model: RotorModel, u: NDArray[np.float64]) -> NDArray[np.float64]:
    return airframe.wrench(*airframe.loads(model, u))


def power_at(airframe: Airframe, model: RotorModel, u: NDArray[np.float64]) -> float:
    return float(airframe.loads(model, u)[1] @ u)


def test_hover_of_the_papers_vehicle_is_the_known_optimum() -> None:
    result = allocate(make_law("exact", Vehicle(X8, CRM)), Vehicle(X8, CRM), [196.2, 0, 0, 0])
    assert result.speeds[:4] == pytest.approx(np.full(4, 0.441), abs=1e-3)
    assert result.speeds[4:] == pytest.approx(np.full(4, 0.648), abs=1e-3)
    assert np.abs(result.error).max() < 1e-6


def test_the_yaw_that_algorithm_1_leaves_is_delivered() -> None:
    demand = [196.2, 1.0, -1.0, 0.8]
    assert allocate(make_law("exact", Vehicle(X8, CRM)), Vehicle(X8, CRM), demand).error[3] == pytest.approx(
        0, abs=1e-6
    )
    assert allocate(make_law("coaxial-printed", Vehicle(X8, CRM)), Vehicle(X8, CRM), demand).error[
        3
    ] == pytest.approx(-0.8, abs=0.01)


def test_mean_power_over_the_papers_envelope() -> None:
    rng = np.random.default_rng(0)
    law = ExactLaw(Vehicle(X8, CRM))
    powers, worst = [], 0.0
    for _ in range(400):
        wrench = rng.uniform([150, -4, -4, -1], [260, 4, 4, 1])
        u = law.speeds(wrench)
        worst = max(worst, float(np.abs(wrench_at(X8, CRM, u) - wrench).max()))
        powers.append(law.certificate.power)
    assert worst < 1e-6
    assert np.mean(powers) == pytest.approx(3.74, abs=0.06)  # another draw gave 3.7342


@settings(max_examples=60, deadline=None)
@given(data=st.data(), name=st.sampled_from(FRAMES))
def test_what_some_speeds_can_do_is_delivered_at_no_more_power(data: st.DataObject, name: str) -> None:
    airframe = frame(name)
    n = len(airframe.rotors)
    u = np.array(data.draw(st.lists(st.floats(0.05, 0.95), min_size=n, max_size=n)))
    wrench = wrench_at(airframe, CRM, u)
    law = ExactLaw(Vehicle(airframe, CRM))
    found = law.speeds(wrench)
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    assert np.abs(wrench_at(airframe, CRM, found) - wrench).max() < 1e-6
    assert power_at(airframe, CRM, found) <= power_at(airframe, CRM, u) * (1 + 1e-9)
    assert law.dropped == ()


@settings(max_examples=80, deadline=None)
@given(
    thrust=st.floats(-1e6, 1e6), roll=st.floats(-1e3, 1e3), pitch=st.floats(-1e3, 1e3),
    yaw=st.floats(-1e3, 1e3), name=st.sampled_from(FRAMES),
)  # fmt: skip
def test_any_demand_gives_speeds_in_bounds(
    thrust: float, roll: float, pitch: float, yaw: float, name: str
) -> None:
    law = ExactLaw(Vehicle(frame(name), CRM), low=0.1, high=0.9)
    u = law.speeds([thrust, roll, pitch, yaw])
    assert np.isfinite(u).all()
    assert u.min() >= 0.1
    assert u.max() <= 0.9


@pytest.mark.parametrize("sign", [-1, 1])
def test_yaw_is_given_up_before_thrust_and_thrust_before_roll_and_pitch(sign: int) -> None:
    law = ExactLaw(Vehicle(X8, CRM))
    much_yaw = allocate(law, Vehicle(X8, CRM), [196.2, 2.0, 1.0, sign * 20.0])
    assert much_yaw.dropped == ("yaw",)
    assert np.abs(much_yaw.error[:3]).max() < 1e-6
    assert sign * much_yaw.delivered[3] > 4.0
    much_thrust = allocate(law, Vehicle(X8, CRM), [600.0, sign * 5.0, 3.0, 0.0])
    assert "thrust" in much_thrust.dropped
    assert np.abs(much_thrust.error[1:3]).max() < 1e-6
    assert much_thrust.delivered[0] > 400.0


def test_the_order_of_priority_is_an_option() -> None:
    law = ExactLaw(Vehicle(X8, CRM), priority=("yaw", "thrust", "roll", "pitch"))
    result = allocate(law, Vehicle(X8, CRM), [196.2, 60.0, 0.0, 3.0])
    assert "roll" in result.dropped
    assert abs(result.error[3]) < 1e-6
    assert abs(result.error[0]) < 1e-6


def test_out_of_reach_it_is_at_least_as_good_as_slsqp_with_the_same_priorities() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(11)
    for _ in range(6):
        wrench = np.array(
            [rng.uniform(100, 300), *rng.uniform(-8, 8, 2), rng.choice([-1, 1]) * rng.uniform(6, 12)]
        )
        mine = allocate(ExactLaw(Vehicle(X8, CRM)), Vehicle(X8, CRM), wrench)
        assert np.abs(mine.error[:3]).max() < 1e-6
        held = {"type": "eq", "fun": lambda u, w=wrench: (wrench_at(X8, CRM, u) - w)[:3]}
        best = 1e9
        for start in (np.full(8, 0.5), rng.uniform(0.2, 0.9, 8)):
            found = minimize(
                lambda u, w=wrench: (wrench_at(X8, CRM, u)[3] - w[3]) ** 2, start, method="SLSQP",
                bounds=[(0, 1)] * 8, constraints=[held], options={"maxiter": 300},
            )  # fmt: skip
            if found.success and np.abs(held["fun"](found.x)).max() < 1e-5:
                best = min(best, abs(wrench_at(X8, CRM, found.x)[3] - wrench[3]))
        assert abs(mine.error[3]) <= best + 1e-4


def test_least_power_agrees_with_slsqp() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    for _ in range(6):
        wrench = rng.uniform([120, -5, -5, -1.5], [300, 5, 5, 1.5])
        found = minimize(
            lambda u: power_at(X8, CRM, u), np.full(8, 0.5), method="SLSQP", bounds=[(0, 1)] * 8,
            constraints=[{"type": "eq", "fun": lambda u, w=wrench: wrench_at(X8, CRM, u) - w}],
            options={"ftol": 1e-13, "maxiter": 500},
        )  # fmt: skip
        assert found.success
        mine = power_at(X8, CRM, ExactLaw(Vehicle(X8, CRM)).speeds(wrench))
        assert mine == pytest.approx(found.fun, rel=1e-6)


def test_it_is_continuous_through_the_edge_of_reach() -> None:
    law = ExactLaw(Vehicle(X8, CRM))
    low, high, last = 0.0, 10.0, 1.0
    for _ in range(3):  # where it moves fastest, a step ten times smaller moves it far less
        yaws = np.linspace(low, high, 400)
        speeds = np.array([law.speeds([196.2, 1.0, 0.5, yaw]) for yaw in yaws])
        moves = np.abs(np.diff(speeds, axis=0)).max(axis=1)
        assert moves.max() < 0.4 * last
        last, at, width = moves.max(), yaws[moves.argmax()], (high - low) / 40
        low, high = at - width / 2, at + width / 2
    assert last < 0.002


def test_left_and_right_swap_when_roll_and_yaw_flip() -> None:
    mirror = [1, 0, 3, 2, 5, 4, 7, 6]  # 1-2, 3-4, 5-6, 7-8 lie opposite across the x axis
    left = ExactLaw(Vehicle(X8, CRM)).speeds([200.0, 3.0, -1.0, 0.7])
    right = ExactLaw(Vehicle(X8, CRM)).speeds([200.0, -3.0, -1.0, -0.7])
    assert right[mirror] == pytest.approx(left, abs=1e-7)


@pytest.mark.parametrize("dead", [1, 6])
def test_a_dead_rotor_is_allocated_around(dead: int) -> None:
    law = ExactLaw(Vehicle(X8, CRM), failed=[dead])
    result = allocate(law, Vehicle(X8, CRM), [196.2, 1.0, -1.0, 0.2])
    assert result.speeds[dead - 1] == 0.0
    assert np.abs(result.error).max() < 1e-6
    assert result.dropped == ()


def test_speeds_move_no_further_than_the_slew_limit() -> None:
    law = ExactLaw(Vehicle(X8, CRM), slew=0.01)
    before = law.speeds([196.2, 0, 0, 0])
    for _ in range(30):
        after = law.speeds([280.0, 3.0, 0, 0.5])
        assert np.abs(after - before).max() <= 0.01 + 1e-12
        before = after
    assert wrench_at(X8, CRM, before) == pytest.approx([280.0, 3.0, 0, 0.5], abs=1e-6)


def test_the_certificate_tells_the_truth() -> None:
    law = ExactLaw(Vehicle(X8, CRM))
    wrench = np.array([196.2, 1.0, -1.0, 15.0])
    u = law.speeds(wrench)
    certificate = law.certificate
    assert certificate.steps > 0
    assert certificate.miss == pytest.approx(wrench - wrench_at(X8, CRM, u), abs=1e-9)
    assert certificate.power == pytest.approx(power_at(X8, CRM, u), rel=1e-9)
    assert (u[certificate.active > 0] > 1 - 1e-9).all()
    assert (u[certificate.active < 0] < 1e-9).all()
    hover = law.speeds([196.2, 0, 0, 0])
    price = law.certificate.prices[0]
    more = power_at(X8, CRM, law.speeds([196.3, 0, 0, 0])) - power_at(X8, CRM, hover)
    assert price == pytest.approx(more / 0.1, rel=1e-3)


def test_other_orders_of_the_rotor_model_are_exact_too() -> None:
    terms = {load: dict(t) for load, t in CRM.terms().items()}
    terms["upper.thrust_N"]["u_u^3"] = 4.0
    terms["upper.thrust_N"]["u_u u_l"] = -2.0  # an upper rotor that feels the lower one
    terms["lower.thrust_N"]["u_u u_l^3"] = -3.0
    terms["lower.torque_Nm"]["u_l^4"] = 0.2
    model = RotorModel.from_terms("crm", 5400.0, terms)
    wrench = np.array([180.0, 2.0, -2.0, 0.4])
    u = ExactLaw(Vehicle(X8, model)).speeds(wrench)
    assert wrench_at(X8, model, u) == pytest.approx(wrench, abs=1e-6)
    # least power: no step along the constraint's null space does better
    jacobian = np.array([(wrench_at(X8, model, u + 1e-6 * e) - wrench) / 1e-6 for e in np.eye(8)]).T
    slope = np.array([(power_at(X8, model, u + 1e-6 * e) - power_at(X8, model, u)) / 1e-6 for e in np.eye(8)])
    null = np.linalg.svd(jacobian)[2][4:]
    assert np.abs(null @ slope).max() < 1e-4


@settings(max_examples=25, deadline=None)
@given(
    arms=st.integers(3, 8), radius=st.floats(0.15, 0.8), turn=st.floats(0, 1), tilt=st.floats(0, 0.15),
    load=st.floats(0.3, 0.6), seed=st.integers(0, 2**16),
)  # fmt: skip
def test_random_vehicles_of_up_to_sixteen_rotors(
    arms: int, radius: float, turn: float, tilt: float, load: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    uppers, lowers = [], []
    for k in range(arms):
        angle = 2 * np.pi * (k + turn) / arms + rng.uniform(-0.1, 0.1)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        axis = np.array([tilt * rng.normal(), tilt * rng.normal(), -1.0])
        axis /= np.linalg.norm(axis)
        spin = 1 if k % 2 else -1
        uppers.append(Rotor(k + 1, (x, y, -0.07), tuple(axis), spin, "upper", k + 1 + arms))
        lowers.append(Rotor(k + 1 + arms, (x, y, 0.07), tuple(axis), -spin, "lower", k + 1))
    airframe = Airframe("random", 10.0, (1, 1, 1), (*uppers, *lowers))
    wrench = wrench_at(airframe, CRM, load * rng.uniform(0.8, 1.2, 2 * arms))
    law = ExactLaw(Vehicle(airframe, CRM))
    u = law.speeds(wrench)
    assert np.abs(wrench_at(airframe, CRM, u) - wrench).max() < 1e-6
    assert law.certificate.steps > 0


def test_wrong_options_are_named() -> None:
    for options, says in (
        ({"low": 0.5, "high": 0.4}, "bounds"),
        ({"failed": [9]}, "rotor 9"),
        ({"priority": ("roll", "pitch")}, "priority"),
        ({"slew": 0.0}, "slew"),
    ):
        with pytest.raises(InputError, match=says):
            ExactLaw(Vehicle(X8, CRM), **options)  # type: ignore[arg-type]


def test_compiled_or_not_it_is_the_same_law() -> None:
    compiled, plain = ExactLaw(Vehicle(X8, CRM), compiled=True), ExactLaw(Vehicle(X8, CRM))
    assert compiled.compiled
    assert not plain.compiled
    rng = np.random.default_rng(4)
    demands = rng.uniform([100, -6, -6, -3], [320, 6, 6, 3], (40, 4))
    demands[::8, 3] = 20.0
    rows = np.array([plain.speeds(d) for d in demands])
    assert np.array([compiled.speeds(d) for d in demands]) == pytest.approx(rows, abs=1e-7)
    compiled.reset()
    assert compiled.many(demands) == pytest.approx(rows, abs=1e-7)


def test_many_is_the_same_as_one_after_the_other() -> None:
    demands = np.random.default_rng(8).uniform([150, -4, -4, -1], [260, 4, 4, 1], (30, 4))
    one, many = ExactLaw(Vehicle(X8, CRM)), ExactLaw(Vehicle(X8, CRM))
    assert many.many(demands) == pytest.approx(np.array([one.speeds(d) for d in demands]), abs=1e-9)
    with pytest.raises(InputError, match="finite rows"):
        many.many([[1.0, 2.0, np.nan, 0.0]])


def test_ten_thousand_wrenches_within_reach_are_delivered() -> None:
    rng = np.random.default_rng(21)
    u = rng.uniform(0.2, 0.9, (10_000, 8))
    demands = X8.wrench(*X8.loads(CRM, u))  # all within reach, most far from any hover
    found = ExactLaw(Vehicle(X8, CRM), compiled=True).many(demands)
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    thrust, torque = X8.loads(CRM, found)
    assert np.abs(X8.wrench(thrust, torque) - demands).max() < 1e-6
    assert ((torque * found).sum(axis=1) <= (X8.loads(CRM, u)[1] * u).sum(axis=1) * (1 + 1e-9)).all()
