"""The companion's own attitude loop: signs by hand, nonsense refused, and a flight on it."""

from __future__ import annotations

import math
import threading
from pathlib import Path

import numpy as np
import pytest
from live_flight import EXAMPLES, Companion, Flight, real_time

from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError
from coaxlink.live.attitude_loop import AttitudeLoop, LoopGains, load_gains
from coaxlink.live.mixer import DemandScale, LiveMixer
from coaxlink.mixer import standard_coefficients
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)


def turned(axis: int, angle: float) -> list[float]:
    q = [math.cos(angle / 2), 0.0, 0.0, 0.0]
    q[1 + axis] = math.sin(angle / 2)
    return q


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_torque_turns_towards_the_setpoint_and_against_the_rate(axis: int, flip: float) -> None:
    gains = LoopGains(integral_rad_s2=(0.0, 0.0, 0.0))
    loop = AttitudeLoop((0.9, 1.0, 1.6), gains)
    loop.aim(0, [flip * q for q in turned(axis, 0.1)], STILL, 0.4)  # q and -q are one attitude
    torque = loop.torque(0, LEVEL, STILL)
    assert torque is not None
    by_hand = (0.9, 1.0, 1.6)[axis] * gains.rate_rad_s[axis] * gains.attitude_rad_s[axis] * 2 * math.sin(0.05)
    assert torque[axis] == pytest.approx(by_hand)
    assert [t for k, t in enumerate(torque) if k != axis] == pytest.approx([0.0, 0.0])
    loop.aim(0, LEVEL, STILL, 0.4)
    rate = [0.0, 0.0, 0.0]
    rate[axis] = 0.5
    damped = loop.torque(0, LEVEL, rate)
    assert damped is not None
    assert damped[axis] == pytest.approx(-0.5 * (0.9, 1.0, 1.6)[axis] * gains.rate_rad_s[axis])


def test_without_a_fresh_setpoint_or_with_a_state_that_is_none_there_is_no_torque() -> None:
    loop = AttitudeLoop((1.0, 1.0, 1.0))
    assert loop.torque(0, LEVEL, STILL) is None
    loop.aim(0, [math.nan] * 4, STILL, 0.4)
    loop.aim(0, [0.0] * 4, STILL, 0.4)
    loop.aim(0, LEVEL, (math.inf, 0.0, 0.0), 0.4)
    assert loop.torque(0, LEVEL, STILL) is None
    loop.aim(0, LEVEL, STILL, 0.4)
    assert loop.torque(100_000, LEVEL, STILL) is not None
    assert loop.torque(100_000, [math.nan] * 4, STILL) is None
    assert loop.torque(100_000, LEVEL, (math.nan, 0.0, 0.0)) is None
    assert loop.torque(300_000, LEVEL, STILL) is None


def test_a_torque_in_newton_metres_comes_back_through_the_scale() -> None:
    scale = DemandScale(X8, standard_coefficients(CRM))
    controls = scale.controls(0.3, (1.0, -2.0, 0.5))
    assert scale.wrench(controls)[1:] == pytest.approx([1.0, -2.0, 0.5])
    assert scale.controls(0.3, (1e9, 0.0, 0.0))[0] == 1.0


def test_gains_come_from_the_airframe_file(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("[attitude_loop]\nrate_rad_s = [10, 11, 4.5]\n")
    assert load_gains(path) == LoopGains(rate_rad_s=(10.0, 11.0, 4.5))
    for bad in ("rate_rad_s = [1, 2]", "rate_rad_s = [1, 2, nan]", "gain = 3", "rate_rad_s = [-1, 2, 3]"):
        path.write_text(f"[attitude_loop]\n{bad}\n")
        with pytest.raises(InputError, match="attitude_loop"):
            load_gains(path)


@real_time
def test_the_companion_flies_the_vehicle_on_its_own_loop() -> None:
    flight = Flight()
    companion = Companion(flight)
    live = LiveMixer(
        companion.session, Vehicle(X8, CRM), "exact", own_curve=1.0,
        loop=AttitudeLoop(X8.inertia_kg_m2),
    )  # fmt: skip
    starting = threading.Thread(target=live.start)
    starting.start()
    flight.fly(3.0, until=lambda: not starting.is_alive())
    flight.fly(3.0, until=lambda: live.state == "live")
    flight.standin.speed = 0.0
    flight.rows.clear()
    flight.autopilot.go_to((2.0, 1.0, -5.0), 0.4)
    flight.fly(5.0)
    position = flight.autopilot.plant.position.copy()
    w, _, _, z = flight.autopilot.plant.quaternion.tolist()
    driven = np.mean([row[1] for row in flight.rows])
    live.session.tap = None
    companion.close()
    flight.close()
    assert live.error is None
    assert driven > 0.9
    assert position == pytest.approx([2.0, 1.0, -5.0], abs=0.4)
    assert 2 * math.atan2(z, w) == pytest.approx(0.4, abs=0.1)
    assert flight.outputs_are_sound()
    assert flight.steepest_deg < 25.0
