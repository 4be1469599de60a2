"""The physical effects that a residual may be traced to, one module each."""

from coaxlink.residual.effects import (
    axial_inflow,
    battery_voltage,
    cg_offset,
    degraded_rotor,
    ground_effect,
    mass_change,
    rotor_drag,
    rotor_inertia_torque,
    rotor_lag,
    wind,
)
from coaxlink.residual.effects.base import Effect
from coaxlink.residual.effects.stand_air import AIR_DENSITY, BLADE_SPEED_LAW, INTERFERENCE, ROTOR_SPACING
from coaxlink.residual.effects.stand_drive import BATTERY_VOLTAGE, DEAD_BAND, MOTOR_HEATING, ROTOR_LAG
from coaxlink.residual.effects.stand_hysteresis import HYSTERESIS
from coaxlink.residual.effects.stand_rig import INERTIA, SENSOR_DRIFT, TACHOMETERS
from coaxlink.residual.frames import FlightFrame, StandFrame

FLIGHT_EFFECTS: tuple[Effect[FlightFrame], ...] = (
    battery_voltage.FLIGHT,
    ground_effect.FLIGHT,
    rotor_drag.FLIGHT,
    wind.FLIGHT,
    axial_inflow.FLIGHT,
    rotor_lag.FLIGHT,
    rotor_inertia_torque.FLIGHT,
    degraded_rotor.FLIGHT,
    cg_offset.FLIGHT,
    mass_change.FLIGHT,
)

STAND_EFFECTS: tuple[Effect[StandFrame], ...] = (
    BATTERY_VOLTAGE,
    AIR_DENSITY,
    SENSOR_DRIFT,
    INTERFERENCE,
    BLADE_SPEED_LAW,
    HYSTERESIS,
    INERTIA,
    ROTOR_LAG,
    ROTOR_SPACING,
    MOTOR_HEATING,
    DEAD_BAND,
    *TACHOMETERS,
)

__all__ = ["FLIGHT_EFFECTS", "STAND_EFFECTS", "Effect"]
