"""Readers: stand logs and flight logs, whatever wrote them, as one table with units in every name."""

from coaxlink.data.logs.flight import is_flight_log, read_flight_log, read_flights
from coaxlink.data.samples import Samples
from coaxlink.data.sides import RotorsUnclear
from coaxlink.data.stand import read_stand_log

__all__ = ["RotorsUnclear", "Samples", "is_flight_log", "read_flight_log", "read_flights", "read_stand_log"]
