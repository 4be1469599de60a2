"""What a meter's noise is, and what is a supply that changes indeed."""

import numpy as np
import pytest

from coaxlink.channels.stand import ANY, stand_frame
from coaxlink.data import Samples
from coaxlink.files import example
from coaxlink.residual.diagnosis.meters import calmed
from coaxlink.rotor import load_rotor_model


@pytest.mark.parametrize(("spread_V", "kept"), [(0.05, False), (2.0, True)])
def test_a_supply_that_is_set_anew_at_every_point_is_no_noise_of_its_meter(spread_V, kept):
    rng, rows = np.random.default_rng(5), 81
    model = load_rotor_model(example("rotor_paper.toml"))
    u, v = (x.ravel() for x in np.meshgrid(*[np.linspace(0.2, 0.9, 9)] * 2))
    loads = model.loads(u, v)
    volts = 23.0 + rng.uniform(-spread_V, spread_V, rows)
    columns = {"time_s": 2.0 * np.arange(rows), "upper_throttle": u, "lower_throttle": v, "voltage_V": volts}
    columns |= {"upper_thrust_N": loads.upper_thrust, "lower_thrust_N": loads.lower_thrust}
    columns |= {"upper_torque_Nm": loads.upper_torque, "lower_torque_Nm": loads.lower_torque}
    frame = calmed(stand_frame(Samples(columns, "log"), model, ANY, None))
    assert np.allclose(frame.context("voltage_V"), volts) == kept
