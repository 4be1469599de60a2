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
from coaxlink.residual.frames import FlightFrame

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

__all__ = ["FLIGHT_EFFECTS", "Effect"]
