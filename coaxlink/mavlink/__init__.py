"""The vehicle over MAVLink: addresses, sessions, signing, parameters, files."""

from coaxlink.mavlink.identity import Identity
from coaxlink.mavlink.opening import connect
from coaxlink.mavlink.session import Session

__all__ = ["Identity", "Session", "connect"]
