"""What PX4 writes into its own parameters, for boards that do not serve `parameters.json.xz`.

There the same ones are marked `volatile` (read in its source, v1.16). None is refused over MAVLink.
MPC_THR_HOVER is not among them: the hover thrust estimator keeps its estimate to itself
(src/modules/mc_hover_thrust_estimator); only a value outside MPC_THR_MIN..MPC_THR_MAX is constrained
(src/modules/mc_pos_control/MulticopterPositionControl.cpp, parameters_update).
"""

from __future__ import annotations

from firmware_params.owned import COUNTER, LEARNED, MEASURED, READ_ONLY, Owned

OWNED: tuple[Owned, ...] = (
    Owned(r"COM_FLIGHT_UUID", COUNTER, "src/modules/commander/Commander.cpp, disarm"),
    Owned(r"LND_FLIGHT_T_(HI|LO)", COUNTER, "src/modules/land_detector/LandDetector.cpp, Run"),
    Owned(r"COM_MODE\d_HASH", READ_ONLY, "src/modules/commander/ModeManagement.cpp"),
    Owned(r"EKF2_MAG_DECL", MEASURED, "src/modules/ekf2/EKF2.cpp, UpdateMagCalibration"),
    Owned(
        r"CAL_(ACC|GYRO|MAG)\d_([XYZ](OFF|SCALE|ODIAG|COMP)|TEMP|ID)",
        LEARNED,
        "src/modules/sensors/vehicle_imu/VehicleIMU.cpp and vehicle_magnetometer/VehicleMagnetometer.cpp, "
        "ParametersSave after landing",
    ),
    Owned(
        r"CAL_BARO\d_(OFF|TEMP|ID)",
        LEARNED,
        "src/modules/sensors/vehicle_air_data/VehicleAirData.cpp, ParametersSave",
    ),
    Owned(r"SENS_DPRES_OFF", LEARNED, "src/modules/commander/airspeed_calibration.cpp"),
    Owned(r"ASPD_SCALE_[123]", LEARNED, "src/modules/airspeed_selector/airspeed_selector_main.cpp"),
)
