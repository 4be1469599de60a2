"""An owner's Lua matrix: found by running the script; one of another kind is named."""

import pytest
from case_table import case_table

from firmware_params.ardupilot.owners_script import own_matrix
from firmware_params.errors import TableError

QUAD = "for i = 0, 3 do MotorsMatrix:add_motor_raw(i, (-1)^i, 1 - i // 2 * 2, (-1)^i, 4 - i) end\n"
DYNAMIC = """
assert(param:add_table(91, "MY_", 3))
assert(param:add_param(91, 1, "TOP", 0.8))
local top = Parameter()
top:init("MY_TOP")
local factors = motor_factor_table()
for i = 0, 3 do
  Motors_dynamic:add_motor(i, i + 1)
  factors:roll(i, 0.5 * top:get()); factors:pitch(i, -0.5)
  factors:yaw(i, 0.25); factors:throttle(i, top:get())
end
Motors_dynamic:load_factors(factors)
assert(Motors_dynamic:init(4), "no init")
local function update() return update, 200 end
return update, 200
"""


def test_a_matrix_is_what_the_script_hands_over():
    plain = own_matrix(QUAD + "MotorsMatrix:set_throttle_factor(3, 0.5)\nassert(MotorsMatrix:init(4))")
    assert plain.factors == ((1, 1, 1, 1), (-1, 1, -1, 1), (1, -1, 1, 1), (-1, -1, -1, 0.5))
    assert (plain.frame_class, plain.order) == (15, (4, 3, 2, 1))
    late = own_matrix(f"return function() {QUAD} MotorsMatrix:init(4) end, 100")
    assert late.factors[:3] == plain.factors[:3]
    dynamic = own_matrix(DYNAMIC)
    assert dynamic.factors == ((0.4, -0.5, 0.25, 0.8),) * 4 and dynamic.frame_class == 17
    assert own_matrix(DYNAMIC, {"MY_TOP": 1.0}).factors[0] == (0.5, -0.5, 0.25, 1.0)


def test_what_is_no_matrix_is_named_and_nothing_of_this_machine_is_reached():
    scripts = {
        "local a = 1": "sets no matrix",
        "for x": "no Lua: script:1",
        QUAD: "adds 4 motors and its init",
        QUAD + "assert(MotorsMatrix:init(6), 'six')": "six",
        QUAD + "assert(MotorsMatrix:init(1 << 40), 'many')": "many",
        QUAD.replace("(-1)^i", "1 / 0") + "MotorsMatrix:init(4)": "motor 1: its factors",
        "MotorsMatrix:add_motor_raw(32, 1, 1, 1, 1)": "motor 33: ArduPilot holds 1..32",
        "error('mine')": "mine",
        "require('matrix')": "the module 'matrix', which is not here",
        "while true do end": "runs for ever",
        "while true do pcall(function() while true do end end) end": "runs for ever",
        "local s = 'a' for i = 1, 60 do s = s .. s end": "not enough memory",
        "table.insert(setmetatable({}, {__len = function() return 1 << 40 end}), 1, 1)": "a plain table",
        "setmetatable({}, {__gc = function() while true do end end})": "no finalizers",
        "('a'):rep(1 << 40)": "a nil value",
        "io.open('/etc/passwd')": "global 'io'",
        "os.execute('ls')": "global 'os'",
        "python.eval('1')": "global 'python'",
        "load('x = 1')()": "global 'load'",
        "debug.sethook()": "global 'debug'",
    }
    with case_table() as case:
        for text, says in scripts.items():
            with case(text), pytest.raises(TableError, match=says.replace("(", r"\(")):
                own_matrix(text)
