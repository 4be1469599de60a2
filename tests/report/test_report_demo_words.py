"""The demo's sentences, from figures made here: nothing is flown."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from case_table import case_table

from coaxlink.report.demo_words import flown, story
from coaxlink.residual.allocation_error import AllocationErrors, ArmSplit
from coaxlink.residual.result import ChannelError, FoundEffect, Refinement
from coaxlink.studies.flight import PowerMeter
from coaxlink.studies.flight_errors import FlightErrors

CHANNELS = {
    "force_x": ChannelError("N", 0.2, 0.2, 0.2, (0.1, 0.3), (0.1, 0.3), 500, 0.2),
    "force_z": ChannelError("N", 0.2, 8.0, 0.25, (7.0, 9.0), (0.2, 0.3), 500, 8.0),
}


def flight(power_W, height_m=0.02, gain=1.0, left=0.2, upper=30.0, lower=20.0):
    d = AllocationErrors(
        40.0, (0.1, 0.2, 0.3), (ArmSplit(1, 2, upper, lower),), 30.0, floor=(0.15, 0.0, 0.0, 0.0),
        gain=(gain, 1.0, 1.0, 1.0), after_gain=(left, 0.0, 0.0, 0.0),
    )  # fmt: skip
    return FlightErrors(d, (0.1, 0.1, height_m), power_W)


LESS = "on 5.0% less battery power than the standard one (1900 W for 2000 W): +5.3% time in the air"
MORE = "on 5.0% more battery power than the standard one (2100 W for 2000 W): -4.8% time in the air"


def test_the_first_sentence_says_what_it_is_worth_whichever_way_it_goes():
    with case_table() as case:
        for ours, theirs, reported in (
            (1900.0, 2000.0, LESS),
            (2100.0, 2000.0, MORE),
            (2000.0, 2000.4, "on the same battery power (2000 W)"),
            (None, 2000.0, "did not report the power"),
        ):
            with case(f"{ours}, {theirs}, {reported}"):
                assert reported in flown({"standard": flight(theirs), "fitted": flight(ours)})[0]


def test_height_share_and_what_no_gain_takes_off_are_those_of_the_flights():
    standard = flight(2000.0, 0.031, 0.83, 3.54, 30.0, 10.0)
    _, height, left = flown({"standard": standard, "fitted": flight(1900.0, 0.019, 1.0, 0.2, 20.0, 30.0)})
    assert "1.9 cm (standard: 3.1 cm)" in height and "60% of the thrust instead of 25%" in height
    assert "0.83 of what the standard table means and at 1.00" in left
    assert "3.54 N of error are left with the standard table and 0.20 N" in left and "0.15 N" in left


def sentence(refinement):
    off = flight(1900.0)
    off = replace(off, allocation=replace(off.allocation, thrust_error_N=18.0))
    return " ".join(
        story(SimpleNamespace(hidden=off, flights={"fitted": flight(1900.0)}, refinement=refinement))
    )


def test_the_story_names_what_was_found_and_what_it_takes_off():
    found = FoundEffect("battery_voltage", ("force_z",), (), {"force_z": (8.0, 0.25)}, {}, "")
    reported = sentence(Refinement("flight", CHANNELS, (found,), (), (), (), (), None))
    assert "18.00 N of thrust" in reported and "(40.00 N" in reported
    assert "coaxlink found battery_voltage" in reported
    assert (
        "downward force from 8 to 0.25 N (noise alone: 0.2)" in reported and "forward force" not in reported
    )


def test_a_story_without_an_effect_claims_none():
    reported = sentence(Refinement("flight", CHANNELS, (), (), (), (), (), None))
    assert "found" not in reported and "falls" not in reported and "nothing to explain" in reported


def test_what_a_vehicle_spends_before_the_plan_begins_is_no_part_of_its_power():
    pack, battery = PowerMeter(), {"get_type": lambda: "BATTERY_STATUS", "voltages": [4000]}
    pack.hear(SimpleNamespace(**battery, current_battery=9000))  # hovering, not yet let into the mode
    assert pack.mean() is None
    pack.begun = True
    pack.hear(SimpleNamespace(**battery, current_battery=1000))
    assert pack.mean() == pytest.approx(40.0)


def test_a_battery_that_tells_no_current_has_no_power():
    pack = PowerMeter(begun=True)
    battery = {"get_type": lambda: "BATTERY_STATUS", "voltages": [4000, 4000, 65535, 0]}
    pack.hear(SimpleNamespace(**battery, current_battery=-1))
    assert pack.mean() is None
    pack.hear(SimpleNamespace(**battery, current_battery=1000))
    pack.hear(SimpleNamespace(**battery, current_battery=2000))
    pack.hear(SimpleNamespace(get_type=lambda: "HEARTBEAT"))
    assert pack.mean() == pytest.approx(8.0 * 15.0)
