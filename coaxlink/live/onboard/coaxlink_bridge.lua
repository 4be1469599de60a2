-- coaxlink bridge: the companion mixes, this script passes the demand out and its outputs in.
-- Written by coaxlink; change it there, not here. On $hold ms of silence the matrix flies again.
-- An answer of group $ask commands nothing: it asks for the demand on the link it came by. Its first number is
-- the companion's token, by which two with the same ids can tell whom this script follows.

local MOTORS, HOLD_MS, PERIOD_MS = $motors, $hold, $period
local DEMAND, ANSWER = 140, 139
local low = param:get("MOT_PWM_MIN") or 1000
local high = param:get("MOT_PWM_MAX") or 2000
local own = param:get("SYSID_THISMAV") or param:get("MAV_SYSID") or 1
local channel = {}
local ASKED_MS = $request_ms
local asked = {}  -- links with a companion, and when it last spoke there
local followed, heard = nil, millis()  -- the companion whose answers are taken, and when the last one was
local taken = 0  -- how many of them came
local tokens = {}  -- of each link: a companion that asked on it, and its token

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

-- what the companion followed called itself when it asked, or 0
local function token()
  local said = followed and tokens[followed // 65536]
  return said and said[1] == followed and said[2] or 0
end

-- nobody takes the place of the companion that is followed
local function ask(link, whose, number)
  if followed ~= whose or token() == 0 then
    if not (following() and followed ~= whose and followed // 65536 == link) then
      tokens[link] = { whose, number }
    end
  end
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
                           whose % 256, whose // 256 % 256, taken, token(), 0)
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
      if group == $ask then
        ask(link, whose, string.unpack("<f", message, 21))
      elseif group == 0 and whose == (following() or whose) then
        newest, sender = message, whose
        taken = (taken + 1) % $counted
      end
    end
  end
  if not newest then
    return nil
  end
  local u = { string.unpack("<ffffffff", newest, 21) }
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
