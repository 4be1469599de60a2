"""The corrections that an effect was fitted beside, back in the rotor model's own terms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.residual.answer.rebased_model import rebased_flight
from coaxlink.rotor import load_rotor_model

UPPER, LOWER = 0.45, 0.65


def flown():
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(airframe.rotor_model)
    speeds = np.tile([UPPER] * 4 + [LOWER] * 4, (50, 1))
    thrust, _ = airframe.loads(model, speeds)
    return SimpleNamespace(airframe=airframe, model=model, speeds=speeds, thrust=thrust, keep=np.arange(50))


def test_levels_slopes_and_wake_come_back_as_they_were_fitted():
    frame = flown()
    fitted = {"upper_thrust_level": 0.02, "upper_thrust_tilt": 0.015, "lower_torque_level": -0.01}
    fitted |= {"lower_thrust_wake": 0.02, "accel_x_bias_m_s2": 0.1}
    changed = rebased_flight(frame, fitted)
    for u, v in ((0.45, 0.65), (0.38, 0.72), (0.55, 0.6)):
        old, new = frame.model.loads(u, v), changed.loads(u, v)
        share = 0.02 + 0.015 * 2 * (u - UPPER)
        assert float(new.upper_thrust) == pytest.approx(float(old.upper_thrust) * (1 + share), rel=2e-3)
        wake = 0.02 * 2 * (u - UPPER)
        assert float(new.lower_thrust) == pytest.approx(float(old.lower_thrust) * (1 + wake), rel=3e-3)
        assert float(new.lower_torque) == pytest.approx(float(old.lower_torque) * 0.99, rel=1e-6)
        assert float(new.upper_torque) == float(old.upper_torque)
    assert changed.terms()["lower.thrust_N"].keys() == frame.model.terms()["lower.thrust_N"].keys()


def test_a_torque_is_the_one_that_belongs_to_the_declared_inertia():
    frame = flown()
    changed = rebased_flight(frame, {"upper_torque_level": -0.02, "inertia_z_share": -0.05})
    for load in ("upper_torque", "lower_torque"):
        level = 0.98 if load == "upper_torque" else 1.0
        old, new = (float(getattr(m.loads(UPPER, LOWER), load)) for m in (frame.model, changed))
        assert new == pytest.approx(old * level / 0.95, rel=1e-6)


def test_a_bias_downward_is_thrust_that_is_missing():
    frame = flown()
    changed = rebased_flight(frame, {"accel_z_bias_m_s2": 0.05})
    old, new = (frame.airframe.loads(m, frame.speeds[0])[0].sum() for m in (frame.model, changed))
    assert new - old == pytest.approx(-0.05 * frame.airframe.mass_kg, rel=1e-6)


def test_without_corrections_the_model_is_the_same():
    frame = flown()
    assert rebased_flight(frame, {}) == replace(frame.model)
