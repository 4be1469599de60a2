"""MAVSDK on a session's line: what the vehicle sends goes to both, what MAVSDK sends goes out through it.

So the line stays ours: one peer, recorded, any address that coaxlink knows. MAVSDK has the set-points and the
logs. Arming and take-off are commands of ours: what MAVSDK does around them depends on the mode that it last
heard of, a second ago, and its take-off leaves PX4's `MIS_TAKEOFF_ALT` changed.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError, SafetyRefusal
from coaxlink.mavlink import Session

FOUND_S = 30.0  # of wall time: heartbeats come once a second of its time, and a simulation may be slow


class Bridge:
    """A MAVSDK system on a session; a context manager. After `release` it sends nothing any more."""

    def __init__(self, session: Session) -> None:
        if session.signed:
            raise InputError(
                "`signing_key`", "", "MAVSDK's frames are not signed here: fly a vehicle that asks for none"
            )
        self.session = session
        self._sdk: Any = None
        self._leave: Callable[[], None] | None = None
        self.system: Any = None

    def __enter__(self) -> Self:
        from mavsdk.logging import log_subscribe
        from mavsdk.mavsdk import Configuration, Mavsdk

        log_subscribe(lambda *_: True)  # it writes to stdout, which is for results
        self._sdk = Mavsdk(Configuration.create_manual(*self.session.source, False))
        self._sdk.add_any_connection("raw://")
        self._sdk.subscribe_raw_bytes_to_be_sent(lambda data: self.session.send_bytes(bytes(data)))
        sdk = self._sdk
        self._leave = self.session.subscribe(
            lambda message: sdk.pass_received_raw_bytes(bytes(message.get_msgbuf())), whole_system=True
        )
        self.system = self._sdk.first_autopilot(timeout_s=FOUND_S)
        if self.system is None:
            self.release()
            raise LinkError(self.session.address, f"MAVSDK found no autopilot within {FOUND_S:.0f} s")
        return self

    def release(self) -> None:
        """Send nothing any more, at once; may be called twice."""
        if self._leave:
            self._leave()
            self._leave = None
        if self._sdk is not None:
            sdk, self._sdk = self._sdk, None
            sdk.destroy()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def request(what: str, session: Session, call: Callable[[], object]) -> None:
    """Run one of MAVSDK's calls. Raises SafetyRefusal with the vehicle's own words, LinkError on silence."""
    from mavsdk.exceptions import MavsdkError

    try:
        call()
    except MavsdkError as error:
        text = str(error)
        if "TIMEOUT" in text.upper() or "NO_SYSTEM" in text.upper() or "CONNECTION" in text.upper():
            raise LinkError(session.address, f"{what}: no answer ({text})") from error
        raise SafetyRefusal(f"{what}: the autopilot refused ({text}){_its_words(session)}") from error


def command(what: str, session: Session, number: int, *parameters: float) -> None:
    """A command of ours. Raises SafetyRefusal with the vehicle's own words, LinkError on silence."""
    result = session.command(number, *parameters)
    if result != mavlink.MAV_RESULT_ACCEPTED:
        known = mavlink.enums["MAV_RESULT"].get(result)
        answer = known.name if known else result
        raise SafetyRefusal(f"{what}: the autopilot refused ({answer}){_its_words(session)}")


def _its_words(session: Session) -> str:
    said = session.latest("STATUSTEXT")
    return f"; it says: {said.text}" if said is not None else ""
