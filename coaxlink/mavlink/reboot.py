"""Restart the autopilot and wait for it."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import CheckFailed, LinkError
from coaxlink.mavlink.session import Message, Session

_TRIES, _TRY_S = 12, 1.0


def reboot(session: Session, gone_s: float = 5.0, back_s: float = 30.0) -> None:
    """Reboot the autopilot and wait until it is back. Raises CheckFailed when it refuses, LinkError.

    `gone_s` bounds the wait for a sign of the restart: its clock starts again, or it falls silent.
    """
    clock, stamps, restarted = session.clock, [0], [False]

    def watch(message: Message) -> None:
        stamp = getattr(message, "time_boot_ms", None)
        if stamp is not None:
            restarted[0] |= stamp + 1000 < stamps[0]
            stamps[0] = max(stamps[0], stamp)

    leave = session.subscribe(watch)
    try:
        result = _ask(session, lambda: restarted[0])
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise CheckFailed(f"the vehicle refuses to reboot (result {result})")
        gone = clock.monotonic() + gone_s
        while not restarted[0] and session.silence_s < 1.6 and clock.monotonic() < gone:
            clock.sleep(0.05)
    finally:
        leave()
    back = clock.monotonic() + back_s
    while clock.monotonic() < back:
        try:
            if session.wait("HEARTBEAT", 1.0) is not None:
                return
        except LinkError:
            clock.sleep(0.5)
    raise LinkError(session.address, f"the vehicle did not come back from its reboot within {back_s:g} s")


def _ask(session: Session, restarted: Callable[[], bool]) -> int:
    """The MAV_RESULT of the command. A restart whose acknowledgement got lost is known by the vehicle's clock
    alone: mere silence may be the line's."""
    for _ in range(_TRIES):
        try:
            return session.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0, timeout_s=_TRY_S, tries=1)
        except LinkError:
            if restarted():
                return int(mavlink.MAV_RESULT_ACCEPTED)
    raise LinkError(session.address, f"the command to reboot was not acknowledged ({_TRIES} tries)")
