"""The scripts, run: Lua 5.3 with stand-ins for ArduPilot's documented bindings."""

import zlib

import numpy as np
import pytest

from firmware_params.ardupilot import scripts

lupa = pytest.importorskip("lupa.lua53", reason="lupa runs ArduPilot's Lua scripts")

RCRM = tuple(
    (r, p, y, t)
    for r, p, y, t in zip(
        [-0.336371, 0.336371, 0.336371, -0.336371, 0.5, -0.5, -0.5, 0.5],
        [0.336371, 0.336371, -0.336371, -0.336371, 0.5, 0.5, -0.5, -0.5],
        [0.5, -0.5, 0.5, -0.5, 0.409836, -0.409836, 0.409836, -0.409836],
        [0.672199] * 4 + [1.0] * 4,
        strict=True,
    )
)


class Board:
    """What a script can reach, and what it did with it."""

    def __init__(self, frame_class, outputs=range(33, 41), accept=True):
        self.params = {"FRAME_CLASS": float(frame_class)}
        self.reported, self.motors, self.throttle, self.tables, self.inits = [], {}, {}, [], []
        self.outputs, self.accept = set(outputs), accept
        self.lua = lupa.LuaRuntime(unpack_returned_tuples=True)
        bind = self.lua.globals()
        bind.board = self
        self.lua.execute(BINDINGS)

    def say(self, text):
        self.reported.append(text)

    def get(self, name):
        return self.params.get(name)

    def channel(self, function):
        return 1 if function in self.outputs else None

    def init(self, count):
        self.inits.append(count)

    def add_param(self, name, default):
        self.params.setdefault(name, float(np.float32(default)))

    def run(self, text):
        return self.lua.execute(text)

    def add_motor(self, n, roll, pitch, yaw):
        self.motors[n] = (roll, pitch, yaw)

    def set_throttle(self, n, factor):
        self.throttle[n] = factor

    def loaded(self, rows):
        count = next(i for i in range(99) if rows[i] is None)
        self.tables.append([tuple(rows[i][k] for k in range(1, 5)) for i in range(count)])


BINDINGS = """
gcs = {}; function gcs:send_text(level, text) board.say(text) end
param = {}
function param:get(name) return board.get(name) end
function param:add_table(key, prefix, count)
  self.prefix = prefix
  return key >= 1 and key <= 200 and count <= 63
end
function param:add_param(key, i, name, default)
  if #(self.prefix .. name) > 16 then return false end
  board.add_param(self.prefix .. name, default); return true
end
SRV_Channels = {}
function SRV_Channels:find_channel(f) return board.channel(f) end
motors = {}; function motors:set_frame_string(text) end
MotorsMatrix = {}
function MotorsMatrix:add_motor_raw(n, r, p, y, order) board.add_motor(n, r, p, y) end
function MotorsMatrix:set_throttle_factor(n, f) board.set_throttle(n, f); return board.accept end
function MotorsMatrix:init(n) board.init(n); return true end
Motors_dynamic = {}
function Motors_dynamic:add_motor(n, order) board.add_motor(n, 0, 0, 0) end
function Motors_dynamic:load_factors(t) board.loaded(t.rows) end
function Motors_dynamic:init(n) board.init(n); return board.accept end
function motor_factor_table()
  local t = { rows = {} }
  local function row(n) t.rows[n] = t.rows[n] or {}; return t.rows[n] end
  function t:roll(n, v) row(n)[1] = v end
  function t:pitch(n, v) row(n)[2] = v end
  function t:yaw(n, v) row(n)[3] = v end
  function t:throttle(n, v) row(n)[4] = v end
  return t
end
"""


def test_the_matrix_script_hands_over_the_table():
    board = Board(15)
    board.run(scripts.matrix_script(RCRM, title="paper-x8, reduced law"))
    given = [(*board.motors[n], board.throttle[n]) for n in range(8)]
    np.testing.assert_allclose(given, RCRM, atol=5e-7)
    assert board.inits == [8] and "matrix of 8 motors" in board.reported[-1]


