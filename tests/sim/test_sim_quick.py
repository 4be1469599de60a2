"""Batch flights are the stand-in's own flights: same loops, mix, sensors, gusts and effects."""

from __future__ import annotations

import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table

from firmware_params import px4
from sim.effects import HiddenEffect
from sim.errors import SimulationError
from sim.flights import row
from sim.physics.compile_cache import folder
from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.px4.autopilot import Autopilot, Mode
from sim.px4.cascade import Goal
from sim.px4.store import Px4Store
from sim.px4.tuning import tuned_settings
from sim.quick import mix
from sim.quick.flight import FlightWorld, fly_quick, make_design
from sim.quick.plans import PLANS
from sim.truth import Truth
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


EFFECTS = {
    "gusts": (HiddenEffect("wind", 5.0, 0.0, {"gust_m_s": 2.0, "direction_deg": 40.0}, "dryden"),),
    "a rotor weakens in flight, readings come late": (
        HiddenEffect("degraded_rotor", 0.25, 4.0, {"rotor": 6.0}),
        HiddenEffect("sensor_delay", 0.012),
        HiddenEffect("vibration", 3.0),
    ),
}


@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS.keys())
def test_a_batch_flight_is_the_stand_ins_flight(design, effects) -> None:
    _, log = fly_quick(design, FlightWorld(effects, 4, "wander", 6.0, 2.0, rate_hz=250), log_every=10)
    a = Autopilot(Plant(read_vehicle(AIRFRAME), read_pair(ROTOR)), Truth(effects, gust_seed=4), seed=4)
    a.store.recall(TABLE)
    settings = tuned_settings(a)
    a.store.recall(settings)
    a.cascade.hover = settings["MPC_THR_HOVER"]
    goals = PLANS["wander"](np.arange(2000) / 250 - 2.0, 4).tolist()
    k, p = a.plant.index, a.plant
    p.state[k.POS : k.POS + 3] = goals[0][:3]
    p.state[k.SPEED : k.SPEED + 16] = np.tile(a.mixer.command(0.0, 0.0, 0.0, a.cascade.hover), 2)
    p.swap_battery(0.95)
    a.armed, a.landed, rows = True, False, []
    for n, g in enumerate(goals):
        a.offboard(Goal(tuple(g[0:3]), tuple(g[3:6]), tuple(g[6:9]), *g[9:]))
        if n == 0:
            a.set_mode(Mode.OFFBOARD)
        a.step()
        if n % 10 == 0:
            rows.append(row(a))
    # the last digit is rounded otherwise, which a PWM step now and then makes 1e-3 of full speed of
    for name, stood in zip(log, np.array(rows).T, strict=True):
        scale = max(float(np.abs(stood).max()), 0.1)
        assert log[name] == pytest.approx(stood, abs=5e-3 * scale), name


@pytest.mark.slow
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
    store = Px4Store((1, 16, 1), read_vehicle(AIRFRAME))
    store.recall(TABLE)
    return store.values()


def test_the_same_world_gives_the_same_flight_and_log(design) -> None:
    world = FlightWorld((HiddenEffect("wind", 5.0, 0.0, {"gust_m_s": 2.0}),), 9, "steps", 4.0, 2.0)
    first, log = fly_quick(design, world, log_every=4)
    again, same = fly_quick(design, world, log_every=4)
    other, _ = fly_quick(design, FlightWorld(world.effects, 10, "steps", 4.0, 2.0))
    assert first == again and first != other
    assert list(log)[:3] == ["time_s", "motor1", "motor2"] and len(log["time_s"]) == 600
    assert np.allclose(np.diff(log["time_s"]), 0.01, atol=1e-9)  # 400 Hz, every fourth
    assert all(np.array_equal(log[name], same[name]) for name in log)


def test_rows_of_every_phase_show_the_same_commands(design) -> None:
    """Loops that take unequal turns for equal ones drum: every second row would show more torque than its
    neighbours, by as much as the vehicle turns."""
    _, log = fly_quick(design, FlightWorld((), 3, "wander", 20.0, 2.0), log_every=1)
    assert np.ptp(np.diff(log["time_s"])) < 1e-9
    front = read_vehicle(AIRFRAME).position_m[:, 0]
    pitch = np.stack([log[f"motor{n}"] for n in range(1, len(front) + 1)], axis=1) @ front
    size = len(pitch) // 80 * 80
    slow = pitch[:size].reshape(-1, 20, 4).mean(axis=1)  # 0.2 s of each phase
    slow -= slow.mean(axis=0)
    slopes = [np.polyfit(slow.mean(axis=1), phase, 1)[0] for phase in slow.T]
    assert np.allclose(slopes, 1.0, atol=0.03)


def test_a_vehicle_that_falls_says_so_and_ends(design) -> None:
    world = FlightWorld(
        (HiddenEffect("degraded_rotor", 1.0, 5.0, {"rotor": 2.0}), HiddenEffect("mass_change", 12.0)),
        1,
        "hover",
        20.0,
    )
    flown, _ = fly_quick(design, world)
    assert flown.failsafe in ("attitude", "ground")
    assert 0.0 < flown.seconds < 20.0 and math.isfinite(flown.height_max_m)


def test_what_these_flights_cannot_hold_is_refused(design) -> None:
    with pytest.raises(SimulationError, match="battery_swap"):
        fly_quick(design, FlightWorld((HiddenEffect("battery_swap", 0.9),)))
    with pytest.raises(SimulationError, match="hover, circle, wander, steps"):
        fly_quick(design, FlightWorld(plan="loop"))


def test_a_plans_speed_is_the_slope_of_its_place() -> None:
    with case_table() as case:
        for plan in sorted(PLANS):
            with case(f"{plan}"):
                t = np.linspace(0.0, 20.0, 20_001)
                goals = PLANS[plan](t, 3)
                if plan == "steps":
                    assert not goals[:, 3:9].any()
                    continue
                assert np.allclose(np.gradient(goals[:, :3], t, axis=0), goals[:, 3:6], atol=2e-3)
                assert np.allclose(np.gradient(goals[:, 3:6], t, axis=0), goals[:, 6:9], atol=2e-2)


def test_compiled_code_calls_no_function_of_its_own_that_another_has_too(design) -> None:
    """Of two copies a process runs the first that it has: who compiled and who loaded rounded otherwise."""
    fly_quick(design, FlightWorld((), 1, "hover", 0.1, 0.0))
    (kept, *_) = sorted(folder().rglob("kernel.fly-*.nbc"), key=lambda p: -p.stat().st_mtime)

    def objects(value) -> list[bytes]:
        if isinstance(value, tuple | list):
            return [found for part in value for found in objects(part)]
        return [value] if isinstance(value, bytes) and value.startswith(b"\x7fELF") else []

    (code,) = objects(pickle.loads(kept.read_bytes()))
    names = {name.split(b"B", 1)[0] for name in re.findall(rb"_ZN3sim\w+", code)}
    assert names == {b"_ZN3sim5quick6kernel3fly"}
