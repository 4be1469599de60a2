"""ArduPilot's Lua scripts, run for real (lupa) against the bindings that its documentation describes.

Scripts lie in `scripts/`; each runs once at boot in an environment of its own, and then as often as the
function it returned asks. What a script cannot do here, it cannot do there: names that are missing fail with
Lua's own error, which is sent as a text and keeps the vehicle from arming until the next boot.
"""

from __future__ import annotations

import importlib
import zlib
from collections import deque
from typing import Any

from sim.ardupilot.mixer import DYNAMIC, SCRIPTED, ArduPilotMixer
from sim.ardupilot.store import ArduPilotStore
from sim.line.ftp import CardFiles

FOLDER = "scripts"
TABLES, PER_TABLE = 10, 63

_PRELUDE = """
local c = ...
gcs, param, motors, arming, mavlink, battery, vehicle = {}, {}, {}, {}, {}, {}, {}
SRV_Channels, MotorsMatrix, Motors_dynamic = {}, {}, {}
function gcs:send_text(severity, text) c.say(severity, tostring(text)) end
function param:get(name) return c.get(name) end
function param:set(name, value) return c.set(name, value) end
param.set_and_save = param.set
function param:add_table(key, prefix, count) return c.add_table(key, prefix, count) end
function param:add_param(key, index, name, default) return c.add_param(key, index, name, default) end
function Parameter(name)
  local p = {}
  function p:init(n) name = n; return c.get(n) ~= nil end
  function p:get() return c.get(name) end
  function p:set(v) return c.set(name, v) end
  p.set_and_save = p.set
  return p
end
function SRV_Channels:find_channel(f) return c.find_channel(f) end
function SRV_Channels:set_output_pwm_chan_timeout(n, pwm, ms) c.override(n, pwm, ms) end
function SRV_Channels:get_output_pwm_chan(n) return c.output(n) end
function MotorsMatrix:add_motor_raw(m, r, p, y, order) c.matrix_add(m, r, p, y, order) end
function MotorsMatrix:set_throttle_factor(m, f) return c.matrix_throttle(m, f) end
function MotorsMatrix:init(n) return c.matrix_init(n) end
function Motors_dynamic:add_motor(m, order) c.dynamic_add(m, order) end
function Motors_dynamic:init(n) return c.dynamic_init(n) end
function Motors_dynamic:load_factors(t) c.dynamic_load(t) end
function motor_factor_table()
  local t = { rows = {} }
  for k, axis in ipairs({ "roll", "pitch", "yaw", "throttle" }) do
    t[axis] = function(self, m, value)
      self.rows[m + 1] = self.rows[m + 1] or { 0.0, 0.0, 0.0, 0.0 }
      if value == nil then return self.rows[m + 1][k] end
      self.rows[m + 1][k] = value
    end
  end
  return t
end
function motors:set_frame_string(text) end
for k, axis in ipairs({ "roll", "pitch", "yaw", "throttle" }) do
  motors["get_" .. axis] = function(self) return c.demand(k) end
  motors["get_" .. axis .. "_ff"] = function(self) return 0.0 end
end
function motors:get_throttle_bidirectional() return c.demand(4) end
function motors:get_interlock() return c.armed() end
function arming:is_armed() return c.armed() end
function vehicle:get_mode() return c.mode() end
function battery:voltage(i) return c.voltage() end
function battery:num_instances() return 1 end
function mavlink:init(queue, ids) end
function mavlink:register_rx_msgid(id) return c.listen(id) end
function mavlink:receive_chan() return c.receive() end
function mavlink:send_chan(link, id, payload) return c.send(link, id, payload) end
function mavlink:block_command(id) return true end
local number = { toint = function(n) return math.floor(n) end, tofloat = function(n) return n + 0.0 end }
debug.setmetatable(0, { __index = number })
function uint32_t(n) return math.floor(n or 0) & 0xFFFFFFFF end
function millis() return c.millis() end
function micros() return c.millis() * 1000 end
local searchers = { function(name)
  local text = c.module(name)
  if not text then return "\\n\\tno module '" .. name .. "'" end
  return assert(load(text, name, "t"))
end }
package.searchers = searchers
os, io, dofile, loadfile = { }, nil, nil, nil
local sethook, setmetatable_, load_ = debug.sethook, setmetatable, load
debug = nil
return {
  load = function(text, name)
    return load_(text, "@" .. name, "t", setmetatable_({}, { __index = _G }))
  end,
  call = function(f, limit)
    sethook(function() error("exceeded time limit") end, "", limit)
    local ok, a, b = pcall(f)
    sethook()
    return ok, a, b
  end,
}
"""


