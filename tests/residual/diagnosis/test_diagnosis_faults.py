"""Faults of instruments as explanations: what a limit or a wrong count would make of the readings."""

from __future__ import annotations

import numpy as np
from residual_rig import FULL_RPM, steady_loads

from coaxlink import files
from coaxlink.data import Samples
from coaxlink.residual.diagnosis.faults import _saturated
from coaxlink.residual.diagnosis.stand import stand_channels
from coaxlink.rotor import load_rotor_model


def test_a_load_that_is_low_while_a_rotor_is_held_is_at_no_limit():
    """At a limit the reading stays while the load goes on; here it is the other way round."""
    t = np.arange(600)
    speeds = np.stack([np.where(t < 400, 0.2 + 0.6 * (t % 50) / 50.0, 0.9), 0.3 + 0.5 * (t % 37) / 37.0])
    loads = steady_loads(*speeds)
    loads[0] -= np.where(t < 400, 0.0, 7.0 + 3.0 * np.sin(t / 9.0))
    loads += np.array([[0.4], [0.008], [0.4], [0.008]]) * np.random.default_rng(0).standard_normal((4, 600))
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    rpm = {"upper_rpm": FULL_RPM * speeds[0], "lower_rpm": FULL_RPM * speeds[1]}
    log = Samples({"time_s": 0.1 * t} | rpm | dict(zip(names, loads, strict=True)), "test")
    model = load_rotor_model(files.example("rotor_paper.toml"))
    assert "upper_thrust_N" not in {fault.column for fault in _saturated(stand_channels(log, model))}
