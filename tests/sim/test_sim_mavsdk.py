"""MAVSDK, which nobody here wrote, flies the stand-ins."""

import math
from collections.abc import Iterator

import pytest
from ground import mavsdk_system, until
from mavsdk.plugins.action import Action
from mavsdk.plugins.info import Info
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry
from mavsdk.system import System

from sim.testing import standin


@pytest.fixture
def vehicle(request: pytest.FixtureRequest) -> Iterator[System]:
    firmware = getattr(request, "param", "px4")
    with (
        standin("--firmware", firmware, "--speed", "4", "--seed", "7") as port,
        mavsdk_system(port) as system,
    ):
        yield system


@pytest.mark.slow
def test_mavsdk_arms_takes_off_flies_offboard_and_lands(vehicle: System) -> None:
    telemetry, action = Telemetry(vehicle), Action(vehicle)
    version = Info(vehicle).get_version()
    assert (version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch) == (1, 16, 1)
    until(telemetry.health_all_ok, "never healthy")
    assert not telemetry.armed() and not telemetry.in_air()
    action.set_takeoff_altitude(3.0)
    # a busy machine may take its time between arming and take-off
    Param(vehicle).set_param_float("COM_DISARM_PRFLT", -1.0)
    action.arm()
    until(telemetry.armed, "not armed")
    action.takeoff()
    until(lambda: telemetry.position().relative_altitude_m > 2.7, "did not climb")
    until(lambda: telemetry.flight_mode() == FlightMode.HOLD, "does not hold")
    until(lambda: telemetry.landed_state() == LandedState.IN_AIR, "not in the air")
    assert telemetry.in_air()
    assert 28.0 < telemetry.battery().voltage_v < 33.6
    assert sum(v > 1300 for v in telemetry.actuator_output_status().actuator[:8]) == 8
    attitude = telemetry.attitude_euler()
    assert math.hypot(attitude.roll_deg, attitude.pitch_deg) < 5.0

    offboard = Offboard(vehicle)
    offboard.set_position_ned(PositionNedYaw(2.0, -1.0, -4.0, 30.0))
    offboard.start()
    until(lambda: telemetry.flight_mode() == FlightMode.OFFBOARD, "not offboard")

    def arrived() -> bool:
        p = telemetry.position_velocity_ned().position
        return math.dist((p.north_m, p.east_m, p.down_m), (2.0, -1.0, -4.0)) < 0.2

    until(arrived, "did not follow the set-point")
    offboard.stop()
    action.land()
    until(lambda: not telemetry.armed(), "did not land")
    until(lambda: telemetry.landed_state() == LandedState.ON_GROUND, "not on the ground")


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", ["ardupilot"], indirect=True)
def test_mavsdk_flies_ardupilot(vehicle: System) -> None:
    telemetry, action, param = Telemetry(vehicle), Action(vehicle), Param(vehicle)
    telemetry.set_rate_position(10.0)
    everything = param.get_all_params()
    assert len(everything.int_params) + len(everything.float_params) > 400
    assert param.get_param_float("MOT_THST_EXPO") == pytest.approx(0.65)
    param.set_param_float("MOT_THST_EXPO", 0.6)
    assert param.get_param_float("MOT_THST_EXPO") == pytest.approx(0.6)
    action.set_takeoff_altitude(3.0)
    action.arm()
    until(telemetry.armed, "not armed")
    action.takeoff()
    until(lambda: telemetry.position().relative_altitude_m > 2.7, "did not climb")
    home = telemetry.home()
    north = home.latitude_deg + 4.0 / 111319.49
    action.goto_location(north, home.longitude_deg, home.absolute_altitude_m + 4.0, 0.0)

    def arrived() -> bool:
        p = telemetry.position()
        return abs(p.latitude_deg - north) * 111319.49 < 0.3 and abs(p.relative_altitude_m - 4.0) < 0.3

    until(arrived, "did not go there")
    action.land()
    until(lambda: telemetry.flight_mode() == FlightMode.LAND, "no landing")
    until(lambda: not telemetry.armed(), "did not land")
    assert telemetry.position().relative_altitude_m < 0.3
