"""The Lua scripts that carry a table, and the checksums ArduPilot and the scripts themselves use.

`matrix_script` is FRAME_CLASS 15: the table stands in the script; a new one needs a reboot. `loader_script`
is FRAME_CLASS 17: the table is the script's own parameters CXL_*, and a new one is live as soon as its
checksum parameter agrees with the numbers, never before: a half-written table does not fly.

Factors travel in millionths. ArduPilot's Lua has 32-bit integers and float32 numbers, so the checksum stays
below 2^24, where both are exact.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence

from firmware_params.ardupilot.table import Factors
from firmware_params.errors import TableError
from firmware_params.text import comment

MILLION = 1_000_000
_MODULUS = 4093
PREFIX = "CXL_"
TABLE_KEY = 97  # of param:add_table; 1..200, one per script
MAX_LOADER_MOTORS = 12
LAST = f"{PREFIX}T{MAX_LOADER_MOTORS}"  # the parameter that the loader adds last
SCRIPT_FOLDERS = ("/APM/scripts", "scripts")  # boards, SITL
_ROW = re.compile(r"^  \{ +(-?\d{1,9}), +(-?\d{1,9}), +(-?\d{1,9}), +(-?\d{1,9}) \},  -- motor", re.MULTILINE)
_SUM = re.compile(r"^local CHECKSUM = (\d{1,9})$", re.MULTILINE)
MATRIX_NAME, LOADER_NAME = "coaxlink_matrix.lua", "coaxlink_loader.lua"


def in_millionths(factors: Sequence[Factors]) -> list[tuple[int, int, int, int]]:
    """Factors as the scripts hold them. Raises TableError above 8: float32 would not hold a millionth."""
    rows = []
    for n, motor in enumerate(factors):
        if not all(abs(f) <= 8.0 for f in motor):
            raise TableError(f"rotor {n + 1}: coaxlink's scripts hold factors of -8..8, found {motor}")
        roll, pitch, yaw, throttle = (round(f * MILLION) for f in motor)
        rows.append((roll, pitch, yaw, throttle))
    return rows


def checksum(rows: Iterable[Sequence[int]]) -> int:
    """The scripts' own checksum of whole numbers, below 2^24."""
    a, b = 1, 0
    for row in rows:
        for value in row:
            a = (a + value) % _MODULUS
            b = (b + a) % _MODULUS
    return b * 4096 + a


def file_crc(data: bytes) -> int:
    """CRC32 of a file as ArduPilot has it (MAVFTP opcode 14, SCR_LD_CHECKSUM): no inversion at either end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def load_checksum(scripts: Iterable[bytes]) -> int:
    """SCR_LD_CHECKSUM of the scripts in the folder; with it set, an altered script refuses arming."""
    total = 0
    for data in scripts:
        total ^= file_crc(data)
    return total & 0x7FFFFF


def matrix_script(factors: Sequence[Factors], *, title: str) -> str:
    """The FRAME_CLASS 15 script. Raises TableError."""
    rows = in_millionths(factors)
    table = "\n".join(
        f"  {{ {r:8d}, {p:8d}, {y:8d}, {t:8d} }},  -- motor {n}"
        for n, (r, p, y, t) in enumerate(rows, start=1)
    )
    return _MATRIX.format(title=comment(title), count=len(rows), sum=checksum(rows), table=table)


def script_factors(text: str) -> tuple[Factors, ...]:
    """Factors in a FRAME_CLASS 15 script of ours. Raises TableError for another's, or a damaged one."""
    rows = [tuple(map(int, row)) for row in _ROW.findall(text)]
    total = _SUM.search(text)
    if not rows or total is None or checksum(rows) != int(total.group(1)):
        raise TableError("this is no mixer table that coaxlink wrote")
    return tuple((r / MILLION, p / MILLION, y / MILLION, t / MILLION) for r, p, y, t in rows)


def params_factors(params: Mapping[str, float]) -> tuple[Factors, ...]:
    """Factors in the parameters of the FRAME_CLASS 17 loader. Raises TableError."""
    try:
        count = int(params[f"{PREFIX}N"])
        rows = [
            tuple(round(params[f"{PREFIX}{axis}{n}"] * MILLION) for axis in "RPYT")
            for n in range(1, count + 1)
        ]
        total = params[f"{PREFIX}SUM"]
    except KeyError as error:
        raise TableError(f"parameter {error.args[0]} is missing") from None
    if not rows or checksum(rows) != total:
        raise TableError(f"{PREFIX}SUM does not agree with the numbers: half a table")
    return tuple((r / MILLION, p / MILLION, y / MILLION, t / MILLION) for r, p, y, t in rows)


def loader_script(max_motors: int = MAX_LOADER_MOTORS) -> str:
    """The FRAME_CLASS 17 script, the same for every vehicle; its table comes from `loader_params`."""
    return _LOADER.format(motors=max_motors, key=TABLE_KEY, prefix=PREFIX)


def loader_params(factors: Sequence[Factors], max_motors: int = MAX_LOADER_MOTORS) -> dict[str, float]:
    """The loader's parameters for a table; CXL_SUM last, since it makes the table live. Raises TableError."""
    rows = in_millionths(factors)
    if not 1 <= len(rows) <= max_motors:
        raise TableError(
            f"{len(rows)} rotors: coaxlink's own script of FRAME_CLASS 17 holds up to {max_motors}; "
            "FRAME_CLASS 15 holds 32"
        )
    params: dict[str, float] = {}
    for n, row in enumerate(rows, start=1):
        params |= {f"{PREFIX}{axis}{n}": value / MILLION for axis, value in zip("RPYT", row, strict=True)}
    params[f"{PREFIX}N"] = float(len(rows))
    params[f"{PREFIX}SUM"] = float(checksum(rows))
    return params


