"""What ArduCopter writes into its own parameters (read in its source, master of October 2025).

`AP_Param::allow_set_via_mavlink` (libraries/AP_Param/AP_Param.cpp) refuses a parameter flagged
AP_PARAM_FLAG_INTERNAL_USE_ONLY, unless BRD_OPTIONS bit 2 allows it; the others that are `@ReadOnly` in its
documentation take a value and lose it again.
"""

from __future__ import annotations

from firmware_params.owned import COUNTER, LEARNED, MEASURED, READ_ONLY, Owned

OWNED: tuple[Owned, ...] = (
    # refused over MAVLink
    Owned(r"BARO[123]_(GND_PRESS|DEVID)", READ_ONLY, "libraries/AP_Baro/AP_Baro.cpp, INTERNAL_USE_ONLY"),
    Owned(r"MIS_TOTAL", COUNTER, "libraries/AP_Mission/AP_Mission.cpp, INTERNAL_USE_ONLY"),
    Owned(r"ARSPD\d?_DEVID", READ_ONLY, "libraries/AP_Airspeed/AP_Airspeed_Params.cpp, INTERNAL_USE_ONLY"),
    Owned(r"MNT\d?_DEVID", READ_ONLY, "libraries/AP_Mount/AP_Mount_Params.cpp, INTERNAL_USE_ONLY"),
    Owned(
        r"TEMP\d_DEVID",
        READ_ONLY,
        "libraries/AP_TemperatureSensor/AP_TemperatureSensor_Params.cpp, INTERNAL_USE_ONLY",
    ),
    # taken over MAVLink, and the board's all the same
    Owned(r"STAT_\w+", COUNTER, "libraries/AP_Stats/AP_Stats.cpp, flush, init; @ReadOnly"),
    Owned(r"FORMAT_VERSION", READ_ONLY, "ArduCopter/Parameters.cpp: another one erases all parameters"),
    Owned(r"COMPASS_DEV_ID[2-8]?", READ_ONLY, "libraries/AP_Compass/AP_Compass.cpp, @ReadOnly"),
    Owned(
        r"INS\d?_(ACC|GYR)[23]?_ID",
        READ_ONLY,
        "libraries/AP_InertialSensor/AP_InertialSensor.cpp, @ReadOnly",
    ),
    Owned(r"GPS\d?_CAN_NODEID[12]?", READ_ONLY, "libraries/AP_GPS/AP_GPS_Params.cpp, @ReadOnly"),
    Owned(r"VTX_FREQ", READ_ONLY, "libraries/AP_VideoTX/AP_VideoTX.cpp, @ReadOnly"),
    Owned(r"BARO_(GND_TEMP|FIELD_ELV)", MEASURED, "libraries/AP_Baro/AP_Baro.cpp, @Volatile"),
    Owned(
        r"COMPASS_DEC",
        MEASURED,
        "libraries/AP_Compass/AP_Compass.cpp, try_set_initial_location",
        "COMPASS_AUTODEC",
    ),
    Owned(
        r"MOT_THST_HOVER",
        LEARNED,
        "libraries/AP_Motors/AP_MotorsMulticopter.cpp, update_throttle_hover, save_params_on_disarm",
        "MOT_HOVER_LEARN",
    ),
    Owned(
        r"COMPASS_OFS[23]?_[XYZ]",
        LEARNED,
        "libraries/AP_Compass/AP_Compass.cpp, save_offsets",
        "COMPASS_LEARN",
    ),
    Owned(
        r"INS(\d_GYR|_GYR[23]?)(OFFS_[XYZ]|_CALTEMP)|INS_GYR[123]_CALTEMP",
        LEARNED,
        "libraries/AP_InertialSensor/AP_InertialSensor.cpp, init_gyro at every start",
        "INS_GYR_CAL",
    ),
    Owned(
        r"FFT_(FREQ_HOVER|BW_HOVER|THR_REF)",
        LEARNED,
        "libraries/AP_GyroFFT/AP_GyroFFT.cpp, save_params_on_disarm",
    ),
    Owned(
        r"TCAL_(TEMP_MIN|TEMP_MAX|BARO_EXP)",
        LEARNED,
        "libraries/AP_TempCalibration/AP_TempCalibration.cpp, @Volatile",
    ),
)
