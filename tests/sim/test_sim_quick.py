"""Quick flights are the stand-in's own flights: same loops, mix, sensors, gusts and effects, compiled."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from firmware_params import px4
from sim.effects import Effect
from sim.errors import WorldError
from sim.physics.rotors import read_pair
from sim.px4.cascade import Goal
from sim.quick import mix
from sim.quick.flight import World, fly_quick, make_design
from sim.quick.plans import PLANS
from sim.trial_flight import SETTLE_S, fly_trial
from sim.trials import Trial
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
AIRFRAME, ROTOR = EXAMPLES / "x8_demo.toml", EXAMPLES / "rotor_paper.toml"
TABLE = {
    f"CA_ROTOR{n}_{key}": value
    for n in range(8)
    for key, value in (("CT", 60.0 if n < 4 else 40.0), ("KM", 0.03 if n in (0, 2, 4, 6) else -0.03))
} | {"THR_MDL_FAC": 0.8}


@pytest.fixture(scope="module")
def design():
    return make_design(read_vehicle(AIRFRAME), read_pair(ROTOR), TABLE)


def _goal(plan: str, seed: int):
    def at(t: float, _draw: object) -> Goal:
        row = PLANS[plan](np.array([t]), seed)[0].tolist()
        return Goal(tuple(row[0:3]), tuple(row[3:6]), tuple(row[6:9]), *row[9:])

    return at


@pytest.mark.parametrize(
    "effects",
    [
        (Effect("wind", 5.0, 0.0, {"gust_m_s": 2.0, "direction_deg": 40.0}, "dryden"),),
        (
            Effect("degraded_rotor", 0.25, 11.0, {"rotor": 6.0}),
            Effect("sensor_delay", 0.012),
            Effect("vibration", 3.0),
        ),
    ],
    ids=["gusts", "a rotor weakens in flight, readings come late"],
)
def test_a_quick_flight_is_the_stand_ins_flight(design, effects) -> None:
    trial = Trial("", _goal("wander", 4), lambda draw, settled: effects, seconds=7.0)
    slow = fly_trial(trial, AIRFRAME, TABLE, seed=4)
    quick, _ = fly_quick(design, World(effects, 4, "wander", 7.0, SETTLE_S, rate_hz=250))
    for name in (
        "height_max_m",
        "height_rms_m",
        "level_rms_m",
        "tilt_rms_deg",
        "yaw_rms_deg",
        "shaft_W",
        "pack_W",
    ):
        # compiled sums are rounded otherwise, which a PWM step now and then makes 1e-3 of full speed of
        assert getattr(quick, name) == pytest.approx(getattr(slow, name), rel=2e-3, abs=1e-4), name
    off = (quick.thrust_error_N, quick.roll_error_Nm, quick.pitch_error_Nm, quick.yaw_error_Nm)
    assert np.array(off) == pytest.approx(slow.shape, rel=2e-2)


def test_the_compiled_mix_is_px4s_to_the_last_bit(design) -> None:
    from numba import njit

    run = njit(lambda c, f, r, p, y, t, sp, u: mix.px4_command(c, f, r, p, y, t, sp, u))
    made = px4.realise(_all_parameters())
    columns, sp, command = np.ascontiguousarray(made.mix.T, np.float32), np.zeros(8, np.float32), np.zeros(8)
    random = np.random.default_rng(5)
    for _ in range(400):  # most of them far into saturation
        roll, pitch, yaw = random.uniform(-1.0, 1.0, 3) ** 3
        thrust = random.uniform(0.0, 1.0)
        run(columns, made.thr_mdl_fac, roll, pitch, yaw, thrust, sp, command)
        wanted = made.throttle(made.setpoints([roll, pitch, yaw, 0.0, 0.0, -thrust]))
        assert command.tolist() == wanted.tolist()


def _all_parameters() -> dict[str, float]:
    from sim.px4.store import Store

    store = Store((1, 16, 1), read_vehicle(AIRFRAME))
    store.recall(TABLE)
    return store.values()


def test_the_same_world_gives_the_same_flight_and_log(design) -> None:
    world = World((Effect("wind", 5.0, 0.0, {"gust_m_s": 2.0}),), 9, "steps", 4.0, 2.0)
    first, log = fly_quick(design, world, log_every=4)
    again, same = fly_quick(design, world, log_every=4)
    other, _ = fly_quick(design, World(world.effects, 10, "steps", 4.0, 2.0))
    assert first == again and first != other
    assert list(log)[:3] == ["time_s", "motor1", "motor2"] and len(log["time_s"]) == 600
    assert np.allclose(np.diff(log["time_s"]), 0.01, atol=1e-9)  # 400 Hz, every fourth
    assert all(np.array_equal(log[name], same[name]) for name in log)


def test_a_vehicle_that_falls_says_so_and_ends(design) -> None:
    world = World(
        (Effect("degraded_rotor", 1.0, 5.0, {"rotor": 2.0}), Effect("mass_change", 12.0)), 1, "hover", 20.0
    )
    flown, _ = fly_quick(design, world)
    assert flown.failsafe in ("attitude", "ground")
    assert 0.0 < flown.seconds < 20.0 and math.isfinite(flown.height_max_m)


def test_what_these_flights_cannot_hold_is_refused(design) -> None:
    with pytest.raises(WorldError, match="battery_swap"):
        fly_quick(design, World((Effect("battery_swap", 0.9),)))
    with pytest.raises(WorldError, match="hover, circle, wander, steps"):
        fly_quick(design, World(plan="loop"))


@pytest.mark.parametrize("plan", sorted(PLANS))
def test_a_plans_speed_is_the_slope_of_its_place(plan: str) -> None:
    t = np.linspace(0.0, 20.0, 20_001)
    goals = PLANS[plan](t, 3)
    if plan == "steps":
        assert not goals[:, 3:9].any()
        return
    assert np.allclose(np.gradient(goals[:, :3], t, axis=0), goals[:, 3:6], atol=2e-3)
    assert np.allclose(np.gradient(goals[:, 3:6], t, axis=0), goals[:, 6:9], atol=2e-2)
