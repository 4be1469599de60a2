"""The SD card's `etc/extras.txt`, which starts the PX4 module at boot, or whose absence leaves PX4's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coaxlink.errors import CheckFailed, SafetyRefusal
from coaxlink.mavlink.ftp import Files

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

CARD = "/fs/microsd"
PATH = f"{CARD}/etc/extras.txt"
OURS = b"# coaxlink:"


def put_extras(session: Session, text: str) -> None:
    """Write it, checked against the board's checksum.

    Raises SafetyRefusal while armed, on what is no PX4, and where the card has somebody else's; CheckFailed
    where there is no card; FileError.
    """
    card = _card(session)
    if card.listing(CARD) is None:
        raise CheckFailed(
            f"no SD card on board ({CARD} is not there, as in PX4's simulation): in the console, "
            "`control_allocator stop`, then `coax_mixer start` do the same until the next boot"
        )
    card.make_folder(PATH.rpartition("/")[0])
    card.write(PATH, text.encode())


def remove_extras(session: Session) -> bool:
    """Take it away; False when there was none. Raises as `put_extras`."""
    return _card(session).remove(PATH)


def _card(session: Session) -> Files:
    if not session.identity.is_px4:
        raise SafetyRefusal("extras.txt is PX4's: this autopilot is none")
    if session.armed:
        raise SafetyRefusal("the vehicle is armed")
    card = Files(session)
    there = card.read(PATH)
    if there and not there.startswith(OURS):
        raise SafetyRefusal(f"{PATH} on the card is not coaxlink's: put its lines together by hand")
    return card