def _altered(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


def test_the_matrix_script_checks_itself():
    script = scripts.matrix_script(RCRM, title="t")
    for text, change, why in (
        (_altered(script, "672199", "672198"), {}, "table checksum is"),
        (_altered(script, "local MOTORS = 8", "local MOTORS = 6"), {}, "8 motors in the table, 6 expected"),
        (script, {"frame_class": 4}, "FRAME_CLASS must be 15"),
        (script, {"outputs": range(33, 40)}, "no output has SERVOn_FUNCTION 40"),
        (script, {"accept": False}, "motor 1 refused its throttle factor"),
    ):
        board = Board(**({"frame_class": 15} | change))
        with pytest.raises(lupa.LuaError, match=why):
            board.run(text)
        assert board.inits == [] and why in board.reported[-1]


def _loader(board):
    update, period = board.run(scripts.loader_script())
    assert period == 100
    return update


def test_the_loader_takes_a_table_only_when_it_is_whole_and_then_live():
    board = Board(17)
    update = _loader(board)
    assert board.tables == []
    *params, last = scripts.loader_params(RCRM).items()
    for name, value in params:
        assert name in board.params
        board.params[name] = float(np.float32(value))
        update()
    assert board.tables == []
    board.params[last[0]] = float(np.float32(last[1]))
    update()
    np.testing.assert_allclose(board.tables[0], RCRM, atol=5e-7)
    assert board.inits == [8]
    other = [(*row[:3], 1.0) for row in RCRM]
    for count, (name, value) in enumerate(scripts.loader_params(other).items()):
        board.params[name] = float(np.float32(value))
        update()
        assert len(board.tables) == (2 if name == "CXL_SUM" else 1), count
    np.testing.assert_allclose(board.tables[1], other, atol=5e-7)
    assert board.inits == [8]  # live, without a second init


def test_the_loader_keeps_flying_the_old_table_on_nonsense():
    board = Board(17)
    update = _loader(board)
    board.params |= scripts.loader_params(RCRM)
    update()
    board.params["CXL_R1"] = float("nan")
    board.params["CXL_SUM"] += 1.0
    update()
    board.params |= scripts.loader_params(RCRM[:6])
    update()
    update()
    assert len(board.tables) == 1
    assert [s for s in board.reported if "needs a reboot" in s] == [
        "coaxlink: another number of motors needs a reboot"
    ]


def test_loader_parameters_fit_ardupilot():
    twelve = scripts.loader_params([(0.5, -0.5, 0.25, 1.0)] * 12)
    assert len(twelve) == 50 <= 63 and all(len(name) <= 16 for name in twelve)
    assert list(twelve)[-1] == "CXL_SUM"
    assert all(float(np.float32(twelve[n])) == twelve[n] for n in ("CXL_SUM", "CXL_N"))
    with pytest.raises(scripts.TableError):
        scripts.loader_params([(0.0, 0.0, 0.0, 1.0)] * 13)
    with pytest.raises(scripts.TableError):
        scripts.matrix_script([(9.0, 0.0, 0.0, 1.0)], title="t")


def test_checksums():
    # a CRC without inversion is linear: zeros give zero, which zlib's own does not
    assert scripts.file_crc(b"") == 0 and scripts.file_crc(b"\0" * 9) == 0 and zlib.crc32(b"\0") != 0
    assert scripts.file_crc(b"123456789") == 0x2DFD2D88
    assert scripts.load_checksum([b"a", b"a"]) == 0
    assert scripts.load_checksum([b"abc"]) == scripts.file_crc(b"abc") & 0x7FFFFF
    assert (
        scripts.checksum([[1, 2], [3]]) == scripts.checksum([[1], [2, 3]]) != scripts.checksum([[3, 2], [1]])
    )
    assert 0 <= scripts.checksum([[8_000_000, -8_000_000]] * 48) < 2**24
