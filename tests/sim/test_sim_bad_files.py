"""What a file or an option says wrong is one clear line that names it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sim.documents import write_atomic
from sim.errors import SimulationError
from sim.line.wire import parse_faults
from sim.manoeuvres import read_plan
from sim.physics.rotors import read_pair
from sim.simulation import Simulation, build
from sim.stand.effects import read_bench
from sim.stand.schedule import read_schedule
from sim.truth import read_truth
from sim.vehicle import read_vehicle

PIECE = "[[pieces]]\nseconds = 5\n"
STEADY = PIECE + "upper = 0.1\nlower = 0.5\n"
ROTOR = "speed_max_rpm = 5400.0\n[upper.thrust_N]\n"
BEMT = 'form = "bemt"\nspeed_max_rpm = 5000.0\n'
X8 = Path(__file__).parents[2] / "examples" / "x8_demo.toml"


def read_memory(path: Path) -> object:
    return build(Simulation(X8, memory=path), [])


def flown(path: Path) -> object:
    return build(Simulation(X8, truth=path), [])


BAD = [  # reader, text, what the error names
    (read_schedule, "", "pieces"),
    (read_schedule, "[[pieces]]\nupper = 0.5\nlower = 0.5\n", "seconds"),
    (read_schedule, PIECE + "upper = 1.5\nlower = 0.5\n", "upper"),
    (read_schedule, PIECE + "upper = [0, 1, 0]\nlower = 0.5\n", "upper"),
    (read_schedule, STEADY + "volts = 3\n", "volts"),
    (read_schedule, STEADY + 'shape = "sine"\n', "shape"),
    (read_schedule, "[[pieces]]\nseconds = 9999\nupper = 0.1\nlower = 0.5\n", "pieces"),
    (read_schedule, "rate_hz = 0\n" + STEADY, "rate_hz"),
    (read_schedule, STEADY + "supply_V = -3\n", "supply_V"),
    (read_plan, "", "pieces"),
    (read_plan, "[[pieces]]\nnorth_m = 1\n", "seconds"),
    (read_plan, PIECE + "height_m = 0.1\n", "height_m"),
    (read_plan, PIECE + "north = 3\n", "north"),
    (read_plan, PIECE + "north_m = 3\ncycles = 40\n", "cycles"),
    (read_plan, PIECE + "north_m = 300\n", "north_m"),
    (read_pair, ROTOR + '"u_u^2" = "x"', "upper.thrust_N.u_u^2"),
    (read_pair, ROTOR + '"u_q" = 1', "upper.thrust_N.u_q"),
    (read_pair, ROTOR + '"u_u^9" = 1', "powers up to"),
    (read_pair, ROTOR + '"u_u" = nan', "found nan"),
    (read_pair, ROTOR + '"u_u" = 1e39', "within 1e+09"),
    (read_vehicle, X8.read_text().replace("0.1807", "1e39"), "position_m"),
    (read_vehicle, X8.read_text().replace("spin =", "axis = [0, 0, 0]\nspin ="), "rotors.axis"),
    (
        read_vehicle,
        X8.read_text().replace("mass_kg = ", "mass_kg = 1e6 #"),
        "mass_kg: 1e+06: 0.005 to 2",
    ),
    (read_vehicle, X8.read_text().replace("mass_kg = ", "mass_kg = 1e-9 #"), "mass_kg"),
    (read_vehicle, X8.read_text().replace("lag_s = ", "lag_s = 1e4 #"), "motor_lag_s: 10000: 0 to 2 s"),
    (read_vehicle, X8.read_text().replace("lag_s = ", "lag_s = -0.1 #"), "motor_lag_s"),
    (flown, '[[effects]]\nname = "mass_change"\nsize = -500', "mass_kg: -4"),
    (flown, '[[effects]]\nname = "rotor_lag"\nsize = 30', "motor_lag_s: 30"),
    (read_pair, BEMT, "blades"),
    (read_pair, BEMT + "[blades]\nradius_m = 1.0", "blades"),
    (read_pair, BEMT + "[blades]\nwings = 2", "blades"),
    (read_pair, BEMT + '[blades]\nradius_m = "wide"', "blades"),
    (read_truth, '[[effects]]\nname = "magic"\nsize = 1', "effects[1].name"),
    (read_truth, '[[effects]]\nname = "wind"\nsize = "big"', "effects[1].size"),
    (read_truth, '[[effects]]\nname = "wind"\nsize = 1\nrotor = 2', "effects[1].rotor"),
    (read_truth, '[[effects]]\nname = "wind"\nsize = 1\nlaw = "breezy"', "steady, shear"),
    (read_truth, "effects = 3", "effects"),
    (read_truth, "= 3", "not TOML"),
    (read_bench, '[[effects]]\nname = "wind"\nsize = 1', "effects[1].name"),
    (read_bench, '[[effects]]\nname = "strange"\nsize = 1\nchannel = "left"', "effects[1].channel"),
    (read_bench, '[[effects]]\nname = "hysteresis"\nsize = 0.1\nlaw = "magic"', "share, friction"),
    (read_bench, '[stand]\npattern = "waltz"', "stand"),
    (read_memory, "", "no memory of a stand-in"),
    (read_memory, "[]", "no memory of a stand-in"),
    (read_memory, '{"parameters": {}}', "no memory of a stand-in"),
    (read_memory, '{"parameters": {}, "files": 3, "folders": []}', "no memory of a stand-in"),
]


@pytest.mark.slow
def test_a_bad_file_is_one_clear_line_that_names_what_is_wrong(tmp_path: Path) -> None:
    path, wrong = tmp_path / "x.toml", []
    for reader, text, named in BAD:
        path.write_text(text)
        try:
            reader(path)
            wrong.append((text, "taken"))
        except SimulationError as error:
            if named not in str(error) or "\n" in str(error):
                wrong.append((text, str(error)))
    assert not wrong


def test_a_bad_fault_of_the_wire_is_one_clear_line() -> None:
    for text in ("loss", "loss=2", "noise=1", "dead=3", "delay=-1"):
        with pytest.raises(SimulationError, match=r"^[^\n]*expected[^\n]*$"):
            parse_faults(text)


def test_only_a_regular_file_is_replaced(tmp_path: Path) -> None:
    pipe, file, link = tmp_path / "pipe", tmp_path / "file", tmp_path / "link"
    os.mkfifo(pipe)
    file.write_text("before")
    link.symlink_to(file)
    for place in (pipe, Path("/dev/full")):
        with pytest.raises(SimulationError, match="only a file is written"):
            write_atomic(place, "now")
    write_atomic(link, "now")
    assert file.read_text() == "now" and link.is_symlink() and pipe.is_fifo()
