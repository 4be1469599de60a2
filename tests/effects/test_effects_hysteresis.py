"""What a stand remembers, however its points were visited."""

from __future__ import annotations

import numpy as np
import pytest
from residual_rig import FULL_RPM, steady_loads

from coaxlink.channels.stand import stand_frame
from coaxlink.data import Samples
from coaxlink.effects import hysteresis

LOADS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


@pytest.mark.parametrize("rotor", ["upper", "lower"])
def test_a_cell_with_play_remembers_its_load_on_points_visited_in_random_order(rotor: str) -> None:
    random = np.random.default_rng(7)
    speeds = random.uniform(0.2, 0.95, (140, 2))
    loads = steady_loads(*speeds.T)
    cell = 2 * ("upper", "lower").index(rotor)
    play, at, behind = 0.035 * float(np.ptp(loads[cell])), loads[cell, 0], []
    for load in loads[cell]:
        at = min(max(at, load - play), load + play)
        behind.append(at - load)
    read = FULL_RPM * speeds + 2.0 * random.standard_normal(speeds.shape)
    columns = {"upper_rpm": read[:, 0], "lower_rpm": read[:, 1], **dict(zip(LOADS, loads, strict=True))}
    frame = stand_frame(Samples(columns, "map"), None)
    numbers = {rotor: 1.0, "load": 1.0, "power": 0.0, "reach": 0.06, "spread": 1.8}
    added = hysteresis.STAND.contribution(frame, numbers | {"thrust_share": 0.1, "torque_share": 0.0})
    assert np.corrcoef(added[:, cell], behind)[0, 1] > 0.9
    assert not np.any(added[:, 2 - cell])  # the other rotor's slide is another one
