"""Effects compensated live: what the true rotors make of the compensated commands is the demand."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from live_line import CRM, X8
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.live.effects import LiveEffects
from coaxlink.live.mixer_core import MixCore
from coaxlink.mavlink.telemetry import Telemetry
from coaxlink.rotor.model import EffectEntry
from coaxlink.vehicle import Conditions, Vehicle

DEMAND = [0.02, -0.03, 0.04, 0.32, 0, 0, 0, 0]


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def compensated(*effects: EffectEntry) -> tuple[MixCore, Telemetry, Clock, LiveEffects]:
    clock = Clock()
    model = dataclasses.replace(CRM, effects=effects)
    telemetry = Telemetry(clock)
    vehicle = Vehicle(X8, model, measured_live=True)
    live = LiveEffects(None, vehicle, telemetry)
    return MixCore(vehicle, "exact", live), telemetry, clock, live


def settled(core: MixCore, steps: int = 12) -> np.ndarray[Any, Any]:
    out = None
    for _ in range(steps):
        out = core.step((core.last_us or 0) + 4000, 0, DEMAND)
    assert out is not None
    return np.array(out)


def battery(volts: float) -> Any:
    cell = round(1000 * volts / 8)
    return mavlink.MAVLink_battery_status_message(0, 0, 1, 0x7FFF, [cell] * 8 + [0xFFFF] * 2, 0, 0, -1, 50)


def test_commands_make_up_for_a_sagging_battery() -> None:
    parameters = {"speed_exponent": 0.4, "reference_voltage_V": 33.6}
    core, telemetry, _, _ = compensated(EffectEntry("battery_voltage", parameters, ("voltage_V",)))
    telemetry.hear(battery(29.6))
    u = settled(core) * (29.6 / 33.6) ** 0.4  # what the rotors turn at
    assert X8.wrench(*X8.loads(CRM, u)) == pytest.approx(core.wrench, abs=1e-4)
    plain = MixCore(Vehicle(X8, CRM), "exact")
    short = X8.wrench(*X8.loads(CRM, settled(plain) * (29.6 / 33.6) ** 0.4))
    assert short[0] < 0.95 * plain.wrench[0]  # the test would see nothing done


def test_a_voltage_that_cannot_be_is_not_followed_and_a_silent_one_is_held() -> None:
    parameters = {"speed_exponent": 1.0, "reference_voltage_V": 33.6}
    core, telemetry, clock, live = compensated(EffectEntry("battery_voltage", parameters))
    assert live.factor == 1.0  # nothing heard yet
    telemetry.hear(battery(32.0))
    settled(core)
    held = live.factor
    assert held == pytest.approx(32.0 / 33.6, abs=1e-3)
    clock.now += 60.0
    settled(core)
    assert live.factor == held
    telemetry.hear(battery(3.0))
    settled(core)
    assert live.factor == 0.75
    assert all(0.0 <= u <= 1.0 for u in settled(core))


@pytest.mark.parametrize("height", [0.1, 0.6])
def test_the_ground_pushes_and_is_allowed_for(height: float) -> None:
    gain, scale = 0.2, 0.8
    core, telemetry, _, _ = compensated(
        EffectEntry("ground_effect", {"gain_at_ground": gain, "height_scale_m": scale})
    )
    cm = round(100 * height)
    telemetry.hear(mavlink.MAVLink_distance_sensor_message(0, 5, 4000, cm, 0, 0, 25, 1))
    thrust, torque = X8.loads(CRM, settled(core, 30))
    above = np.maximum([height - r.position_m[2] for r in X8.rotors], 0.08)  # each disc's own
    thrust = thrust * (1.0 + gain * np.exp(-above / scale))
    assert X8.wrench(thrust, torque) == pytest.approx(core.wrench, abs=0.02)


def test_a_shifted_centre_of_mass_and_a_weak_rotor_are_allowed_for() -> None:
    x, y, loss = 0.02, -0.01, 0.2
    core, _, _, _ = compensated(
        EffectEntry("cg_offset", {"offset_x_m": x, "offset_y_m": y}),
        EffectEntry("degraded_rotor", {"rotor": 3.0, "thrust_loss": loss, "torque_loss": 0.5 * loss}),
    )
    thrust, torque = X8.loads(CRM, settled(core, 40))
    got = X8.wrench(thrust, torque)
    weak, weak_torque = thrust.copy(), torque.copy()
    weak[2], weak_torque[2] = thrust[2] * (1 - loss), torque[2] * (1 - 0.5 * loss)
    # about the true centre of mass: M - r x F
    body = X8.wrench(weak, weak_torque)
    lever = -np.cross([x, y, 0.0], [0.0, 0.0, -got[0]])
    assert body + np.array([0.0, lever[0], lever[1], 0.0]) == pytest.approx(core.wrench, abs=0.02)


def test_climbing_air_is_allowed_for() -> None:
    core, telemetry, _, _ = compensated(EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": 2.0}))
    telemetry.hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, -1.5))
    telemetry.hear(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
    u = settled(core, 30)
    thrust, torque = X8.loads(CRM, u)
    assert X8.wrench(thrust - 2.0 * u * 1.5, torque) == pytest.approx(core.wrench, abs=0.02)


def test_a_turning_vehicle_in_any_attitude_meets_the_air_at_every_hub() -> None:
    c = 1.3
    core, telemetry, _, _ = compensated(EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": c}))
    roll, pitch, yaw, rates, v = 0.2, -0.3, 2.0, (0.5, -0.8, 0.3), np.array([2.0, -1.0, 0.7])
    telemetry.hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, *v))
    telemetry.hear(mavlink.MAVLink_attitude_message(0, roll, pitch, yaw, *rates))
    u = settled(core, 40)
    # the body's z axis in NED, for yaw, pitch, roll in turn
    z = np.array([
        math.cos(roll) * math.sin(pitch) * math.cos(yaw) + math.sin(roll) * math.sin(yaw),
        math.cos(roll) * math.sin(pitch) * math.sin(yaw) - math.sin(roll) * math.cos(yaw),
        math.cos(roll) * math.cos(pitch),
    ])  # fmt: skip
    climb = np.array([-(v @ z) - np.cross(rates, r.position_m)[2] for r in X8.rotors])
    thrust, torque = X8.loads(CRM, u)
    assert X8.wrench(thrust - c * u * climb, torque) == pytest.approx(core.wrench, abs=0.02)
    blind = X8.wrench(*X8.loads(CRM, settled(MixCore(Vehicle(X8, CRM), "exact"))))
    assert np.abs(X8.wrench(thrust, torque) - blind)[1:3].max() > 0.05  # the turning counts


def test_what_acts_later_is_taken_as_it_will_be_then() -> None:
    """A vehicle that gathers speed downwards and turns ever faster: 60 ms later, not now."""
    lag, age = 0.05, 0.01
    model = dataclasses.replace(CRM, effects=(EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": 2.0}),))
    clock = Clock()
    telemetry = Telemetry(clock)
    vehicle = Vehicle(dataclasses.replace(X8, motor_lag_s=lag), model, measured_live=True)
    core = MixCore(vehicle, "exact", LiveEffects(None, vehicle, telemetry))
    telemetry.hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 1.0))
    telemetry.hear(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0.4, 0, 0))
    clock.now += age
    u = settled(core, 60)
    thrust, torque = X8.loads(CRM, u)
    force = core.wrench
    down = 1.0 + (lag + age) * (9.80665 - force[0] / X8.mass_kg)
    turn = np.array([0.4, 0.0, 0.0]) + (lag + age) * np.array(force[1:]) / X8.inertia_kg_m2
    climb = np.array([-down - np.cross(turn, r.position_m)[2] for r in X8.rotors])
    assert X8.wrench(thrust - 2.0 * u * climb, torque) == pytest.approx(force, abs=0.02)
    now = np.array([-1.0 - np.cross([0.4, 0.0, 0.0], r.position_m)[2] for r in X8.rotors])
    assert np.abs(X8.wrench(thrust - 2.0 * u * now, torque) - force).max() > 0.1


AIR = EffectEntry("air_density", {"density_exponent": 1.0, "reference_density_kg_m3": 1.225})


def imu(hectopascal: float) -> Any:
    return mavlink.MAVLink_highres_imu_message(
        0, 0, 0, 0, 0, 0, 0, 0, 0, 0, hectopascal, 0, 0, 25.0, 0x1FFF, 0
    )


def test_thin_air_is_flown_faster_through() -> None:
    clock = Clock()
    telemetry = Telemetry(clock)
    model = dataclasses.replace(CRM, effects=(AIR,))
    vehicle = Vehicle(X8, model, measured_live=True)
    core = MixCore(vehicle, "exact", LiveEffects(None, vehicle, telemetry, air_temperature_C=5.0))
    telemetry.hear(imu(880.0))
    share = 88000.0 / (287.05 * 278.15) / 1.225
    thrust, torque = X8.loads(CRM, settled(core, 40))
    assert X8.wrench(share * thrust, share * torque) == pytest.approx(core.wrench, abs=0.02)
    assert share < 0.93


def test_air_that_cannot_be_or_whose_temperature_nobody_knows_changes_nothing() -> None:
    plain = settled(MixCore(Vehicle(X8, CRM), "exact"))
    core, telemetry, _, live = compensated(AIR)
    telemetry.hear(imu(880.0))  # the barometer's own 25 C are its board's
    assert settled(core) == pytest.approx(plain, abs=1e-9)
    telemetry.hear(mavlink.MAVLink_hygrometer_sensor_message(0, 500, 4000))
    assert settled(core, 30).mean() > plain.mean() + 0.01
    for broken in (0.0, 12.0, 1e9, math.nan):
        telemetry.hear(imu(broken))
        if not math.isnan(broken):  # which is not taken: the last good one stands
            assert settled(core) == pytest.approx(plain, abs=1e-9)
    bare = dataclasses.replace(CRM, effects=(EffectEntry("air_density", {"density_exponent": 1.0}),))
    unknown = LiveEffects(None, Vehicle(X8, bare, measured_live=True))
    assert "at which density" in unknown.left_out["air_density"] and not unknown.names
    assert live.names == ["air_density"]


def test_an_effect_without_its_numbers_is_left_out_by_name() -> None:
    for name in ("battery_voltage", "axial_inflow", "cg_offset", "degraded_rotor"):
        bare = dataclasses.replace(CRM, effects=(EffectEntry(name, {}),))
        live = LiveEffects(None, Vehicle(X8, bare, measured_live=True))
        assert "is missing" in live.left_out[name] and name in live.left_out[name] and not live.names


def test_without_telemetry_nothing_is_allowed_for_and_what_cannot_be_is_said() -> None:
    core, _, _, live = compensated(
        EffectEntry("ground_effect", {"gain_at_ground": 0.2, "height_scale_m": 0.8}),
        EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": 2.0}),
        EffectEntry("rotor_drag", {"drag_N_s_m": 1.0}),
        EffectEntry("martian_dust", {}),
    )
    plain = MixCore(Vehicle(X8, CRM), "exact")
    assert settled(core) == pytest.approx(settled(plain), abs=1e-9)
    assert set(live.left_out) == {"rotor_drag", "martian_dust"}
    assert live.names == ["ground_effect", "axial_inflow"]


def test_nonsense_in_telemetry_is_not_used() -> None:
    core, telemetry, _, _ = compensated(EffectEntry("axial_inflow", {"thrust_per_climb_N_s_m": 2.0}))
    telemetry.hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, math.nan))
    telemetry.hear(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
    assert np.isfinite(settled(core)).all()
    telemetry.hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, -1e30))
    assert all(0.0 <= u <= 1.0 for u in settled(core))


def test_what_the_module_makes_of_speeds_is_made_once() -> None:
    battery = EffectEntry("battery_voltage", {"speed_exponent": 0.4, "reference_voltage_V": 33.6})
    sagged = Vehicle(X8, dataclasses.replace(CRM, effects=(battery,)), Conditions(voltage_V=29.6))
    direct, through = MixCore(sagged, "exact"), MixCore(sagged, "exact")
    through.board_turns = True
    asked, commands = settled(through), settled(direct)
    assert asked * (33.6 / 29.6) ** 0.4 == pytest.approx(
        commands, rel=1e-6
    )  # by the module, before its drive
