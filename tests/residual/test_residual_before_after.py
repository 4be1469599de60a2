"""What an answer says of its errors and of its names holds together."""

from coaxlink.residual.diagnosis.report import _worse
from coaxlink.residual.result import ChannelError


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
