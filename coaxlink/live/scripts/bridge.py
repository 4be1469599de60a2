"""The Lua bridge for ArduPilot: its whole demand out to the companion, the companion's outputs in.

ArduPilot has no handler for SET_ACTUATOR_CONTROL_TARGET, but its scripts may receive it and hold outputs for
a while (`SRV_Channels:set_output_pwm_chan_timeout`). The script sends roll, pitch, yaw and throttle as
ACTUATOR_CONTROL_TARGET each time it runs, takes the newest answer meant for this vehicle, checks it whole
(eight finite numbers in 0..1, armed, no emergency stop) and holds the motors' outputs for HOLD_MS: on silence
the matrix flies again by itself. Overrides bypass ArduPilot's own emergency stop, hence the checks.

The demand goes to the links where a companion has asked for it within REQUEST_MS, by an answer or by one of
group ASK that commands nothing: a radio with a ground station behind it is not flooded. One companion is
followed until it has been silent for HOLD_MS, and told to all: controls 5 and 6 of the demand are the system
and component of the companion followed, 0 when there is none. Control 7 is how many commands it has taken,
modulo COUNTED: what a line loses shows in it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.live.arrival import Count
from coaxlink.live.mixer_core import CONTROLS
from coaxlink.mavlink.parameters import Parameters
from firmware_params.ardupilot import scripts
from firmware_params.ardupilot.frames import OCTAQUAD, Y6
from firmware_params.ardupilot.table import (
    DYNAMIC_MATRIX,
    SCRIPTING_MATRIX,
    ApTable,
    Factors,
    used_factors,
)
from firmware_params.errors import TableError

if TYPE_CHECKING:
    from coaxlink.mavlink.session import Session

SCRIPT_NAME = "coaxlink_bridge.lua"
HOLD_MS = 100
PERIOD_MS = 4
ASK = 255  # the group of an answer that only asks for the demand
REQUEST_MS = 3000
COUNTED = 65536  # whole numbers up to 2^24 are exact in the message's single precision
FIND_S, ASK_EVERY_S, REMIND_S = 1.5, 0.3, 1.0


def bridge_script(motors: int, *, hold_ms: int = HOLD_MS, period_ms: int = PERIOD_MS) -> str:
    """The script for a vehicle of so many motors (1..8), numbered as Motor1.. (SERVOn_FUNCTION 33..40).

    Raises InputError when there are more motors than the message carries.
    """
    if not 1 <= motors <= CONTROLS:
        raise InputError("bridge", "motors", f"1 to {CONTROLS} expected, found {motors}")
    if not 20 <= hold_ms <= 500:
        raise InputError("bridge", "hold_ms", f"20 to 500 expected, found {hold_ms}")
    return _SCRIPT.format(
        motors=motors, hold=hold_ms, period=period_ms, ask=ASK, request_ms=REQUEST_MS, counted=COUNTED
    )


def board_factors(session: Session) -> list[list[float]]:
    """(N, 4) factors of the frame on board, as the firmware uses them.

    A frame whose factors come from a script (15, 17) is read back from coaxlink's own. Raises SafetyRefusal
    for one whose factors are not known here: another's script, or half a table.
    """
    parameters = Parameters(session)
    found = parameters.read_many(["FRAME_CLASS", "FRAME_TYPE"])
    frame = int(found["FRAME_CLASS"].value), int(found["FRAME_TYPE"].value)
    try:
        given: tuple[Factors, ...] = ()
        if frame[0] == SCRIPTING_MATRIX:
            given = scripts.script_factors(_script_on_board(session))
        elif frame[0] == DYNAMIC_MATRIX:
            given = scripts.params_factors(_loader_parameters(parameters))
        elif frame[0] not in (OCTAQUAD, Y6):
            raise TableError("the bridge is known to work on 4 (octaquad), 5 (Y6), 15 and 17")
        factors = used_factors(ApTable(frame[0], given, frame_type=frame[1]))
    except TableError as error:
        raise SafetyRefusal(f"FRAME_CLASS {frame[0]}: {error}") from error
    return [[float(f) for f in row] for row in factors]


class BridgeEnd:
    """The companion's end of the bridge: asks for the demand, and reads in it whom the bridge follows."""

    def __init__(self, session: Session) -> None:
        self._session, self._requested_s = session, 0.0
        self.taken = Count(COUNTED)  # of our commands, by the script
        self.acknowledged = False  # at some time it said that it follows us

    def find(self) -> bool:
        """Whether our script speaks."""
        end = time.monotonic() + FIND_S
        while time.monotonic() < end:  # one question may be lost
            self._ask()
            if self._session.wait("ACTUATOR_CONTROL_TARGET", ASK_EVERY_S) is not None:
                return True
        return False

    def tick(self, now: float) -> None:
        """Remind it that we are here; `now` by time.perf_counter."""
        if now - self._requested_s > REMIND_S:
            self._ask()

    def hear(self, demand: Sequence[float]) -> str | None:
        """Another companion that a demand (stamp, eight controls, group) says the bridge follows."""
        who = demand[5:7]
        self.taken.hear(demand[7])
        self.acknowledged = self.acknowledged or tuple(who) == self._session.source
        if tuple(who) in ((0.0, 0.0), self._session.source):
            return None
        return f"system {who[0]:g} component {who[1]:g}"

    def _ask(self) -> None:
        self._requested_s = time.perf_counter()
        identity = self._session.identity
        self._session.send(
            mavlink.MAVLink_set_actuator_control_target_message(
                0, ASK, identity.system, identity.component, [0.0] * CONTROLS
            )
        )


