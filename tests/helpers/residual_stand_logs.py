"""Stand logs of a pair of rotors by its own numbers, for the tests of `coaxlink.residual`."""

from __future__ import annotations

import numpy as np
from residual_rig import FULL_RPM

from coaxlink.data.samples import Samples
from coaxlink.rotor import RotorModel

NOISE = np.array([[0.3], [0.006], [0.3], [0.006]])
TERMS = {
    "upper.thrust_N": {"u_u^2": 55.9517, "u_u": 22.4464},
    "upper.torque_Nm": {"u_u^2": 1.2437, "u_u": 0.7155},
    "lower.thrust_N": {
        "u_l^2": 64.721, "u_l": 12.402, "1": 0.801,
        "u_u^2 u_l^2": 2.755, "u_u u_l": -2.547, "u_u^2": -37.502,
    },
    "lower.torque_Nm": {"u_u u_l^2": 0.307, "u_l^2": 1.466, "u_l": 0.573, "u_u^2": -0.695},
}  # fmt: skip


def model():
    return RotorModel.from_terms("crm", FULL_RPM, TERMS)


def ramps(rows=900):
    """(rows,) times and both speeds: triangles of two periods, up and down."""
    t = 0.1 * np.arange(rows)

    def triangle(period):
        return 0.9 * np.abs(((t / period) % 2.0) - 1.0)

    return t, 0.9 - triangle(15.0), 0.9 - triangle(6.1)


def log_of(t, a, b, loads, seed=0, **more):
    rng = np.random.default_rng(seed)
    loads = loads + NOISE * rng.standard_normal(loads.shape)
    names = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
    columns = {"time_s": t, "upper_rpm": FULL_RPM * a, "lower_rpm": FULL_RPM * b}
    columns |= dict(zip(names, loads, strict=True)) | more
    return Samples(columns, "stand", ())


def names(answer):
    return sorted(e.name for e in answer.effects)


def over(answer):
    return max(c.rmse_after / c.noise_floor for c in answer.channels.values())
