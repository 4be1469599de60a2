"""What laws, tables and live mixing take: airframe and rotors, every effect in them or named as left out."""

from coaxlink.effects.static import Conditions
from coaxlink.vehicle.load import load_vehicle, refuse_no_lift
from coaxlink.vehicle.vehicle import Vehicle, plain_rotors, usual_lift

__all__ = ["Conditions", "Vehicle", "load_vehicle", "plain_rotors", "refuse_no_lift", "usual_lift"]
