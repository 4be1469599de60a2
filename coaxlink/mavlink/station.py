"""When a program of ours may beat as a ground station.

PX4 says its STATUSTEXT only on links where a ground station's heartbeat is heard (mavlink_main.cpp), and acts
on the loss of the last one by NAV_DLL_ACT; with that set it arms only where one is heard. A program that is
none must not stand in for the pilot's: not in flight, and not on the ground of a vehicle that acts on a loss.
`Session` itself beats as one only while the vehicle is disarmed.
"""

from __future__ import annotations

from coaxlink.errors import CoaxlinkError
from coaxlink.mavlink.identity import own_heartbeat
from coaxlink.mavlink.parameters import Parameters
from coaxlink.mavlink.session import Session

ACTS = "NAV_DLL_ACT"


def hear_words(session: Session) -> None:
    """Beat as a ground station while disarmed, where the vehicle is a PX4 that does not act on its loss."""
    if session.identity.is_px4:
        try:
            session.station = float(Parameters(session).read(ACTS).value) == 0.0
        except CoaxlinkError:  # not known is not none
            session.station = False
        if session.station and not session.armed:
            session.send(own_heartbeat(True))  # at once: what is asked next may be refused in words


def unheard(session: Session) -> str:
    """Why PX4's words do not arrive just now; empty where they do (an ArduPilot says them to everybody)."""
    if not session.identity.is_px4 or (session.station and not session.armed):
        return ""
    why = "in flight" if session.station else f"while {ACTS} acts on a lost one"
    return f"PX4 says its messages to ground stations, and coaxlink is none {why}: yours has them"
