"""Which recorded variables are one as far as this log can tell: read from its columns, before any nats."""

from __future__ import annotations

import numpy as np

from coaxlink.frames import Array
from coaxlink.residual.diagnosis.channels import LOADS, Channels
from coaxlink.residual.diagnosis.hypotheses import Hypothesis
from coaxlink.signals import without_row_noise

METER = 0.01  # of its range: what a recorded variable errs by (instruments of class 1, IEC 60051)


def own_cause(ch: Channels, h: Hypothesis, name: str, form: str) -> bool:
    """Whether a free form runs over the variable that an effect comes from."""
    variable, channel, *_ = form.split("|")
    m = next(m for m in h.members if m.name == name)
    label, cause = m.effect.cause(ch.bare, m.shape, ch.names[0] if channel == LOADS else channel)
    values = np.asarray(cause, float)[ch.frame.keep]
    if " " in variable:  # the sum or difference of speeds holds either
        return any(same_variable(values, ch.variables[v]) for v in variable.split(" ")[::2])
    other = ch.variables.get(variable)
    return other is not None and (label == variable or same_variable(values, other))


def same_variable(values: Array, other: Array) -> bool:
    """Whether one of two variables (rows,) is a straight function of the other within its meter's error."""
    if np.ptp(values) <= 0.0 or np.ptp(other) <= 0.0:
        return False
    along = other - np.mean(other)
    about = values - np.mean(values)
    slope = float(about @ along) / float(along @ along)
    noise = np.std(values - without_row_noise(values)), slope * np.std(other - without_row_noise(other))
    return bool(np.std(about - slope * along) <= METER * np.ptp(values) + np.hypot(*noise))
