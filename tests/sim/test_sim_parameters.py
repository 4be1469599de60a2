"""Parameters that the stand-ins give a meaning to, against the real firmwares' own statements.

Types and stock values: PX4 release/1.16 (parameters.json of its build), ArduCopter 4.7-dev of July 2025 (its
list in SITL). What a vehicle's builder sets is another value on purpose.
"""

import math
from typing import Any

import pytest
from sim_pilot import GUIDED, LAND, RTL, Pilot

from sim.ardupilot.store import ArduPilotStore
from sim.px4.autopilot import Mode
from sim.px4.store import Px4Store

LOITER, BRAKE = 5, 17
INT8, INT16, INT32, FLOAT = 2, 4, 6, 9
PX4 = {
    INT32: """
        SDLOG_PROFILE=1 SDLOG_MODE=0 NAV_DLL_ACT=0 COM_DL_LOSS_T=10 COM_MOT_TEST_EN=1 MAV_SYS_ID=1
        MPC_USE_HTE=1 MC_AIRMODE=0 CA_METHOD=2 CA_AIRFRAME=0 CA_R_REV=0 COM_OBL_RC_ACT=0
    """,
    FLOAT: """
        COM_OF_LOSS_T=1.0 COM_DISARM_LAND=2.0 COM_DISARM_PRFLT=10.0 HTE_THR_RANGE=0.2 MPC_TKO_RAMP_T=3.0
        MPC_TKO_SPEED=1.5 MPC_LAND_SPEED=0.7 MPC_LAND_ALT1=10.0 MPC_LAND_ALT2=5.0 MPC_Z_VEL_MAX_DN=1.5
        MPC_Z_VEL_MAX_UP=3.0 MPC_Z_V_AUTO_UP=3.0 MPC_Z_V_AUTO_DN=1.5 MPC_XY_CRUISE=5.0 MPC_XY_VEL_MAX=12.0
        MIS_TAKEOFF_ALT=2.5 NAV_ACC_RAD=10.0 NAV_MC_ALT_RAD=0.8 MPC_VELD_LP=5.0 MPC_TILTMAX_AIR=45.0
        MPC_THR_MIN=0.12 MPC_THR_MAX=1.0 MC_YAW_WEIGHT=0.4 MC_YAW_P=2.8 MC_ROLL_P=6.5 MC_PITCH_P=6.5
        MC_ROLLRATE_K=1.0 MC_ROLLRATE_MAX=220.0 MC_YAWRATE_MAX=200.0 MC_RR_INT_LIM=0.3 MC_ROLLRATE_FF=0.0
        IMU_GYRO_CUTOFF=40.0 IMU_DGYRO_CUTOFF=30.0 MPC_XY_P=0.95 MPC_Z_P=1.0 MPC_XY_VEL_P_ACC=1.8
        MPC_XY_VEL_I_ACC=0.4 MPC_XY_VEL_D_ACC=0.2 MPC_Z_VEL_P_ACC=4.0 MPC_Z_VEL_I_ACC=2.0
        MPC_Z_VEL_D_ACC=0.0 THR_MDL_FAC=0.0 CA_ROTOR0_CT=6.5
    """,
}
ARDUPILOT = {
    INT8: """
        FRAME_CLASS=0 FRAME_TYPE=1 FS_GCS_ENABLE=0 DISARM_DELAY=10 SCR_ENABLE=0 LOG_BACKEND_TYPE=1
        LOG_DISARMED=0
    """,
    INT16: """
        MAV_SYSID=1 MAV_GCS_SYSID=255 MAV_OPTIONS=0 MAV1_RAW_SENS=0 MAV1_EXT_STAT=0 MAV1_RC_CHAN=0
        MAV1_RAW_CTRL=0 MAV1_POSITION=0 MAV1_EXTRA1=0 MAV1_EXTRA2=0 MAV1_EXTRA3=0 LAND_SPEED=50
        LAND_ALT_LOW=1000 MOT_PWM_MIN=1000 MOT_PWM_MAX=2000 MOT_YAW_HEADROOM=200 INS_GYRO_FILTER=20
        ANGLE_MAX=3000
    """,
    INT32: """
        AUTO_OPTIONS=0 FS_OPTIONS=16 SCR_LD_CHECKSUM=-1 SCR_VM_I_COUNT=10000
    """,
    FLOAT: """
        FS_GCS_TIMEOUT=5.0 GUID_TIMEOUT=3.0 WPNAV_SPEED=1000.0 WPNAV_SPEED_UP=250.0 WPNAV_SPEED_DN=150.0
        WPNAV_RADIUS=200.0 TKOFF_SLEW_TIME=2.0 ATC_ANG_RLL_P=4.5 ATC_ANG_YAW_P=4.5 ATC_RAT_RLL_IMAX=0.5
        ATC_RAT_RLL_FLTD=20.0 PSC_POSXY_P=1.0 PSC_POSZ_P=1.0 PSC_VELXY_P=2.0 PSC_VELXY_I=1.0
        PSC_VELXY_D=0.25 PSC_VELZ_P=5.0 PSC_ACCZ_I=1.0 MOT_THST_EXPO=0.65 MOT_SPIN_MIN=0.15
        MOT_SPIN_ARM=0.1 MOT_SPIN_MAX=0.95
    """,
}
# by the vehicle's builder: no pilot to hand over to, an octaquad, a wider gyro filter and tilt
BUILT = {"COM_OBL_RC_ACT": 5, "FRAME_CLASS": 4, "INS_GYRO_FILTER": 40, "ANGLE_MAX": 4500}


