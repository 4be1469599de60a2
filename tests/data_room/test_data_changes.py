"""A parameter that changes while a log runs is read with each value in its own time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coaxlink.data import read_flight_log
from coaxlink.data.logs.changes import periods
from coaxlink.files import example
from sim.simulation import Simulation, build_plant

CURVES = {250: 0.9, 420: 0.2}  # THR_MDL_FAC from that step on


def test_moments_of_changes() -> None:
    changes = [(7.0, "MPC_XY_P", 1.0), (9.0, "THR_MDL_FAC", 0.0), (5.0, "THR_MDL_FAC", 0.3),
               (5.0, "PWM_MAIN_FUNC2", 102.0), (8.0, "THR_MDL_FAC", 0.3)]  # fmt: skip
    found = periods({"THR_MDL_FAC": 1.0}, changes)
    assert [(p.since_s, p.until_s, p.why) for p in found] == [
        (-np.inf, 5.0, ""),
        (5.0, 9.0, "THR_MDL_FAC 1 to 0.3, PWM_MAIN_FUNC2 102"),
        (9.0, np.inf, "THR_MDL_FAC 0.3 to 0"),
    ]
    assert found[1].parameters == {"THR_MDL_FAC": 0.3, "PWM_MAIN_FUNC2": 102.0}


@pytest.mark.slow
def test_a_curve_changed_in_flight_is_undone_from_there_on(tmp_path: Path) -> None:
    """PX4: the pulses, which stand behind the curve, are what the commands have to be."""
    from sim.px4.autopilot import Autopilot
    from sim.px4.logger import UlogLogger

    plant, truth = build_plant(Simulation(example("x8_demo.toml")))
    pilot = Autopilot(plant, truth, version=(1, 16, 1), seed=0)
    UlogLogger(pilot)
    pilot.store.preset("SDLOG_MODE", 2)
    pilot.boot()
    pilot.arm()
    pilot.take_off(2.0)
    pulses = []
    for step in range(600):
        if step in CURVES:
            pilot.store.write("THR_MDL_FAC", 9, CURVES[step])
        pilot.step()
        pilot.logger.record(1_000_000 + round(1e6 * plant.time_s))
        pulses.append(np.mean(pilot.outputs_us[:8]))
    path = tmp_path / "flight.ulg"
    path.write_bytes(bytes(pilot.files.files[pilot.logger.logs()[-1]]))
    log = read_flight_log(path)
    command = np.mean([log[f"motor{n}"] for n in range(1, 9)], axis=0)
    meant = np.interp(log["time_s"], 1.004 + 0.004 * np.arange(600), (np.array(pulses) - 1000.0) / 1000.0)
    for start, end in ((1.5, 2.0), (2.1, 2.7), (2.8, 3.4)):  # outside the steps, which rows of 10 Hz miss
        held = (log["time_s"] > start) & (log["time_s"] < end)
        assert np.median(np.abs(command - meant)[held]) < 0.01
    assert any("THR_MDL_FAC 0.9 to 0.2" in note for note in log.notes)
