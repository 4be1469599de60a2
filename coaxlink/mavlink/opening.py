"""Open a line and find the vehicle on it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink.errors import InputError
from coaxlink.mavlink.address import parse_address
from coaxlink.mavlink.clock import SYSTEM, Clock
from coaxlink.mavlink.session import COMPANION_COMPONENT, COMPANION_SYSTEM, Session
from coaxlink.mavlink.transport import Transport, open_transport

if TYPE_CHECKING:
    from coaxlink.mavlink.signing import Signer


def connect(
    url: str,
    *,
    timeout_s: float = 10.0,
    record: Path | None = None,
    source_system: int = COMPANION_SYSTEM,
    source_component: int = COMPANION_COMPONENT,
    target_system: int | None = None,
    signing_key: Path | None = None,
    listen_only: bool = False,
    station: bool = False,
    transport: Transport | None = None,
    clock: Clock = SYSTEM,
) -> Session:
    """Open a line and wait for an autopilot's heartbeat.

    `record` writes a tlog of all that passes. `target_system` picks one of several vehicles on the line,
    and is needed where there are several.
    With `signing_key` (a file of mode 600) both sides must sign. A `station` is a ground station, no
    companion: PX4 says its texts only to one, and misses one that falls silent in flight. `transport` is a
    line that is open already (in tests one in memory, on their own `clock`); then `url` is only its name.
    Raises InputError for a bad address, LinkError when no autopilot is heard within `timeout_s`,
    SafetyRefusal when one is heard that does not sign with this key, or signs and answers nobody without one
    (with `listen_only` that is borne), or where several are heard and none was named.
    """
    if not 0.0 < timeout_s < math.inf:
        raise InputError("`timeout_s`", "", f"seconds above 0 are expected, found {timeout_s:g}")
    if target_system is not None and not 1 <= target_system <= 255:
        found = f"found {target_system}"
        raise InputError("`target_system`", "", f"a system id from 1 to 255 is expected, {found}")
    address = parse_address(url)
    line = transport or open_transport(address, timeout_s)
    try:
        signer = _signer(signing_key) if signing_key else None
    except BaseException:
        line.close()
        raise
    session = Session(
        line, url, source_system, source_component, target_system, record, signer, clock, station
    )
    if transport is None:
        session.reopen = lambda: open_transport(address, 0.0)
    try:
        session.start(timeout_s)
        session.refuse_several()
        if not listen_only:
            session.refuse_unheard()
    except BaseException:
        session.close()
        raise
    return session


def _signer(key_file: Path) -> Signer:
    from coaxlink.files import state_folder
    from coaxlink.mavlink.signing import Signer, load_key

    return Signer(load_key(key_file), state_folder())
