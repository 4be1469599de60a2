"""The matrix of a vehicle owner's own Lua script, found by running it as ArduPilot would (lupa).

Scripts of FRAME_CLASS 15 (`MotorsMatrix:add_motor_raw`, `set_throttle_factor`) and 17 (`Motors_dynamic`,
`motor_factor_table`) compute their factors in any way: helper functions, loops, parameters. The script sees
its own parameters' defaults, those of the board where they are known, and nothing of this machine: no files,
no patterns (a pattern can run for ever), a bounded number of steps, a bounded memory.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from firmware_params.ardupilot.table import DYNAMIC_MATRIX, MAX_MOTORS, SCRIPTING_MATRIX, Factors
from firmware_params.errors import TableError
from firmware_params.plain import plain

STEPS, MEMORY = 2_000_000, 32 << 20  # Lua instructions a call; bytes
LARGEST = 1e9  # a factor: ArduPilot makes shares of them, so millionths are as good; infinities are not
SCHEDULED = 5  # a script may set its matrix in a function that it schedules
_PRELUDE = """
local c, steps = ...
local quiet = setmetatable({}, { __index = function() return function() end end })
local env = {
  assert = assert, error = error, ipairs = ipairs, pairs = pairs, next = next, pcall = pcall, select = select,
  tonumber = tonumber, tostring = tostring, type = type, print = function() end, rawget = rawget,
  rawset = rawset, rawequal = rawequal, rawlen = rawlen,
  setmetatable = function(t, m)
    assert(type(m) ~= "table" or rawget(m, "__gc") == nil, "no finalizers here")
    return setmetatable(t, m)
  end,
  getmetatable = function(t) return type(t) == "table" and getmetatable(t) or nil end,
  math = math, table = { unpack = table.unpack, pack = table.pack },
  string = { format = string.format, len = string.len, upper = string.upper, lower = string.lower,
             sub = string.sub, byte = string.byte, char = string.char },
  gcs = quiet, millis = function() return 0 end, micros = function() return 0 end,
  uint32_t = function(n) return math.floor(n or 0) end,
}
for _, name in ipairs({ "insert", "remove", "sort", "concat" }) do -- their loops are not counted
  env.table[name] = function(t, ...)
    assert(type(t) == "table" and not getmetatable(t), "a plain table is expected")
    return table[name](t, ...)
  end
end
getmetatable("").__index = env.string
env._G = env
env.param = {
  get = function(_, name) return c.get(name) end, set = function() return true end,
  set_and_save = function() return true end, set_default = function() return true end,
  add_table = function(_, key, prefix) c.add_table(key, prefix) return true end,
  add_param = function(_, key, index, name, value) c.add_param(key, name, value) return true end,
}
function env.Parameter(name)
  local p = {}
  function p:init(n) name = n return c.get(n) ~= nil end
  function p:get() return c.get(name) end
  function p:set() return true end
  p.set_and_save, p.set_default = p.set, p.set
  return p
end
function env.require(name)
  error("it takes in the module '" .. tostring(name) .. "', which is not here", 0)
end
env.bind_param = function(name) return env.Parameter(name) end
env.SRV_Channels = { find_channel = function(_, f) return c.channel(f) end }
setmetatable(env.SRV_Channels, getmetatable(quiet))
env.MotorsMatrix = {
  add_motor_raw = function(_, m, r, p, y, n, t) c.add(m, r, p, y, n, t) end,
  set_throttle_factor = function(_, m, f) return c.throttle(m, f) end,
  init = function(_, n) return c.init(15, n) end,
}
env.Motors_dynamic = {
  add_motor = function(_, m, n) c.order(m, n) end,
  load_factors = function(_, t)
    for m, row in pairs(t.rows) do c.row(m, row[1], row[2], row[3], row[4]) end
  end,
  init = function(_, n) return c.init(17, n) end,
}
function env.motor_factor_table()
  local t = { rows = {} }
  for k, axis in ipairs({ "roll", "pitch", "yaw", "throttle" }) do
    t[axis] = function(self, m, value)
      self.rows[m] = self.rows[m] or { 0.0, 0.0, 0.0, 0.0 }
      if value == nil then return self.rows[m][k] end
      self.rows[m][k] = value
    end
  end
  return t
