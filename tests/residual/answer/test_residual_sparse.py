"""Logs that tell little: coarse sensors, commands at 10 Hz, saturation. A clean flight says nothing, and what
is there is still named.

Flown by `sim`'s stand-ins in this process; none of its code is under test.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.data import read_flight_log
from coaxlink.residual import refine
from coaxlink.residual.result import Refinement
from coaxlink.rotor import load_rotor_model
from sim import flights
from sim.physics.sensors import Sensors
from sim.px4.autopilot import Mode
from sim.px4.cascade import Goal
from sim.recorder import RATES, TlogPort
from sim.world import World, build

AIRFRAME = files.example("x8_demo.toml")
RATE = 250  # steps of the stand-in a second
Goals = Callable[[float], Goal]


def dashes(t: float) -> Goal:
    """28 m to and fro in 5 s each, with turns: 14 m/s, motors at their limits for half the time."""
    there, s = int(t / 5.0) % 2 == 0, (t % 5.0) / 5.0
    ease, slope = s**3 * (10 - 15 * s + 6 * s * s), 30 * (s * (1 - s)) ** 2 / 5.0
    a, way = (0.0, 28.0) if there else (28.0, -28.0)
    east, up = 4.0 * math.sin(1.3 * t), -6.0 - 2.0 * math.sin(0.9 * t)
    speed = (way * slope, 5.2 * math.cos(1.3 * t), -1.8 * math.cos(0.9 * t))
    return Goal((a + way * ease, east, up), speed, yaw=1.6 if t % 6.0 < 3.0 else -1.6)


def corners(t: float) -> Goal:
    """Steps of position and heading: tilted by up to 70 degrees."""
    place, yaw = [((0, 0, -3), 0.0), ((8, 0, -5), 1.5), ((8, 8, -3), -1.5), ((0, 8, -6), 3.0)][
        int(t / 3.5) % 4
    ]
    return Goal(tuple(map(float, place)), (0.0, 0.0, 0.0), yaw=yaw)  # type: ignore[arg-type]


def asked(log: Path) -> Refinement:
    model = load_rotor_model(files.example("rotor_paper.toml"))
    return refine(read_flight_log(log), load_airframe(AIRFRAME), model)


def silent(log: Path) -> bool:
    answer = asked(log)
    return not (answer.effects or answer.ambiguous or answer.unexplained or answer.suspect_data)


def csv_flight(plan: str, goals: Goals | None = None, seed: int = 0) -> dict[str, np.ndarray]:
    if goals is not None:
        flights.PLANS[plan] = goals, 60.0
    log = flights.fly(build(World(AIRFRAME, None, "px4", None, seed=seed), []).autopilot, plan)
    return {name: values for name, values in log.items() if not name.startswith("rpm")}


def tlog_flight(
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
    goals: Goals,
    *,
    firmware: str,
    hz: int,
    seed: int,
    **world: object,
) -> float:
    """A telemetry log with outputs at `hz`, an ArduPilot's sensors without noise. The top speed, m/s."""
    monkeypatch.setitem(RATES, 36, hz)
    standin = build(World(AIRFRAME, None, firmware, seed=seed, **world), [], 0.0)  # type: ignore[arg-type]
    a = standin.autopilot
    if firmware == "ardupilot":
        low = replace(a.sensors.noise, accel_m_s2=0.001, gyro_rad_s=2e-5)
        a.sensors = Sensors(a.plant, seed, low)
    standin.ports.append(TlogPort(a, log))
    top = 0.0

    def run(seconds: float, follow: bool = False) -> None:
        nonlocal top
        start = a.plant.time_s
        for _ in range(round(seconds * RATE)):
            if follow:
                a.offboard(goals(a.plant.time_s - start))
            standin.tick()
            top = max(top, float(np.linalg.norm(a.plant.velocity)))

    run(2.0)
    if firmware == "ardupilot":
        a.set_ap_mode(4)
    a.arm()
    a.take_off(3.0)
    run(8.0)
    a.offboard(goals(0.0))
    if firmware == "px4":
        a.set_mode(Mode.OFFBOARD)
    run(52.0, follow=True)
    standin.ports[-1].close()
    return top


def test_a_weak_rotor_shows_through_steps_of_a_milliradian(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, log = tmp_path / "truth.toml", tmp_path / "a.tlog"
    truth.write_text('[[effects]]\nname = "degraded_rotor"\nrotor = 3\nsize = 0.06\n')
    tlog_flight(log, monkeypatch, flights.paper, firmware="ardupilot", hz=50, seed=0, truth=truth)
    samples = read_flight_log(log)
    assert samples.resolution["gyro_x_rad_s"] == pytest.approx(1e-3)
    assert samples.resolution["accel_z_m_s2"] == pytest.approx(9.80665e-3)
    assert samples.has("rpm1", "rpm8")  # ESC_TELEMETRY
    answer = asked(log)
    assert answer.suspect_data == ()
    (effect,) = answer.effects
    told = {p.name: p.value for p in effect.parameters}
    assert effect.name == "degraded_rotor" and told["rotor"] == 3
    assert told["thrust_loss"] == pytest.approx(0.06, abs=0.004)


def test_a_clean_harsh_flight_with_outputs_at_10_hz_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "a.tlog"
    top = tlog_flight(log, monkeypatch, dashes, firmware="px4", hz=10, seed=5)
    assert top > 10.7
    assert silent(log)


def test_commands_held_between_rows_of_a_table_are_no_corners(tmp_path: Path) -> None:
    """125 Hz rows, commands of every twelfth: unheld, this clean flight said rotor inertia and inflow."""
    columns = csv_flight("vigorous")
    rows = np.arange(len(columns["time_s"]))
    for n in range(1, 9):
        columns[f"motor{n}"] = columns[f"motor{n}"][rows // 12 * 12]
    log = tmp_path / "held.csv"
    flights.write_flight(log, columns)
    assert silent(log)


def test_rows_at_10_hz_of_a_harsh_clean_flight_say_nothing(tmp_path: Path) -> None:
    columns = csv_flight("corners", corners, seed=6)
    air = columns["height_m"] > 0.5
    motors = np.stack([columns[f"motor{n}"][air] for n in range(1, 9)])
    assert (motors > 0.999).any(axis=0).mean() > 0.2  # saturated for a good part of it
    log = tmp_path / "slow.csv"
    flights.write_flight(log, {name: values[::12] for name, values in columns.items()})
    assert silent(log)


def test_a_clean_flight_at_the_motors_limits_says_nothing(tmp_path: Path) -> None:
    log = tmp_path / "harsh.csv"
    flights.write_flight(log, {n: v[::5] for n, v in csv_flight("dashes", dashes).items()})
    assert silent(log)


def test_steps_at_10_hz_are_not_told_from_what_moves_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "a.tlog"
    tlog_flight(log, monkeypatch, corners, firmware="px4", hz=10, seed=5)
    assert silent(log)
