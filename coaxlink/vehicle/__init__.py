"""What laws, tables and live mixing take: airframe and rotors, every effect in them or named as left out."""

from coaxlink.effects.static import Conditions
from coaxlink.vehicle.load import load_rotors, load_vehicle, refuse_no_rotor, vehicle_of
from coaxlink.vehicle.vehicle import (
    Vehicle,
    battery_watts,
    plain_rotors,
    refuse_live,
    require_vehicle,
    shaft_watts,
    usual_lift,
)

__all__ = [
    "Conditions",
    "Vehicle",
    "battery_watts",
    "load_rotors",
    "load_vehicle",
    "plain_rotors",
    "refuse_live",
    "refuse_no_rotor",
    "require_vehicle",
    "shaft_watts",
    "usual_lift",
    "vehicle_of",
]
