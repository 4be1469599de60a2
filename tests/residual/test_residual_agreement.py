"""What the selection leaves open is asked of the posterior; what it says is taken only where it may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coaxlink.data import Samples
from coaxlink.residual.agreement import agreed, follows_clock, leaves_open, recorded
from coaxlink.residual.result import (
    Ambiguous,
    ChannelError,
    FoundEffect,
    ParameterValue,
    Refinement,
    Suspect,
    Unexplained,
)

TIME = np.linspace(0.0, 600.0, 200)
SAGGING = 25.0 - TIME / 300.0
RESTED = SAGGING + 1.5 * np.sin(TIME / 20.0)
# numbers that physics allows
NUMBERS = {
    "battery_voltage": {"speed_exponent": 0.8},
    "dead_band": {"band": 0.1, "share": 1.0},
    "hysteresis": {"thrust_share": 0.05, "torque_share": 0.05},
    "motor_heating": {"speed_loss_per_100K": 0.05},
    "rotor_lag": {"lag_s": 0.1, "share": 1.0},
    "sensor_drift": {"channel": 2.0, "per_minute": 0.1, "zero": 0.0},
}


def numbered(name):
    return tuple(ParameterValue(n, x, (x, x), "1") for n, x in NUMBERS[name].items())


def said(*effects, open_ends=(), doubts=(), suspects=(), after=0.8):
    errors = {"lower_thrust": (1.0, after), "lower_torque": (1.0, 1.0)}
    found = tuple(FoundEffect(name, (), numbered(name), errors, {"nats": nats}, "") for name, nats in effects)
    noise = {name: ChannelError("N", 0.7, 1.0, 0.8, (1.0, 1.0), (0.8, 0.8), 100, 1.0) for name in errors}
    return Refinement("stand", noise, found, open_ends, doubts, suspects, (), None)


def log(**columns):
    return [Samples({"time_s": TIME, **columns}, "test")]


OPEN = said(open_ends=(Unexplained("lower_thrust", ("time_s",), 1.0, ""),))


def test_only_what_is_left_without_a_name_is_asked_about():
    assert leaves_open(OPEN) and not leaves_open(said())
    assert not leaves_open(said(("rotor_lag", 9.0), open_ends=OPEN.unexplained))
    assert not leaves_open(said(suspects=(Suspect("lower_rpm", "all", ""),), open_ends=OPEN.unexplained))


@pytest.mark.parametrize(
    ("effects", "columns", "taken"),
    [
        ([("hysteresis", 20.0)], {}, True),
        ([("hysteresis", -3.0)], {}, False),  # its own evidence speaks against it
        ([("hysteresis", 20.0), ("rotor_lag", 20.0)], {}, False),  # two at once
        ([("sensor_drift", 200.0)], {"voltage_V": RESTED}, False),  # an air that nobody logged does that too
        ([("motor_heating", 200.0)], {"motor_temperature_C": RESTED}, False),
        ([("battery_voltage", 200.0)], {"voltage_V": RESTED}, True),
        ([("battery_voltage", 200.0)], {"lower_voltage_V": RESTED}, True),
        ([("battery_voltage", 200.0)], {"voltage_V": SAGGING}, False),  # the clock's own time profile
    ],
)
def test_a_name_is_taken_where_its_cause_is_recorded(effects, columns, taken):
    posterior = said(*effects)
    answer = agreed(OPEN, posterior, log(**columns))
    assert [e.name for e in answer.effects] == ([effects[0][0]] if taken else [])
    assert bool(answer.unexplained) != taken
    if taken:
        assert answer.effects[0].evidence["method"] == "posterior"


@pytest.mark.parametrize("after", [0.99, 1.01])
def test_a_name_is_taken_where_the_error_falls(after):
    assert agreed(OPEN, said(("rotor_lag", 257.0), after=after), log()) is OPEN
    worse = said(("rotor_lag", 257.0), after=0.8)
    worse.effects[0].rmse["lower_torque"] = (1.0, 1.02)
    assert agreed(OPEN, worse, log()) is OPEN


def test_what_stays_far_above_the_noise_had_another_cause():
    partly = said(("hysteresis", 146.0))
    partly.effects[0].rmse["upper_thrust"] = (9.0, 7.0)
    partly.channels["upper_thrust"] = ChannelError("N", 0.7, 9.0, 7.0, (9.0, 9.0), (7.0, 7.0), 100, 9.0)
    assert agreed(OPEN, partly, log()) is OPEN


def test_rivals_and_flagged_columns_are_taken():
    doubt = Ambiguous(("battery_voltage", "motor_heating"), "")
    assert agreed(OPEN, said(doubts=(doubt,)), log(voltage_V=RESTED)).ambiguous == (doubt,)
    unrecorded = Ambiguous(("motor_heating", "sensor_drift"), "")
    assert agreed(OPEN, said(doubts=(unrecorded,)), log()) is OPEN
    flagged = said(suspects=(Suspect("lower_rpm", "3 to 9", ""),))
    assert agreed(OPEN, flagged, log()) is flagged


def test_numbers_that_physics_does_not_allow_are_no_name():
    allowed = said(("dead_band", 20.0))
    assert agreed(OPEN, allowed, log()).effects
    (found,) = allowed.effects
    bent = replace(found, parameters=(ParameterValue("share", -28.7, (-40.0, -9.0), "1"),))
    assert agreed(OPEN, replace(allowed, effects=(bent,)), log()) is OPEN
    lies = (Suspect("upper_torque_Nm", "10, 20", ""),)
    answer = agreed(OPEN, replace(allowed, effects=(bent,), suspect_data=lies), log())
    assert not answer.effects and answer.suspect_data == lies and answer.unexplained == OPEN.unexplained


def test_a_slow_time_profile_is_the_clocks():
    assert follows_clock(TIME, SAGGING) and not follows_clock(TIME, RESTED)
    assert follows_clock(TIME, np.full(200, 25.0)) and follows_clock(TIME[:3], RESTED[:3])
    assert recorded(["rotor_lag"], log()) and not recorded(["air_density"], log())
