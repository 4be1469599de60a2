"""Stand logs of a few rows: what they tell, what they do not, and what is asked for instead."""

import numpy as np
import pytest
from residual_rig import run, steady_loads
from residual_stand_logs import log_of, names

from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.residual import refine_stand


@pytest.mark.parametrize("rows", [24, 28, 34])
def test_a_sound_pair_in_few_rows_has_no_effect(rows):
    """A lower load that nothing was fitted to is no residual (a `sensor_drift` in 1 of 8 such logs)."""
    rng = np.random.default_rng(rows)
    for seed in range(4):
        a, b = rng.uniform(0.2, 0.95, (2, rows))
        answer = refine_stand(log_of(2.0 * np.arange(rows), a, b, steady_loads(a, b), seed=seed))
        assert names(answer) == [] and answer.ambiguous == () and answer.suspect_data == (), seed
        # the lower loads follow the speeds, in a log too short for all that they do
        error = answer.channels["lower_thrust"]
        assert error.rmse_before < 0.3 * np.std(steady_loads(a, b)[2])


def test_too_few_rows_for_a_load_over_both_speeds_judge_the_other_loads():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0.2, 0.95, (2, 20))
    answer = refine_stand(log_of(2.0 * np.arange(20), a, b, steady_loads(a, b)))
    assert set(answer.channels) == {"upper_thrust", "upper_torque"}
    assert any(note.startswith("lower_thrust, lower_torque: not judged (20 rows") for note in answer.notes)
    alone = Samples({k: v for k, v in run().items() if not k.startswith("upper_t")}, "rig.csv")
    with pytest.raises(InputError, match=r"lower_thrust, lower_torque: 20 rows, .*rotor model"):
        refine_stand(alone.take(np.arange(0, 240, 12)))


def test_one_rotor_at_two_supplies_shows_what_the_voltage_does():
    """Ten throttles at four cells and at three: as many rows as a maker's sheet has."""
    rng = np.random.default_rng(4)
    throttle = np.tile(np.linspace(0.1, 1.0, 10), 2)
    volts = np.repeat([16.2, 12.1], 10) - 0.9 * throttle**2
    turned = throttle * volts / 16.2
    thrust = 22.0 * turned**2 + 2.0 * turned + 0.03 * rng.standard_normal(20)
    columns = {"time_s": 2.0 * np.arange(20), "upper_throttle": throttle, "voltage_V": volts}
    answer = refine_stand(Samples({**columns, "upper_thrust_N": thrust}, "sheet.csv"))
    assert names(answer) == ["battery_voltage"]
