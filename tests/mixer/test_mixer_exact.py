"""The exact law: exact where it can be, bounded and in order of priority where it cannot, least power."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from coaxlink.airframe import Airframe, Rotor, load_airframe
from coaxlink.errors import InputError
from coaxlink.mixer import allocate
from coaxlink.mixer.exact import ExactLaw
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.vehicle import Vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
FRAMES = ("x8_paper", "y6", "coax_quad_plus", "coax_tilted", "mixed_hexa")


@lru_cache
def vehicle(name):
    return Vehicle(load_airframe(EXAMPLES / f"{name}.toml"), CRM)


X8 = vehicle("x8_paper")


def wrench_of(u, of=X8):
    return of.airframe.wrench(*of.airframe.loads(of.model, u))


def power_of(u, of=X8):
    return float((of.airframe.loads(of.model, u)[1] * u).sum(axis=-1).mean())


def test_hover_of_the_papers_vehicle_is_the_known_optimum():
    u = ExactLaw(X8).speeds([196.2, 0, 0, 0])
    assert u == pytest.approx([0.441] * 4 + [0.648] * 4, abs=1e-3)


def test_mean_power_over_the_papers_envelope():
    demands = np.random.default_rng(0).uniform([150, -4, -4, -1], [260, 4, 4, 1], (400, 4))
    u = ExactLaw(X8).many(demands)
    assert np.abs(wrench_of(u) - demands).max() < 1e-6
    assert power_of(u) == pytest.approx(3.74, abs=0.06)  # another draw gave 3.7342


@settings(max_examples=60, deadline=None)
@given(data=st.data(), name=st.sampled_from(FRAMES))
def test_what_some_speeds_can_do_is_delivered_at_no_more_power(data, name):
    of = vehicle(name)
    n = len(of.airframe.rotors)
    u = np.array(data.draw(st.lists(st.floats(0.05, 0.95), min_size=n, max_size=n)))
    law = ExactLaw(of)
    found = law.speeds(wrench_of(u, of))
    assert found.min() >= 0.0 and found.max() <= 1.0
    assert np.abs(wrench_of(found, of) - wrench_of(u, of)).max() < 1e-6
    assert power_of(found, of) <= power_of(u, of) * (1 + 1e-9)
    assert law.dropped == ()


@settings(max_examples=80, deadline=None)
@given(wrench=st.tuples(st.floats(-1e6, 1e6), *[st.floats(-1e3, 1e3)] * 3), name=st.sampled_from(FRAMES))
def test_any_demand_gives_speeds_in_bounds(wrench, name):
    u = ExactLaw(vehicle(name), low=0.1, high=0.9).speeds(wrench)
    assert np.isfinite(u).all() and u.min() >= 0.1 and u.max() <= 0.9


def test_yaw_is_given_up_before_thrust_and_thrust_before_roll_and_pitch():
    for sign in (-1, 1):
        law = ExactLaw(X8)
        yaw = allocate(law, X8, [196.2, 2.0, 1.0, sign * 20.0])
        assert yaw.dropped == ("yaw",) and np.abs(yaw.error[:3]).max() < 1e-6
        assert sign * yaw.delivered[3] > 4.0
        thrust = allocate(law, X8, [600.0, sign * 5.0, 3.0, 0.0])
        assert "thrust" in thrust.dropped and np.abs(thrust.error[1:3]).max() < 1e-6
        assert thrust.delivered[0] > 400.0
    other = ExactLaw(X8, priority=("yaw", "thrust", "roll", "pitch"))
    result = allocate(other, X8, [196.2, 60.0, 0.0, 3.0])
    assert "roll" in result.dropped and np.abs(result.error[[0, 3]]).max() < 1e-6


@pytest.mark.slow
def test_out_of_reach_it_is_at_least_as_good_as_slsqp_with_the_same_priorities():
    rng = np.random.default_rng(11)
    for _ in range(4):
        yaw = rng.choice([-1, 1]) * rng.uniform(6, 12)
        wrench = np.array([rng.uniform(100, 300), *rng.uniform(-8, 8, 2), yaw])
        mine = allocate(ExactLaw(X8), X8, wrench)
        assert np.abs(mine.error[:3]).max() < 1e-6
        held = {"type": "eq", "fun": lambda u, w=wrench: (wrench_of(u) - w)[:3]}
        best = 1e9
        for start in (np.full(8, 0.5), rng.uniform(0.2, 0.9, 8)):
            found = minimize(
                lambda u, w=wrench: (wrench_of(u)[3] - w[3]) ** 2, start, method="SLSQP",
                bounds=[(0, 1)] * 8, constraints=[held], options={"maxiter": 300},
            )  # fmt: skip
            if found.success and np.abs(held["fun"](found.x)).max() < 1e-5:
                best = min(best, abs(wrench_of(found.x)[3] - wrench[3]))
        assert abs(mine.error[3]) <= best + 1e-4


@pytest.mark.slow
def test_least_power_agrees_with_slsqp():
    for wrench in np.random.default_rng(5).uniform([120, -5, -5, -1.5], [300, 5, 5, 1.5], (4, 4)):
        found = minimize(
            power_of, np.full(8, 0.5), method="SLSQP", bounds=[(0, 1)] * 8,
            constraints=[{"type": "eq", "fun": lambda u, w=wrench: wrench_of(u) - w}],
            options={"ftol": 1e-13, "maxiter": 500},
        )  # fmt: skip
        assert found.success
        assert power_of(ExactLaw(X8).speeds(wrench)) == pytest.approx(found.fun, rel=1e-6)


def test_it_is_continuous_through_the_edge_of_reach():
    law = ExactLaw(X8)
    low, high, last = 0.0, 10.0, 1.0
    for _ in range(3):  # where it moves fastest, a step ten times smaller moves it far less
        yaws = np.linspace(low, high, 400)
        speeds = np.array([law.speeds([196.2, 1.0, 0.5, yaw]) for yaw in yaws])
        moves = np.abs(np.diff(speeds, axis=0)).max(axis=1)
        assert moves.max() < 0.4 * last
        last, at, width = moves.max(), yaws[moves.argmax()], (high - low) / 40
        low, high = at - width / 2, at + width / 2
    assert last < 0.002


def test_left_and_right_swap_when_roll_and_yaw_flip():
    mirror = [1, 0, 3, 2, 5, 4, 7, 6]  # 1-2, 3-4, 5-6, 7-8 lie opposite across the x axis
    left, right = (ExactLaw(X8).speeds([200.0, 3.0 * s, -1.0, 0.7 * s]) for s in (1, -1))
    assert right[mirror] == pytest.approx(left, abs=1e-7)


def test_a_dead_rotor_is_allocated_around():
    for dead in (1, 6):
        law = ExactLaw(X8, failed=[dead])
        result = allocate(law, X8, [196.2, 1.0, -1.0, 0.2])
        assert result.speeds[dead - 1] == 0.0
        assert np.abs(result.error).max() < 1e-6 and result.dropped == ()


def test_the_certificate_tells_the_truth():
    law = ExactLaw(X8)
    wrench = np.array([196.2, 1.0, -1.0, 15.0])
    u = law.speeds(wrench)
    certificate = law.certificate
    assert certificate.steps > 0
    assert certificate.miss == pytest.approx(wrench - wrench_of(u), abs=1e-9)
    assert certificate.power == pytest.approx(power_of(u), rel=1e-9)
    assert (u[certificate.active > 0] > 1 - 1e-9).all() and (u[certificate.active < 0] < 1e-9).all()
    hover = law.speeds([196.2, 0, 0, 0])
    price = law.certificate.prices[0]
    more = power_of(law.speeds([196.3, 0, 0, 0])) - power_of(hover)
    assert price == pytest.approx(more / 0.1, rel=1e-3)


def test_other_orders_of_the_rotor_model_are_exact_too():
    terms = {load: dict(t) for load, t in CRM.terms().items()}
    terms["upper.thrust_N"] |= {"u_u^3": 4.0, "u_u u_l": -2.0}  # an upper rotor that feels the lower one
    terms["lower.thrust_N"]["u_u u_l^3"] = -3.0
    terms["lower.torque_Nm"]["u_l^4"] = 0.2
    of = Vehicle(X8.airframe, RotorModel.from_terms("crm", 5400.0, terms))
    wrench = np.array([180.0, 2.0, -2.0, 0.4])
    u = ExactLaw(of).speeds(wrench)
    assert wrench_of(u, of) == pytest.approx(wrench, abs=1e-6)
    # least power: no step along the constraint's null space does better
    steps = [u + 1e-6 * e for e in np.eye(8)]
    jacobian = np.array([(wrench_of(x, of) - wrench) / 1e-6 for x in steps]).T
    slope = np.array([(power_of(x, of) - power_of(u, of)) / 1e-6 for x in steps])
    assert np.abs(np.linalg.svd(jacobian)[2][4:] @ slope).max() < 1e-4


@settings(max_examples=25, deadline=None)
@given(
    arms=st.integers(3, 8), radius=st.floats(0.15, 0.8), turn=st.floats(0, 1), tilt=st.floats(0, 0.15),
    load=st.floats(0.3, 0.6), seed=st.integers(0, 2**16),
)  # fmt: skip
def test_random_vehicles_of_up_to_sixteen_rotors(arms, radius, turn, tilt, load, seed):
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
    of = Vehicle(Airframe("random", 10.0, (1, 1, 1), (*uppers, *lowers)), CRM)
    wrench = wrench_of(load * rng.uniform(0.8, 1.2, 2 * arms), of)
    law = ExactLaw(of)
    assert np.abs(wrench_of(law.speeds(wrench), of) - wrench).max() < 1e-6
    assert law.certificate.steps > 0


def test_wrong_options_and_demands_are_named():
    for options, says in (
        ({"low": 0.5, "high": 0.4}, "bounds"),
        ({"failed": [9]}, "rotor 9"),
        ({"priority": ("roll", "pitch")}, "priority"),
    ):
        with pytest.raises(InputError, match=says):
            ExactLaw(X8, **options)
    with pytest.raises(InputError, match="finite rows"):
        ExactLaw(X8).many([[1.0, 2.0, np.nan, 0.0]])