_MATRIX = """\
-- {title}
-- Mixer table for FRAME_CLASS 15 (scripting matrix). Written by coaxlink; change it there, not here.
-- One row a motor: roll, pitch, yaw, throttle in millionths. ArduPilot scales each axis to a largest
-- factor of 0.5 (throttle to 1); ratios within an axis stay. A new table needs a reboot.

local MOTORS = {count}
local CHECKSUM = {sum}
local TABLE = {{
{table}
}}

local function fail(why)
  gcs:send_text(0, "coaxlink: " .. why)
  error("coaxlink: " .. why)
end

local function checksum()
  local a, b = 1, 0
  for i = 1, #TABLE do
    for k = 1, 4 do
      a = (a + TABLE[i][k]) % 4093
      b = (b + a) % 4093
    end
  end
  return b * 4096 + a
end

if #TABLE ~= MOTORS then
  fail(string.format("%d motors in the table, %d expected", #TABLE, MOTORS))
end
if checksum() ~= CHECKSUM then
  fail(string.format("table checksum is %d, %d expected", checksum(), CHECKSUM))
end
if param:get("FRAME_CLASS") ~= 15 then
  fail("FRAME_CLASS must be 15")
end
for i = 1, MOTORS do
  -- motors 1..8 are output functions 33..40, 9..12 are 82..85, 13..32 are 160..179
  local motor_function = i <= 8 and 32 + i or i <= 12 and 73 + i or 147 + i
  if not SRV_Channels:find_channel(motor_function) then
    fail(string.format("no output has SERVOn_FUNCTION %d (motor %d)", motor_function, i))
  end
end

for i = 1, MOTORS do
  local row = TABLE[i]
  MotorsMatrix:add_motor_raw(i - 1, row[1] / 1000000.0, row[2] / 1000000.0, row[3] / 1000000.0, i)
end
for i = 1, MOTORS do
  if not MotorsMatrix:set_throttle_factor(i - 1, TABLE[i][4] / 1000000.0) then
    fail(string.format("motor %d refused its throttle factor", i))
  end
end
if not MotorsMatrix:init(MOTORS) then
  fail(string.format("the matrix of %d motors was refused", MOTORS))
end
motors:set_frame_string("coaxlink")
gcs:send_text(6, string.format("coaxlink: matrix of %d motors, checksum %d", MOTORS, CHECKSUM))
"""

_LOADER = """\
-- Mixer table loader for FRAME_CLASS 17 (dynamic matrix). Written by coaxlink.
-- The table is this script's own parameters: {prefix}N motors, {prefix}R1, {prefix}P1, {prefix}Y1, {prefix}T1
-- and so on (roll, pitch, yaw, throttle), and {prefix}SUM, the checksum of all of them in millionths.
-- A table is loaded when its checksum agrees, in one step, also in flight; until then the last one flies.

local MAX_MOTORS = {motors}
local KEY = {key}
local PREFIX = "{prefix}"
local AXES = {{ "R", "P", "Y", "T" }}
local loaded, complained, registered

assert(param:add_table(KEY, PREFIX, 2 + 4 * MAX_MOTORS), "coaxlink: no room for parameters")
assert(param:add_param(KEY, 1, "N", 0), "coaxlink: parameter N")
assert(param:add_param(KEY, 2, "SUM", 0), "coaxlink: parameter SUM")
for i = 1, MAX_MOTORS do
  for k = 1, 4 do
    local name = AXES[k] .. tostring(i)
    assert(param:add_param(KEY, 2 + 4 * (i - 1) + k, name, 0), "coaxlink: parameter " .. name)
  end
end

local function whole(value)
  return math.floor(value * 1000000.0 + 0.5)
end

local function read_table(count)
  local rows, a, b = {{}}, 1, 0
  for i = 1, count do
    rows[i] = {{}}
    for k = 1, 4 do
      local value = param:get(PREFIX .. AXES[k] .. tostring(i))
      if not value or value ~= value then
        return nil
      end
      rows[i][k] = value
      a = (a + whole(value)) % 4093
      b = (b + a) % 4093
    end
  end
  return rows, b * 4096 + a
end

local function load_table(rows, count)
  local factors = motor_factor_table()
  for i = 1, count do
    factors:roll(i - 1, rows[i][1])
    factors:pitch(i - 1, rows[i][2])
    factors:yaw(i - 1, rows[i][3])
    factors:throttle(i - 1, rows[i][4])
  end
  if not registered then
    for i = 1, count do
      Motors_dynamic:add_motor(i - 1, i)
    end
  end
  Motors_dynamic:load_factors(factors)
  if not registered then
    if not Motors_dynamic:init(count) then
      gcs:send_text(0, string.format("coaxlink: %d motors were refused", count))
      return false
    end
    registered = count
    motors:set_frame_string("coaxlink")
  end
  return true
end

function update()
  local count, sum = param:get(PREFIX .. "N"), param:get(PREFIX .. "SUM")
  count = count and math.floor(count) or 0
  if sum and sum ~= loaded and count >= 1 and count <= MAX_MOTORS then
    local rows, found = read_table(count)
    if registered and registered ~= count then
      if complained ~= sum then
        gcs:send_text(3, "coaxlink: another number of motors needs a reboot")
        complained = sum
      end
    elseif rows and found == math.floor(sum) then
      if load_table(rows, count) then
        loaded = sum
        gcs:send_text(6, string.format("coaxlink: table of %d motors live (%d)", count, found))
      end
    end
  end
  return update, 100
end

return update()
"""
