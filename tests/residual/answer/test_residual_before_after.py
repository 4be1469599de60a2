"""What an answer says of its errors and of its names holds together."""

from types import SimpleNamespace

from coaxlink.residual.answer.assemble import _evidence, _worse
from coaxlink.residual.checks.posterior_check import undone
from coaxlink.residual.result import ChannelError, Step
from coaxlink.residual.search.select import Selection


def added(name):
    return Step(1, "add", name, 100.0, 1e-6, 0.05, True, "best on held-out blocks")


def error(before, after, floor=1.0):
    return ChannelError("N", floor, before, after, (0.0, 9.0), (0.0, 9.0), 100, before)


def test_a_drop_that_was_not_taken_leaves_the_trace_and_the_probability_alone():
    chosen = Selection(members=[SimpleNamespace(name="sensor_drift")], trace=[added("sensor_drift")])
    tried = undone(chosen, {"sensor_drift"}, "needless beside something else")
    assert [s.action for s in tried.trace] == ["add", "drop"] and not tried.members
    assert [s.action for s in chosen.trace] == ["add"] and chosen.members


def test_a_claim_is_as_probable_as_the_step_that_took_it_says():
    """A claim of a real log was printed with probability 0: a later line of the trace says "drop"."""
    dropped = Step(9, "drop", "sensor_drift", 0.0, 1.0, 0.0, True, "not needed in the joint fit")
    judged = SimpleNamespace(
        selection=Selection(trace=[added("sensor_drift"), dropped]), ahead={"sensor_drift": (11.5,)}, known=()
    )
    said = _evidence(judged, "sensor_drift")
    assert said["probability"] > 0.97 and said["p_value"] == 1e-6


def test_a_channel_that_errs_more_with_the_effects_is_told():
    channels = {
        "upper_thrust": error(4.0, 1.1),
        "upper_torque": error(2.0, 2.2),
        "lower_torque": error(0.5, 0.9),  # noise, before and after
        "lower_thrust": error(2.0, 2.01),
    }
    assert _worse(channels) == ("errs more with the effects than without: upper_torque by 10 %",)
    assert _worse({"upper_thrust": error(4.0, 1.1)}) == ()
