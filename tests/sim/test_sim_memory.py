"""What a stand-in still knows after its plug was pulled."""

import time
from pathlib import Path

import pytest

from sim.simulation import Simulation, build

X8 = Path(__file__).parents[2] / "examples" / "x8_demo.toml"
FLOAT = 9


def _boot(memory, firmware="px4", clock=time.monotonic):
    return build(Simulation(X8, firmware=firmware, memory=memory), [], clock=clock)


@pytest.mark.slow
def test_px4_saves_late_or_when_it_is_told_to(tmp_path):
    memory = tmp_path / "memory.json"
    first = _boot(memory)
    first.autopilot.store.write("CA_ROTOR0_CT", FLOAT, 30.0)
    first.tick()
    assert _boot(memory).autopilot.store["CA_ROTOR0_CT"] == 6.5
    first.autopilot.keep()
    again = _boot(memory)
    assert again.autopilot.store["CA_ROTOR0_CT"] == 30.0
    assert again.autopilot.mixer.mix.effectiveness[5, 0] == -30.0  # and flies it


@pytest.mark.slow
def test_px4_s_own_save_comes_a_moment_after_the_change(tmp_path):
    clock = [100.0]
    memory = tmp_path / "memory.json"
    board = _boot(memory, clock=lambda: clock[0])

    def after_restart(after_s):
        clock[0] += after_s
        board.tick()
        return _boot(memory).autopilot.store["CA_ROTOR0_CT"]

    board.autopilot.store.write("CA_ROTOR0_CT", FLOAT, 30.0)
    assert (after_restart(0.29), after_restart(0.02)) == (6.5, 30.0)
    board.autopilot.store.write("CA_ROTOR0_CT", FLOAT, 31.0)  # not twice within two seconds
    assert (after_restart(1.9), after_restart(0.2)) == (30.0, 31.0)


@pytest.mark.slow
def test_ardupilot_keeps_values_scripts_and_what_they_added_at_once(tmp_path):
    memory = tmp_path / "memory.json"
    board = _boot(memory, "ardupilot").autopilot
    board.store.write("SCR_ENABLE", 1.0)
    board.files.make("scripts")
    text = b"param:add_table(7, 'ABC_', 1) param:add_param(7, 1, 'D', 2.5)"
    assert board.files.begin("/APM/scripts/a.lua", text)
    standin = _boot(memory, "ardupilot")
    assert standin.autopilot.store["SCR_ENABLE"] == 0.0  # nothing ran that could have kept it
    board = standin.autopilot
    board.store.write("SCR_ENABLE", 1.0)
    board.files.make("scripts")
    board.files.begin("/APM/scripts/a.lua", text)
    standin.tick()
    standin = _boot(memory, "ardupilot")
    assert "ABC_D" not in standin.autopilot.store  # MAVLink is served before scripts run
    _until_scripts_run(standin)
    assert standin.autopilot.store["ABC_D"] == 2.5
    standin.autopilot.store.write("ABC_D", 4.0)
    standin.tick()
    again = _boot(memory, "ardupilot")
    _until_scripts_run(again)
    assert again.autopilot.store["ABC_D"] == 4.0


def _until_scripts_run(standin):
    for _ in range(round(250 * 2.1)):
        standin.autopilot.step()


@pytest.mark.slow
def test_ardupilot_counts_its_starts_and_only_saves_what_it_saves(tmp_path):
    memory = tmp_path / "memory.json"
    standin = _boot(memory, "ardupilot")
    store = standin.autopilot.store
    first = store["STAT_BOOTCNT"]
    store.live("MOT_THST_HOVER", 0.3)
    store.write("PILOT_SPEED_UP", 260.0)
    standin.tick()
    again = _boot(memory, "ardupilot").autopilot.store
    assert again["STAT_BOOTCNT"] == first + 1
    assert again["MOT_THST_HOVER"] != pytest.approx(0.3)  # was at work, was not saved
    store.live("MOT_THST_HOVER", 0.3)
    store.save("MOT_THST_HOVER")
    standin.tick()
    assert _boot(memory, "ardupilot").autopilot.store["MOT_THST_HOVER"] == pytest.approx(0.3)
