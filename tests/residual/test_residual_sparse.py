"""Logs that tell little: coarse sensors, commands at 10 Hz, saturation. A clean flight says nothing, and what
is there is still named.

Flown by `sim`'s stand-ins in this process; none of its code is under test.
"""

from __future__ import annotations

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
from sim.simulation import Simulation, build

AIRFRAME = files.example("x8_demo.toml")
RATE = 250  # steps of the stand-in a second
Goals = Callable[[float], Goal]


def asked(log: Path) -> Refinement:
    model = load_rotor_model(files.example("rotor_paper.toml"))
    return refine(read_flight_log(log), load_airframe(AIRFRAME), model)


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
    standin = build(Simulation(AIRFRAME, None, firmware, seed=seed, **world), [], 0.0)  # type: ignore[arg-type]
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


@pytest.mark.slow
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
    (weak,) = answer.effects
    reported = {p.name: p.value for p in weak.parameters}
    assert weak.name == "degraded_rotor" and reported["rotor"] == 3.0
    assert reported["thrust_loss"] == pytest.approx(0.06, abs=0.005)
