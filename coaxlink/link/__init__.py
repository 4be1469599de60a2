"""The vehicle over MAVLink: addresses, sessions, parameters, uploads, flights, live mixing."""

from coaxlink.link.session import Identity, Session, connect

__all__ = ["Identity", "Session", "connect"]