def _script_on_board(session: Session) -> str:
    from coaxlink.mavlink.ftp import Files

    board = Files(session)
    for folder in scripts.SCRIPT_FOLDERS:
        data = board.read(f"{folder}/{scripts.MATRIX_NAME}")
        if data is not None:
            return data.decode("utf-8", "replace")
    raise TableError(f"no {scripts.MATRIX_NAME} on board")


def _loader_parameters(parameters: Parameters) -> dict[str, float]:
    prefix = scripts.PREFIX
    count = parameters.read_many([f"{prefix}N"], missing_ok=True).get(f"{prefix}N")
    motors = min(max(int(count.value), 0), scripts.MAX_LOADER_MOTORS) if count else 0
    names = [f"{prefix}{axis}{n}" for n in range(1, motors + 1) for axis in "RPYT"]
    found = parameters.read_many([f"{prefix}N", f"{prefix}SUM", *names], missing_ok=True)
    return {name: float(value.value) for name, value in found.items()}


_SCRIPT = """\
-- coaxlink bridge: the companion mixes, this script passes the demand out and its outputs in.
-- Written by coaxlink; change it there, not here. On {hold} ms of silence the matrix flies again.
-- An answer of group {ask} commands nothing: it asks for the demand on the link it came by.

local MOTORS, HOLD_MS, PERIOD_MS = {motors}, {hold}, {period}
local DEMAND, ANSWER = 140, 139
local low = param:get("MOT_PWM_MIN") or 1000
local high = param:get("MOT_PWM_MAX") or 2000
local own = param:get("SYSID_THISMAV") or param:get("MAV_SYSID") or 1
local channel = {{}}
local ASKED_MS = {request_ms}
local asked = {{}}  -- links with a companion, and when it last spoke there
local followed, heard = nil, millis()  -- the companion whose answers are taken, and when the last one was
local taken = 0  -- how many of them came

for n = 1, MOTORS do
  channel[n] = SRV_Channels:find_channel(32 + n)
  if not channel[n] then
    error("coaxlink: no output has Motor" .. n)
  end
end

mavlink:init(4, 1)
mavlink:register_rx_msgid(ANSWER)

-- Lua's integers have 32 bits: the stamp in us is put together from 16-bit pieces
local function stamp()
  local ms = millis():toint()
  local a = (ms % 65536) * 1000
  local b = (ms // 65536) * 1000 + a // 65536
  return string.pack("<I2I2I4", a % 65536, b % 65536, b // 65536)
end

local function following()
  if followed and (millis() - heard):toint() > HOLD_MS then
    followed = nil
  end
  return followed
end

local function send_demand()
  if not next(asked) then
    return
  end
  local roll = motors:get_roll() + motors:get_roll_ff()
  local pitch = motors:get_pitch() + motors:get_pitch_ff()
  local yaw = motors:get_yaw() + motors:get_yaw_ff()
  local whose = following() or 0  -- system in the lowest byte, then component, then the link
  local body = string.pack("<ffffffffB", roll, pitch, yaw, motors:get_throttle(),
                           whose % 256, whose // 256 % 256, taken, 0, 0)
  local now, message = millis(), stamp() .. body
  for link, at in pairs(asked) do
    if (now - at):toint() > ASKED_MS then
      asked[link] = nil
    else
      mavlink:send_chan(link, DEMAND, message)
    end
  end
end

local function stopped()
  return not arming:is_armed() or (SRV_Channels.get_emergency_stop and SRV_Channels:get_emergency_stop())
end

-- the newest answer of the companion we follow, if it is whole and meant for us, and whose it is; or nil
local function answer()
  local newest, sender
  for _ = 1, 8 do
    local message, link = mavlink:receive_chan()
    if not message then
      break
    end
    local group, system = string.unpack("<BB", message, 53)
    if string.unpack("<I3", message, 10) == ANSWER and system == own then
      asked[link] = millis()
      local whose = string.unpack("<I2", message, 8) + 65536 * link
      if group == 0 and whose == (following() or whose) then
        newest, sender = message, whose
        taken = (taken + 1) % {counted}
      end
    end
  end
  if not newest then
    return nil
  end
  local u = {{ string.unpack("<ffffffff", newest, 21) }}
  for n = 1, MOTORS do
    if not (u[n] >= 0 and u[n] <= 1) then  -- also for NaN
      return nil
    end
  end
  return u, sender
end

local function update()
  local u, sender = answer()
  if u and not stopped() then
    followed, heard = sender, millis()
    for n = 1, MOTORS do
      local pwm = math.floor(low + (high - low) * u[n] + 0.5)
      SRV_Channels:set_output_pwm_chan_timeout(channel[n], pwm, HOLD_MS)
    end
  end
  send_demand()
  return update, PERIOD_MS
end

gcs:send_text(6, "coaxlink: bridge of " .. MOTORS .. " motors")
return update, PERIOD_MS
"""
