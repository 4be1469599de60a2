"""The exact law on an ArduPilot board: a Lua script that needs no companion.

The same law as the companion's (`mixer.exact.lua` translates it), from its last solution, at most STEPS
quadratic steps a call, on the demand of the autopilot's own loops. The script checks arming and emergency
stop, holds the outputs for HOLD_MS at a time, and gives no answer where it did not settle: then, as when it
stops for any reason, the matrix flies again.

ArduPilot's Lua counts in single precision, so that the wrench is exact to about 1e-6 of full authority there.
"""

from __future__ import annotations

import numpy as np

from coaxlink.errors import InputError
from coaxlink.live.mixer_core import CONTROLS, MatrixScale
from coaxlink.live.scripts.bridge import HOLD_MS, PERIOD_MS
from coaxlink.mixer import standard_coefficients
from coaxlink.mixer.exact import ExactLaw
from coaxlink.mixer.exact.lua import law_in_lua, table
from coaxlink.vehicle import Vehicle, refuse_live
from firmware_params.ardupilot.frames import OCTAQUAD
from firmware_params.ardupilot.table import (
    DYNAMIC_MATRIX,
    SCRIPTING_MATRIX,
    ApTable,
    used_factors,
)
from firmware_params.errors import TableError
from firmware_params.text import comment

STEPS = 6  # as the companion
# for SCR_VM_I_COUNT: docs/live.md has what calls cost
INSTRUCTIONS = 200_000
NAMES = ("c", "g", "shape", "lo", "hi", "x", "act", "lam", "el", "cap", "mu", "work", "sums", "box", "past")


def onboard_script(
    vehicle: Vehicle,
    *,
    frame_class: int = OCTAQUAD,
    hold_ms: int = HOLD_MS,
    period_ms: int = PERIOD_MS,
) -> str:
    """The script for the vehicle on a frame of that class (with 15 or 17: coaxlink's fitted table).

    Raises InputError for a vehicle or frame it cannot be.
    """
    refuse_live(vehicle)
    airframe, model = vehicle.airframe, vehicle.model
    source = airframe.source or airframe.name
    if not 1 <= len(airframe.rotors) <= CONTROLS:
        raise InputError(source, "rotors", f"1 to {CONTROLS} expected, found {len(airframe.rotors)}")
    law = ExactLaw(vehicle)
    p = law.problem
    factors = _factors(vehicle, frame_class)
    matrix = MatrixScale(airframe, standard_coefficients(model), factors).matrix
    scale = (matrix[p.order] / p.scale[:, None]).tolist()
    arrays = "\n".join(
        f"local {name} = {table(array.tolist())}" for name, array in zip(NAMES, law.arrays(), strict=True)
    )
    return _SCRIPT.format(
        motors=len(airframe.rotors), hold=hold_ms, period=period_ms, steps=STEPS, law=law_in_lua(),
        arrays=arrays, scale=table(scale), slots=table(p.slots.tolist()), name=comment(airframe.name),
    )  # fmt: skip


def _factors(vehicle: Vehicle, frame_class: int) -> list[list[float]]:
    try:
        if frame_class in (SCRIPTING_MATRIX, DYNAMIC_MATRIX):
            from coaxlink.tables.ardupilot import report_ap

            used = used_factors(report_ap(vehicle, "fitted", frame_class=frame_class).table)
        else:
            used = used_factors(ApTable(frame_class, frame_type=1))
    except TableError as error:
        raise InputError("`frame_class`", str(frame_class), f"4, 5, 15 or 17 expected ({error})") from error
    if len(used) != (count := len(vehicle.airframe.rotors)):
        problem = f"a frame of {len(used)} rotors, {vehicle.airframe.name} has {count}"
        raise InputError("`frame_class`", str(frame_class), problem)
    return np.asarray(used, float).tolist()


_SCRIPT = """\
-- coaxlink: the exact law on board, for {name}. No companion is needed.
-- Written by coaxlink; change it there, not here. Without an answer for {hold} ms the matrix flies again.

local MOTORS, HOLD_MS, PERIOD_MS, STEPS = {motors}, {hold}, {period}, {steps}

{law}
{arrays}
local scale = {scale}
local slots = {slots}

local low = param:get("MOT_PWM_MIN") or 1000
local high = param:get("MOT_PWM_MAX") or 2000
local channel = {{}}
for n = 1, MOTORS do
  channel[n] = SRV_Channels:find_channel(32 + n)
  if not channel[n] then
    error("coaxlink: no output has Motor" .. n)
  end
end

local function stopped()
  return not arming:is_armed() or (SRV_Channels.get_emergency_stop and SRV_Channels:get_emergency_stop())
end

-- speeds for normalised roll, pitch, yaw, throttle in x; whether they are the answer
local function mix(roll, pitch, yaw, throttle)
  for j = 0, 3 do
    local s = scale[j]
    mu[j] = max(-4.0, min(4.0, s[0] * roll + s[1] * pitch + s[2] * yaw + s[3] * throttle))
  end
  if settle(c, g, shape, lo, hi, x, act, lam, el, cap, mu, work, sums, box, past, STEPS) <= 0 then
    return false
  end
  for n = 0, MOTORS - 1 do
    local u = x[slots[n]]
    if not (u >= 0 and u <= 1) then  -- also for NaN
      restart(lo, hi, x, act, lam, el)
      return false
    end
  end
  return true
end

local function update()
  if not stopped() then
    local roll = motors:get_roll() + motors:get_roll_ff()
    local pitch = motors:get_pitch() + motors:get_pitch_ff()
    local yaw = motors:get_yaw() + motors:get_yaw_ff()
    if mix(roll, pitch, yaw, motors:get_throttle()) then
      for n = 1, MOTORS do
        local pwm = floor(low + (high - low) * x[slots[n - 1]] + 0.5)
        SRV_Channels:set_output_pwm_chan_timeout(channel[n], pwm, HOLD_MS)
      end
    end
  end
  return update, PERIOD_MS
end

gcs:send_text(6, "coaxlink: exact law on board, " .. MOTORS .. " motors")
return update, PERIOD_MS
"""
