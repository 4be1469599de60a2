"""Ask the vehicle once more who it is, before it is written to and before anything is called verified."""

from __future__ import annotations

from coaxlink.errors import LinkError, SafetyRefusal
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.identity import version_request
from coaxlink.mavlink.session import Session
from coaxlink.mavlink.strangers import LOST_S, TWO_BEATS_S

TRY_S, TRIES = 0.35, 40  # a bad line may need them all
SECOND_S = 0.15  # a second board behind a router answers the same question, a little later
_AGAIN_S = 0.02


def confirm(session: Session, *, alone: bool = True) -> None:
    """Returns when the board that the session began with answers, and no other under its ids.

    Where anyone may send (`udpin`), the line is first listened to for TWO_BEATS_S altogether. Without `alone`
    a second vehicle at another address is borne: to take back what was written to this one. Raises
    SafetyRefusal when another board answers, or two do, LinkError on silence.
    """
    wanted = session.identity
    if not wanted.uid:
        raise SafetyRefusal("the vehicle does not say which board it is: it could be mistaken for another")
    _listen(session)
    session.bound.refuse_others(alone=alone)
    answer, _ = session.exchange(version_request(wanted), "AUTOPILOT_VERSION", timeout_s=TRY_S, tries=TRIES)
    if answer is not None:
        session.clock.sleep(SECOND_S)
    session.bound.refuse_others(alone=alone)
    if answer is None:
        raise LinkError(session.address, f"board {wanted.uid} does not answer any more")


def alone(session: Session) -> None:
    """Returns when no other vehicle could be meant here; one in the air is not kept waiting.

    Raises SafetyRefusal.
    """
    if not session.armed:
        _listen(session)
    session.refuse_several(0.0 if session.armed else TWO_BEATS_S)
    session.bound.refuse_others()


def _listen(session: Session) -> None:
    """Until it is known who is there; no longer than a link may be silent."""
    bound, clock = session.bound, session.clock
    end = clock.monotonic() + LOST_S
    if parse_address(session.address).kind == "udpin":
        clock.sleep(max(0.0, bound.bound_s + TWO_BEATS_S - clock.monotonic()))
    while bound.strangers.undecided(clock.monotonic()) and clock.monotonic() < end:
        clock.sleep(_AGAIN_S)