@pytest.mark.parametrize(("kind", "stock"), [("px4", PX4), ("ardupilot", ARDUPILOT)])
def test_types_and_stock_values_are_the_real_ones(kind: str, stock: dict[int, str]) -> None:
    a: Any = Pilot(kind).autopilot
    vehicle = a.plant.vehicle
    store = Px4Store((1, 16, 1), vehicle) if kind == "px4" else ArduPilotStore(vehicle)
    for number, values in stock.items():
        for name, _, value in (entry.partition("=") for entry in values.split()):
            assert store.type(name) == number, name
            assert store[name] == pytest.approx(BUILT.get(name, float(value)), rel=1e-6), name


def test_px4_lands_slower_between_its_two_heights() -> None:
    a = Pilot("px4").autopilot
    speeds = [a._landing_speed(height) for height in (20.0, 10.0, 7.5, 5.0, 1.0)]
    assert speeds == pytest.approx([1.5, 1.5, 1.1, 0.7, 0.7])


@pytest.mark.slow
@pytest.mark.parametrize(("down", "speed"), [(-40.0, 3.0), (-2.0, 1.5)])
def test_px4_climbs_and_sinks_at_the_speeds_of_its_autonomous_modes(down: float, speed: float) -> None:
    px4 = Pilot("px4")
    px4.climb()
    px4.autopilot.go_to((math.nan, math.nan, -20.0), math.nan)
    px4.run(10.0)
    px4.autopilot.go_to((math.nan, math.nan, down), math.nan)
    fastest = 0.0
    for _ in range(30):
        px4.run(0.1)
        fastest = max(fastest, abs(float(px4.autopilot.plant.velocity[2])))
    assert fastest == pytest.approx(speed, rel=0.15)


FAILSAFES = [  # FS_GCS_ENABLE, FS_OPTIONS, mode, mode after (ArduCopter/events.cpp, failsafe_gcs_on_event)
    (0, 16, GUIDED, GUIDED),
    (2, 16, GUIDED, RTL),
    (3, 16, GUIDED, RTL),
    (6, 16, GUIDED, RTL),
    (7, 16, GUIDED, BRAKE),
    (99, 16, GUIDED, RTL),
    (5, 16, LOITER, LOITER),
    (5, 0, LOITER, LAND),
    (1, 8, LAND, LAND),
    (1, 0, LAND, RTL),
    (5, 2, GUIDED, LAND),
]


def test_ardupilot_misses_its_ground_station_as_its_options_say() -> None:
    wrong = []
    copter = Pilot("ardupilot")
    copter.put("FS_GCS_ENABLE", 0)
    copter.climb()
    for action, options, mode, after in FAILSAFES:
        copter.put("FS_GCS_ENABLE", action)
        copter.put("FS_OPTIONS", options)
        copter.ground_station()
        copter.run(0.1)
        copter.autopilot._enter(Mode.HOLD)
        copter.autopilot.set_ap_mode(mode)
        copter.put("FS_GCS_TIMEOUT", 0.1)
        copter.run(0.3)
        copter.put("FS_GCS_TIMEOUT", 50.0)
        if copter.autopilot.ap_mode != after:
            wrong.append((action, options, mode, after, copter.autopilot.ap_mode))
    assert not wrong


def test_ardupilot_hears_one_ground_station_only() -> None:
    for system, there in ((255, True), (245, False)):
        copter = Pilot("ardupilot")
        copter.run(6.0)
        copter.mav.srcSystem = system
        copter.ground_station()
        copter.run(0.1)
        a = copter.autopilot
        assert a.links.there(a.plant.time_s) == there


@pytest.mark.slow
def test_ardupilot_flies_at_its_waypoint_speed() -> None:
    copter = Pilot("ardupilot")
    copter.climb()
    copter.autopilot.go_to((80.0, 0.0, -3.0), math.nan)
    fastest = 0.0
    for _ in range(80):
        copter.run(0.1)
        fastest = max(fastest, float(copter.autopilot.plant.velocity[0]))
    assert fastest == pytest.approx(10.0, rel=0.1)  # WPNAV_SPEED, cm/s


def test_ardupilot_compares_23_bits_of_a_script_s_checksum() -> None:
    copter = Pilot("ardupilot")
    copter.put("SCR_ENABLE", 1)
    assert copter.autopilot.scripts.checksum == 0  # no script
    for wanted, arms in ((-1, True), (0, True), (-0x800000, True), (0x800000, True), (-2, False), (7, False)):
        copter.put("SCR_LD_CHECKSUM", wanted)
        assert (copter.autopilot.prearm() == "") == arms, wanted
