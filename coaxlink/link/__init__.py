"""The vehicle over MAVLink: addresses, sessions, parameters, uploads, flights, live mixing."""

from coaxlink.link.identity import Identity
from coaxlink.link.opening import connect
from coaxlink.link.session import Session

__all__ = ["Identity", "Session", "connect"]
