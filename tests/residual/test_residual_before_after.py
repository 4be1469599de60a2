"""What an answer says of its errors and of its names holds together."""

from dataclasses import replace

import pytest

from coaxlink.report.refine import above_floor, verdict
from coaxlink.residual.answer.report import _worse
from coaxlink.residual.result import ChannelError, Refinement


def error(before, after, floor=1.0):
    return ChannelError("N", floor, before, after, (0.0, 9.0), (0.0, 9.0), 100, before)


def test_a_channel_that_errs_more_with_the_effects_is_told():
    channels = {
        "upper_thrust": error(4.0, 1.1),
        "upper_torque": error(2.0, 2.2),
        "lower_torque": error(0.5, 0.9),  # noise, before and after
        "lower_thrust": error(2.0, 2.01),
    }
    assert _worse(channels) == ("errs more with the effects than without: upper_torque by 10 %",)
    assert _worse({"upper_thrust": error(4.0, 1.1)}) == ()


def held(channels):
    return Refinement("stand", channels, (), (), (), (), (), None)


def test_corrections_that_err_more_than_the_model_as_given_leave_nothing() -> None:
    """Of few rows they follow the noise: what a public map's second run of 14 rows "left" was 13 times it."""
    few = ChannelError("N", 0.3, 4.0, 4.0, (0.0, 9.0), (0.0, 9.0), 14, 0.32)
    answer = held({"lower_thrust": few})
    assert above_floor(answer) == {}
    assert verdict(answer).startswith("nothing to explain")
    left = held({"lower_thrust": replace(few, rmse_as_given=4.2)})
    assert above_floor(left) == pytest.approx({"lower_thrust": 4.0 / 0.3})
