"""Who answers on a line: firmware, version, board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

_PX4_SITL = "4954414c4449"  # "LATI" and "ONID" as little-endian words, less the system id


@dataclass(frozen=True)
class Identity:
    """Who answers. The fields from `version` on come from AUTOPILOT_VERSION and may be missing."""

    system: int
    component: int
    autopilot: int  # MAV_AUTOPILOT
    vehicle_type: int  # MAV_TYPE
    version: tuple[int, int, int] | None = None  # firmware, e.g. (1, 16, 1)
    capabilities: int | None = None  # MAV_PROTOCOL_CAPABILITY
    uid: str = ""  # board id, hex
    board: str = ""  # vendor:product:board version
    git_hash: str = ""

    @property
    def unique(self) -> bool:
        """Whether it has a uid that no other board gives.

        No zeros (boards that have none), and not PX4's own simulation, where every vehicle of a system id
        gives the same: part of "SIMULATIONID0000" as `uid`, or the system id less one as first byte of
        `uid2` (PX4 boards/px4/sitl/src/board_config.h, mavlink_main.cpp send_autopilot_capabilities).
        ArduPilot's SITL gives the machine's id plus its instance number (AP_HAL_SITL/Util.cpp).
        """
        return bool(self.uid[2:].strip("0")) and not self.uid.startswith(_PX4_SITL)

    @property
    def shared(self) -> bool:
        """Whether another vehicle may give the same uid: journals and locks go by the address as well.

        Besides what is not `unique`, ArduPilot without a board number (board_version 0): every SITL of a
        machine gives that machine's id (GCS_Common.cpp send_autopilot_version, AP_HAL_SITL/Util.cpp).
        """
        return not self.unique or (self.is_ardupilot and self.board.endswith(":0"))

    @property
    def is_px4(self) -> bool:
        """True for PX4."""
        return self.autopilot == mavlink.MAV_AUTOPILOT_PX4

    @property
    def is_ardupilot(self) -> bool:
        """True for ArduPilot."""
        return self.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

    @property
    def name(self) -> str:
        """Firmware and version in words, e.g. "PX4 1.16.1"."""
        firmware = kind_name(self.autopilot)
        return f"{firmware} {'.'.join(map(str, self.version))}" if self.version else firmware


def kind_name(autopilot: int) -> str:
    """A MAV_AUTOPILOT in words."""
    known = {mavlink.MAV_AUTOPILOT_PX4: "PX4", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot"}
    return known.get(autopilot, f"autopilot {autopilot}")


def type_name(kind: int) -> str:
    """A MAV_TYPE in words."""
    known = mavlink.enums["MAV_TYPE"].get(kind)
    return known.name.removeprefix("MAV_TYPE_").lower() if known else f"type {kind}"


def version_request(target: Identity) -> Any:
    """The command that asks for AUTOPILOT_VERSION."""
    return mavlink.MAVLink_command_long_message(
        target.system,
        target.component,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        0,
        float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
        *([0.0] * 6),
    )


def with_version(target: Identity, answer: Any) -> Identity:
    """`target` with what an AUTOPILOT_VERSION says."""
    packed = int(answer.flight_sw_version)
    return replace(
        target,
        version=(packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255),
        capabilities=int(answer.capabilities),
        uid=uid_of(answer),
        board=f"{answer.vendor_id}:{answer.product_id}:{answer.board_version}",
        git_hash=bytes(answer.flight_custom_version).hex(),
    )


def uid_of(answer: Any) -> str:
    """The board id of an AUTOPILOT_VERSION, hex: the long one where there is one."""
    long_uid = bytes(getattr(answer, "uid2", b"") or b"")
    return long_uid.hex() if any(long_uid) else f"{answer.uid:016x}"


def is_vehicle(heartbeat: Any, system: int | None) -> bool:
    """Whether a HEARTBEAT is that of an autopilot (of this system, if given)."""
    if system is not None and heartbeat.get_srcSystem() != system:
        return False
    others = (mavlink.MAV_TYPE_GCS, mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_TYPE_GIMBAL)
    return heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID and heartbeat.type not in others


def own_heartbeat(station: bool) -> Any:
    """Our own sign of life: a companion's, or a ground station's (as MAVSDK's and QGC's).

    Nothing of ours is a station in flight: PX4 would not miss the pilot's own (`coaxlink.mavlink.station`).
    """
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS if station else mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mavlink.MAV_STATE_ACTIVE,
        3,
    )