end
setmetatable(env, { __index = function(_, name) return c.known(name) and quiet or nil end })
local sethook, load_ = debug.sethook, load
return {
  load = function(text) return load_(text, "=script", "t", env) end,
  call = function(f)
    local function stop() sethook(stop, "", 1) error("it runs for ever", 0) end
    sethook(stop, "", steps)
    local ok, a, b = pcall(f)
    sethook()
    return ok, a, b
  end,
}
"""
_SINGLETONS = frozenset(
    [
        "motors",
        "arming",
        "ahrs",
        "vehicle",
        "rc",
        "battery",
        "serial",
        "notify",
        "logger",
        "SRV_Channels",
        "mission",
        "mavlink",
        "gps",
        "baro",
        "rangefinder",
        "relay",
        "scripting",
        "esc_telem",
    ]
)


@dataclass(frozen=True)
class OwnMatrix:
    """What a script hands to ArduPilot."""

    frame_class: int
    factors: tuple[Factors, ...]  # (N,) roll, pitch, yaw, throttle as the script gives them
    order: tuple[int, ...]  # (N,) place of each motor in the motor test, from 1


def own_matrix(text: str, params: Mapping[str, float] | None = None) -> OwnMatrix:
    """Run a script and take its matrix. Raises TableError with the script's line where it sets none.

    >>> script = "for i = 0, 3 do MotorsMatrix:add_motor_raw(i, -1, 1, 1, i + 1) end MotorsMatrix:init(4)"
    >>> own_matrix(script).factors[0]
    (-1.0, 1.0, 1.0, 1.0)
    """
    lua53 = importlib.import_module("lupa.lua53")  # it has no types

    heard = _Heard(dict(params or {}))
    closed: dict[str, Any] = {"register_eval": False, "register_builtins": False, "max_memory": MEMORY}
    try:
        runtime = lua53.LuaRuntime(unpack_returned_tuples=True, encoding="latin-1", **closed)
        lua = runtime.execute(_PRELUDE, runtime.table_from(heard.calls()), STEPS)
        made = lua["load"](text.encode("latin-1", "replace").decode("latin-1"))
        function, error = made if isinstance(made, tuple) else (made, None)
        if function is None:
            raise TableError(f"the script is no Lua: {plain(str(error), 120)}")
        for _ in range(SCHEDULED):
            ok, again, _wait = lua["call"](function)
            if not ok:
                raise TableError(f"the script fails: {plain(str(again), 120)}")
            if heard.count or not callable(again):
                break
            function = again
    except (lua53.LuaError, MemoryError) as error:
        why = "it runs for ever" if "for ever" in str(error) else str(error)
        raise TableError(f"the script fails: {plain(why, 120)}") from error
    return heard.matrix()


class _Heard:
    """What the bindings were called with."""

    def __init__(self, params: dict[str, float]) -> None:
        self.params, self.count, self.frame_class = params, 0, 0
        self._prefix: dict[int, str] = {}
        self._rows: dict[int, list[float]] = {}
        self._order: dict[int, int] = {}

    def calls(self) -> dict[str, Any]:
        return {
            "get": lambda name: self.params.get(str(name)),
            "add_table": lambda key, prefix: self._prefix.__setitem__(int(key), str(prefix)),
            "add_param": self._add_param,
            "channel": lambda function: int(function),
            "add": self._add,
            "throttle": self._throttle,
            "order": lambda motor, place: self._order.__setitem__(self._motor(motor), int(place)),
            "row": lambda m, *row: self._rows.__setitem__(self._motor(m), [float(v) for v in row]),
            "init": self._init,
            "known": lambda name: str(name) in _SINGLETONS,
        }

    def _motor(self, motor: Any) -> int:
        number = int(motor)
        if not 0 <= number < MAX_MOTORS:
            raise ValueError(f"motor {number + 1}: ArduPilot holds 1..{MAX_MOTORS}")
        return number

    def _add_param(self, key: Any, name: Any, value: Any) -> None:
        self.params.setdefault(self._prefix.get(int(key), "") + str(name), float(value))

    def _add(self, motor: Any, roll: Any, pitch: Any, yaw: Any, place: Any, throttle: Any = None) -> None:
        number = self._motor(motor)
        if self.count:
            return  # ArduPilot takes no more once the matrix stands
        self._rows[number] = [
            float(roll),
            float(pitch),
            float(yaw),
            1.0 if throttle is None else float(throttle),
        ]
        self._order[number] = int(place)

    def _throttle(self, motor: Any, factor: Any) -> bool:
        number = self._motor(motor)
        if self.count or number not in self._rows:
            return False
        self._rows[number][3] = float(factor)
        return True

    def _init(self, frame_class: Any, count: Any) -> bool:
        whole = len(self._order) == int(count) and sorted(self._order) == list(range(len(self._order)))
        if not whole or not set(self._order) <= set(self._rows):
            return False
        self.count, self.frame_class = int(count), int(frame_class)
        return True

    def matrix(self) -> OwnMatrix:
        """Raises TableError where it was never whole."""
        if not self.count:
            problem = f"it adds {len(self._order)} motors and its init does not take them"
            raise TableError(problem if self._order else "the script sets no matrix of motors")
        rows = [self._rows[n] for n in range(self.count)]
        for n, row in enumerate(rows, start=1):
            if not all(abs(factor) <= LARGEST for factor in row):
                raise TableError(f"motor {n}: its factors are {row}: {LARGEST:g} at most is expected")
        factors = tuple((r, p, y, t) for r, p, y, t in rows)
        order = tuple(self._order[n] for n in range(self.count))
        dynamic = self.frame_class == DYNAMIC_MATRIX
        return OwnMatrix(DYNAMIC_MATRIX if dynamic else SCRIPTING_MATRIX, factors, order)
