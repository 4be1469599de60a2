"""What the verbs say of who is on the line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink.cli.shared.shell import say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.mavlink import Session


def address_of(typed: str | None, airframe: Path | None) -> str:
    """Where the vehicle is: what was typed, else what its file says. Raises InputError where neither does."""
    from coaxlink.airframe import load_airframe

    found = typed if typed is not None or airframe is None else load_airframe(airframe).connect
    if found or typed is not None:
        return found or ""
    where = airframe or "the vehicle's file"
    wanted = f"an address is expected, or once for all [defaults] connect in {where}"
    raise InputError("--connect", "", wanted)


@contextmanager
def introduced(session: Session) -> Iterator[Session]:
    """Say who answers and where; at the end, however it comes, who else was there."""
    known, address = session.identity, session.bound.vehicle_address
    where = session.address if address == session.address else f"{address} ({session.address})"
    say(f"{known.name} at {where}, board {known.uid or 'unknown'}")
    if known.uid and not known.unique:
        say("boards and simulations share this id: only its address tells this vehicle from another")
    if session.bound.signs and not session.signed:
        say("it signs its messages; without --signing-key they are believed unchecked")
    try:
        yield session
    finally:
        tell_news(session)
        if session.trouble:
            say(f"{session.trouble}: this session's messages may be played back")


def tell_news(session: Session) -> None:
    """What happened on the line since the last call."""
    for line in session.bound.news():
        say(line)
