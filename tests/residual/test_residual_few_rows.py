"""Stand logs of a few rows: what they tell, what they do not, and what is asked for instead."""

import numpy as np
import pytest
from residual_rig import run, steady_loads
from residual_stand_logs import log_of, names

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand


def test_too_few_rows_for_a_load_over_both_speeds_judge_the_other_loads():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0.2, 0.95, (2, 20))
    answer = refine_stand(log_of(2.0 * np.arange(20), a, b, steady_loads(a, b)))
    assert set(answer.channels) == {"upper_thrust", "upper_torque"}
    assert any(note.startswith("lower_thrust, lower_torque: not judged (20 rows") for note in answer.notes)
    alone = Samples({k: v for k, v in run().items() if not k.startswith("upper_t")}, "rig.csv")
    with pytest.raises(InputError, match=r"lower_thrust, lower_torque: 20 rows, .*rotor model"):
        refine_stand(alone.take(np.arange(0, 240, 12)))


@pytest.mark.slow
def test_one_rotor_at_two_supplies_shows_what_the_voltage_does():
    """Ten throttles at four cells and at three: as many rows as a maker's sheet has."""
    rng = np.random.default_rng(4)
    throttle = np.tile(np.linspace(0.1, 1.0, 10), 2)
    volts = np.repeat([16.2, 12.1], 10) - 0.9 * throttle**2
    turned = throttle * volts / 16.2
    thrust = 22.0 * turned**2 + 2.0 * turned + 0.03 * rng.standard_normal(20)
    columns = {"time_s": 2.0 * np.arange(20), "upper_throttle": throttle, "voltage_V": volts}
    answer = refine_stand(Samples({**columns, "upper_thrust_N": thrust}, "sheet.csv"))
    reported = names(answer) or list(answer.ambiguous[0].names)
    assert reported[0] == "battery_voltage"
