"""Which autopilot can be mixed for live, by which way, and where that was read or flown.

One table; `require_path` looks an autopilot up in it, or refuses with the row's reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

PX4, ARDUPILOT = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
Version = tuple[int, ...]


@dataclass(frozen=True)
class LivePath:
    """What one range of firmware versions does with motor commands from a companion."""

    autopilot: int  # MAV_AUTOPILOT
    oldest: Version  # first (major, minor) this row speaks of
    newest: Version  # last one
    demand: str  # message that brings the wrench demand; empty: none does
    answer: str  # message that takes the motor commands; empty: none does
    own_mixer: bool  # whether its own mixer is known here, so that a hand-over can be ramped to it
    reason: str  # what a user reads when there is no way
    source: str
    bridge: bool = False  # only with what `coaxlink bridge` writes running on board

    @property
    def open(self) -> bool:
        """Whether live mixing is possible."""
        return bool(self.demand and self.answer)

    def speaks_of(self, autopilot: int, version: Version | None) -> bool:
        """Whether this autopilot is meant; an unknown version may be any."""
        known = version is None or self.oldest <= tuple(version[:2]) <= self.newest
        return self.autopilot == autopilot and known


ANY: Version = (255, 255)
_REMOVED = (
    "PX4 {version} ignores SET_ACTUATOR_CONTROL_TARGET (139): removed in 1.14, and no other MAVLink message "
    "flies eight rotors; upload a table (coaxlink table, coaxlink upload)"
)
PATHS: tuple[LivePath, ...] = (
    LivePath(
        PX4, (0, 0), (1, 13), "ACTUATOR_CONTROL_TARGET", "SET_ACTUATOR_CONTROL_TARGET", True, "",
        "PX4 1.12, 1.13 source: legacy mixer only (SYS_CTRL_ALLOC = 0); flown on the stand-in, no board",
    ),
    LivePath(
        PX4, (1, 14), (1, 14), "", "", False, _REMOVED,
        "PX4 1.14 source",
    ),
    LivePath(
        PX4, (1, 15), ANY, "DEBUG_FLOAT_ARRAY", "TUNNEL", False, "",
        "compiled against 1.15.4, 1.16.1 and main of August 2026; flown in the SITL of 1.16.1",
        bridge=True,
    ),
    LivePath(
        PX4, (1, 15), ANY, "", "", False,
        _REMOVED + ", or build its firmware with the module of `px4_module`: none heard",
        "PX4 1.16.1 and main of March 2026, flown in its SITL: 139 is ignored; direct_actuator needs DDS",
    ),
    LivePath(
        ARDUPILOT, (0, 0), ANY, "ACTUATOR_CONTROL_TARGET", "SET_ACTUATOR_CONTROL_TARGET", False, "",
        "master of March 2026: a script that takes 139 was flown in its SITL; ours on the stand-in (lupa)",
        bridge=True,
    ),
    LivePath(
        ARDUPILOT, (0, 0), ANY, "", "", False,
        "ArduPilot has no handler for SET_ACTUATOR_CONTROL_TARGET (139): it needs a Lua bridge on board "
        "(`bridge`), and none was heard",
        "ArduPilot master of March 2026: no native handler; a script that takes 139 was flown in its SITL",
    ),
)  # fmt: skip


def may_be_bridged(autopilot: int, version: Version | None) -> bool:
    """Whether what `coaxlink bridge` writes may run there, and has to be listened for."""
    return any(row.bridge and row.speaks_of(autopilot, version) for row in PATHS)


def require_path(autopilot: int, version: Version | None, *, bridged: bool = False) -> LivePath:
    """The way to mix for this autopilot; `bridged` says that what `bridge` writes was heard on board.

    Raises SafetyRefusal with the reason when there is none. An unknown version has none.
    """
    for row in PATHS:
        if row.autopilot != autopilot or (row.bridge and not bridged):
            continue
        known = version is not None and row.speaks_of(autopilot, version)
        if row.open and (known or (row.bridge and version is None)):
            return row
        if not row.open and (known or version is None):
            name = ".".join(map(str, version)) if version else "of unknown version"
            raise SafetyRefusal(row.reason.format(version=name))
    raise SafetyRefusal(f"no way is known to command the motors of autopilot type {autopilot} live")


def own_curve(session: Session) -> float:
    """THR_MDL_FAC on board; 0, its default, where it does not say."""
    from coaxlink.mavlink.parameters import Parameters

    if not session.identity.is_px4:
        return 0.0
    found = Parameters(session).read_many(["THR_MDL_FAC"], missing_ok=True)
    return float(found["THR_MDL_FAC"].value) if "THR_MDL_FAC" in found else 0.0