class Scripts:
    """All scripts of one boot, on the vehicle `host`, a `copter.Copter`."""

    def __init__(self, host: Any, store: ArduPilotStore, files: CardFiles, mixer: ArduPilotMixer) -> None:
        self._host, self._store, self._files, self._mixer = host, store, files, mixer
        self.overrides: dict[int, tuple[int, int]] = {}  # output: (pwm, ms until which it holds)
        self.failed = ""
        self._due: list[list[Any]] = []  # [ms, function, name]
        self._lua: Any = None
        self._tables: dict[int, tuple[str, int]] = {}
        self._matrix: dict[int, list[float]] = {}
        self._motors: set[int] = set()
        self._rows: list[list[float]] = []
        self._initialised = 0
        self._heard: deque[tuple[bytes, int]] = deque(maxlen=16)
        self._listens: set[int] = set()
        self.checksum = 0

    def boot(self) -> None:
        """Make the folder, load and run what lies in it."""
        if self._store["SCR_ENABLE"] != 1:
            return
        self._files.folders.add(FOLDER)
        paths = sorted(p for p in self._files.files if p.startswith(f"{FOLDER}/") and p.count("/") == 1)
        paths = [p for p in paths if p.endswith(".lua")]
        for path in paths:
            self.checksum ^= zlib.crc32(bytes(self._files.files[path]), 0xFFFFFFFF) ^ 0xFFFFFFFF
        self.checksum &= 0x7FFFFF
        if not paths:
            return
        try:
            lua = importlib.import_module("lupa.lua53")
        except ImportError:
            self._fail("Lua: the stand-in needs lupa to run scripts")
            return
        closed = {"register_eval": False, "register_builtins": False}
        runtime = lua.LuaRuntime(unpack_returned_tuples=True, encoding="latin-1", **closed)
        calls = runtime.table_from(self._calls())
        self._lua = runtime.execute(_PRELUDE, calls)
        for path in paths:
            self._start(path, self._files.files[path].decode("latin-1"))

    def _fail(self, why: str) -> None:
        self.failed = self.failed or why
        self._host.say(2, why)

    def _start(self, path: str, text: str) -> None:
        made = self._lua["load"](text, path.rpartition("/")[2])
        function, error = made if isinstance(made, tuple) else (made, None)
        if function is None:
            self._fail(f"Lua: {error}")
            return
        self._run(function, path)

    def _run(self, function: Any, path: str) -> None:
        ok, again, wait = self._lua["call"](function, max(int(self._store["SCR_VM_I_COUNT"]), 100))
        if not ok:
            self._fail(f"Lua: {again}")
        elif again is not None and wait is not None:
            self._due.append([self._millis() + int(wait), again, path])

    def step(self) -> None:
        """Run what is due."""
        now = self._millis()
        ready = [entry for entry in self._due if entry[0] <= now]
        if ready:
            self._due = [entry for entry in self._due if entry[0] > now]
            for _, function, path in ready:
                self._run(function, path)

    def hear(self, message_id: int, frame: bytes, link: int = 0) -> None:
        """A message came on that link; a script that listens gets it as ArduPilot keeps it.

        That is checksum, header, payload.
        """
        if message_id in self._listens:
            self._heard.append((frame[-2:] + frame[:-2].ljust(265, b"\0"), link))

    def held(self, channel: int) -> int | None:
        """PWM that a script holds an output at, while it does."""
        pwm, until = self.overrides.get(channel, (0, -1))
        return pwm if self._millis() <= until else None

    # -- the bindings --------------------------------------------------------------------------

    def _calls(self) -> dict[str, Any]:
        host = self._host
        return {
            "say": lambda severity, text: host.say(int(severity), text),
            "get": self._get,
            "set": lambda name, value: self._store.write(name, float(value)),
            "add_table": self._add_table,
            "add_param": self._add_param,
            "find_channel": self._find_channel,
            "override": self._override,
            "output": self._output,
            "matrix_add": self._matrix_add,
            "matrix_throttle": self._matrix_throttle,
            "matrix_init": self._matrix_init,
            "dynamic_add": lambda motor, order: self._motors.add(int(motor)),
            "dynamic_init": self._dynamic_init,
            "dynamic_load": self._dynamic_load,
            "demand": self._demand,
            "armed": lambda: host.armed,
            "mode": lambda: host.ap_mode,
            "voltage": lambda: host.reading.voltage,
            "listen": self._listen,
            "receive": self._receive,
            "send": self._send,
            "millis": self._millis,
            "module": self._module,
        }

    def _millis(self) -> int:
        """Since boot, as TIMESYNC and all stamps count it."""
        return round(1000 * (self._host.plant.time_s - self._host.booted_s)) + 1000

    def _demand(self, axis: float) -> float:
        """1 roll, 2 pitch, 3 yaw, 4 throttle."""
        return float(self._host.demand[int(axis) - 1])

    def _output(self, channel: float) -> int:
        """PWM of an output, counted from 0."""
        outputs = self._host.outputs_us
        return round(outputs[int(channel)]) if 0 <= channel < len(outputs) else 0

    def _send(self, link: float, number: float, payload: str) -> bool:
        """A message of a script's own, on one link."""
        self._host.send_raw(int(link), int(number), payload.encode("latin-1"))
        return True

    def _get(self, name: str) -> float | None:
        return self._store[name] if name in self._store else None  # noqa: SIM401 - it is no dict

    def _add_table(self, key: int, prefix: str, count: int) -> bool:
        if not 0 < key <= 200 or not 0 < count <= PER_TABLE or len(prefix) > 6:
            return False
        if key not in self._tables and len(self._tables) >= TABLES:
            return False
        self._tables[int(key)] = (prefix, int(count))
        return True

    def _add_param(self, key: int, index: int, name: str, default: float) -> bool:
        if key not in self._tables or not 0 < index <= self._tables[key][1]:
            return False
        full = self._tables[key][0] + name
        return len(full) <= 16 and self._store.add(full, float(default))

    def _find_channel(self, function: int) -> int | None:
        for n in range(1, 33):
            if self._store[f"SERVO{n}_FUNCTION"] == function:
                return n - 1
        return None

    def _override(self, channel: float, pwm: float, ms: float) -> None:
        self.overrides[int(channel)] = (int(pwm), self._millis() + int(ms))

    def _matrix_add(self, motor: int, roll: float, pitch: float, yaw: float, order: int) -> None:
        if self._mixer.frame_class == SCRIPTED and not self._initialised and 0 <= motor < 32:
            self._matrix[int(motor)] = [float(roll), float(pitch), float(yaw), 1.0]

    def _matrix_throttle(self, motor: int, factor: float) -> bool:
        if self._initialised or motor not in self._matrix:
            return False
        self._matrix[int(motor)][3] = float(factor)
        return True

    def _matrix_init(self, count: int) -> bool:
        if self._mixer.frame_class != SCRIPTED or self._initialised:
            return False
        if sorted(self._matrix) != list(range(int(count))):
            return False
        self._initialised = int(count)
        self._mixer.load(tuple((r[0], r[1], r[2], r[3]) for _, r in sorted(self._matrix.items())))
        return True

    def _dynamic_load(self, table: Any) -> None:
        rows = table["rows"]
        self._rows = [[float(rows[m + 1][k]) for k in range(1, 5)] for m in range(len(list(rows)))]
        if self._initialised:
            self._give()

    def _dynamic_init(self, count: int) -> bool:
        if self._mixer.frame_class != DYNAMIC or self._initialised:
            return False
        if sorted(self._motors) != list(range(int(count))) or len(self._rows) < count:
            return False
        self._initialised = int(count)
        self._give()
        return True

    def _give(self) -> None:
        rows = self._rows[: self._initialised]
        self._mixer.load(tuple((r[0], r[1], r[2], r[3]) for r in rows))

    def _listen(self, message_id: int) -> bool:
        self._listens.add(int(message_id))
        return True

    def _receive(self) -> Any:
        if not self._heard:
            return None
        message, link = self._heard.popleft()
        return message.decode("latin-1"), link, self._millis()

    def _module(self, name: str) -> str | None:
        path = f"{FOLDER}/modules/{name.replace('.', '/')}.lua"
        data = self._files.files.get(path)
        return None if data is None else data.decode("latin-1")
