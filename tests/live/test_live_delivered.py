"""Live exact mixing in flight: what the world's rotors deliver is what the autopilot asked for.

research/live_delivered.py flies the paper's whole hover and circle; here a part of it.
"""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest
from live_flight import EXAMPLES, TICK_S, Companion, Flight

from coaxlink.airframe import load_airframe
from coaxlink.live.guard import Timing
from coaxlink.live.mixer import LiveMixer
from coaxlink.mixer import make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.px4.autopilot import Mode
from sim.px4.cascade import Goal

STANDARD_N = 85.7  # lone rotor of eq. 17 as squares, N per u^2: what the reference table's setpoint means


@pytest.mark.parametrize(
    ("airframe", "lead_s"),
    [
        ("x8_paper.toml", (0.0, 0.0)),  # motors without lag: a moving demand is delivered at once
        ("x8_demo.toml", (0.02, 0.0)),  # 20 ms, led
    ],
)
def test_desired_and_delivered_agree_to_a_tenth_of_a_newton(
    airframe: str, lead_s: tuple[float, float]
) -> None:
    flight = Flight(airframe=airframe)
    a = flight.autopilot
    vehicle = a.plant.vehicle
    frame = load_airframe(EXAMPLES / airframe)
    model = load_rotor_model(EXAMPLES / "rotor_paper.toml")
    companion = Companion(flight)
    patient = Timing(hold_after_s=1.0, ramp_after_s=2.0)
    law = make_law("exact", Vehicle(frame, model))
    live = LiveMixer(companion.session, Vehicle(frame, model), law, timing=patient, lead_s=lead_s)
    starting = threading.Thread(target=live.start)
    starting.start()
    flight.fly(3.0, until=lambda: not starting.is_alive())
    flight.fly(2.0, until=lambda: live.state == "live")
    flight.standin.speed = 0.0  # the world waits for each answer
    flight.rush(4.0)
    errors, thrusts = [], []
    for k in range(round(4.0 / TICK_S)):
        t = k * TICK_S
        angle, rate = 0.25 * t * t, 0.5 * t  # a circle of 2 m, faster and faster
        position = (2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle), -4.0)
        speed = (2.0 * rate * math.cos(angle), 2.0 * rate * math.sin(angle), 0.0)
        a.offboard(Goal(position, speed))
        if k == 0:
            a.set_mode(Mode.OFFBOARD)
        flight.rush(TICK_S)
        force = a.plant.thrust[:, None] * vehicle.axis
        moment = np.cross(vehicle.position_m, force) - (vehicle.spin * a.plant.torque)[:, None] * vehicle.axis
        got = np.concatenate([[-force[:, 2].sum()], moment.sum(axis=0)])
        d = a.demand
        thrusts.append((got[0], d.thrust))
        errors.append(got - live.core.scale.wrench((d.roll, d.pitch, d.yaw, d.thrust)))
    assert live.error is None
    live.session.tap = None
    companion.close()
    flight.close()
    error = np.abs(errors).mean(axis=0)
    assert error[0] < 0.1
    assert max(error[1:]) < 0.012  # outputs in steps of 1/1000 alone make 0.0088, and less through a lag
    smooth = np.abs(np.array(errors).reshape(-1, 50, 4).mean(axis=1)).mean(axis=0)  # over 0.2 s
    assert smooth[0] < 0.1
    assert max(smooth[1:]) < 0.01
    # the scale itself, by hand: a thrust setpoint s on each of eight rotors
    got_N, setpoint = np.array(thrusts).T
    assert abs(np.median(got_N / setpoint) / (8 * STANDARD_N) - 1.0) < 0.03
