"""What the verbs say of who is on the line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink import _interrupts
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


def typed_again(url: str, system: int | None) -> str:
    """The address as the next command needs it, with the vehicle's number where one was given."""
    return url if system is None else f"{url} --system {system}"


@contextmanager
def vehicle_at(url: str, *, system: int | None = None, **options: Any) -> Iterator[Session]:
    """The vehicle at `url`, number `system` if several are there, introduced; options of `mavlink.connect`.

    Raises what `connect` does.
    """
    from coaxlink.mavlink import connect

    _interrupts.begin()
    with connect(url, target_system=system, **options) as line, introduced(line) as session:
        yield session


@contextmanager
def introduced(session: Session) -> Iterator[Session]:
    """Say who answers and where; at the end, however it comes, who else was there."""
    known, address = session.identity, session.bound.vehicle_address
    where = session.address if address == session.address else f"{address} ({session.address})"
    say(f"system {known.system}: {known.name} at {where}, board {known.uid or 'unknown'}")
    if others := session.autopilots.beside(known.system):
        say(f"also on the line, and not talked to: {', '.join(others)}")
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
