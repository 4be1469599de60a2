"""The joint fit about its members, and what it says of each of them."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import steady_loads
from residual_stand_logs import log_of, model, ramps

from coaxlink.effects.hysteresis import STAND as HYSTERESIS
from coaxlink.frames import STAND_CHANNELS
from coaxlink.residual.channels.stand import base_corrections, stand_frame
from coaxlink.residual.channels.stand_problem import reducing
from coaxlink.residual.regression.irls import channel_errors
from coaxlink.residual.regression.joint_model import Fitter, member
from coaxlink.residual.regression.problem import build

NOISE = np.array([0.3, 0.006, 0.3, 0.006])
ALIKE = {"thrust_share": 1.0, "torque_share": 1.0}
WORN = {**ALIKE, "reach": 0.1, "spread": 1.8}


def worn_in(size, strange):
    """A rig's friction of `size` of the load, and `strange` N that no friction makes, on the upper rotor."""
    t, a, b = ramps(1260)
    loads = steady_loads(a, b)
    way = np.sign(np.gradient(a))
    loads[0] += strange * np.sin(0.7 * loads[0]) - 0.5 * size * loads[0] * way
    frame = stand_frame(log_of(t, a, b, loads), model())
    reduce, names = reducing(frame), [STAND_CHANNELS[c] for c in frame.present]
    problem = build(
        frame=frame, channels=names, units=["1"] * len(names), reference=frame.reference[list(frame.present)],
        residual=reduce(frame.measured - frame.predicted), sigma=NOISE,
        corrections=[(name, bound, reduce(columns)) for name, bound, columns in base_corrections(frame)],
        effects=[HYSTERESIS], reduce=reduce, block=np.arange(len(frame.keep)) // 60,
    )  # fmt: skip
    return frame, problem


@pytest.mark.parametrize("shape", [WORN, {**WORN, "fading": 0.4}, ALIKE])
def test_without_a_members_columns_the_problem_is_the_one_before_it(shape):
    frame, problem = worn_in(0.03, 0.0)
    fitter = Fitter(problem, frame, (), reducing(frame))
    joint = fitter.linear([member(frame, HYSTERESIS, shape, np.array([0.04, 0.01]))])
    assert len(joint.problem.options[0].columns) == 2 + len({"reach", "spread", "fading"} & set(shape))
    assert channel_errors(joint.problem, []) == pytest.approx(channel_errors(problem, []), rel=1e-6)
    assert channel_errors(joint.problem, joint.problem.options)[0] < 0.95 * channel_errors(problem, [])[0]
