"""Rotors that nothing can fly with are one line of every door that makes a vehicle of files."""

from __future__ import annotations

from pathlib import Path

import pytest

from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.vehicle import load_rotors, load_vehicle
from sim.errors import SimulationError
from sim.simulation import Simulation, build_plant

FRAME = example("x8_demo.toml").read_text()
ROTORS = example("rotor_paper.toml").read_text()
SPLIT = '"u_u^2" = 1.2437\n"u_u" = 0.7155'
TORQUES = {  # what stands for the upper rotor's torque: what the error names
    '"u_u^2" = 0.0': "upper.torque_Nm",
    '"u_u^2" = -8.5': "upper.torque_Nm",
    '"u_u" = 1.0\n"u_u^2" = -1.2': "upper.torque_Nm",  # driven below 0.83 of full speed only
}


def files(folder: Path, frame: str = FRAME, rotors: str = ROTORS) -> Path:
    (folder / "rotor_paper.toml").write_text(rotors)
    path = folder / "frame.toml"
    path.write_text(frame)
    return path


@pytest.mark.parametrize("torque", TORQUES)
def test_a_rotor_that_turns_by_itself_is_refused(tmp_path: Path, torque: str) -> None:
    assert SPLIT in ROTORS
    path = files(tmp_path, rotors=ROTORS.replace(SPLIT, torque))
    for door in (load_rotors, load_vehicle):
        with pytest.raises(
            InputError, match=rf"rotor_paper\.toml: {TORQUES[torque]}: .* found -?[0-9.]+ N m"
        ):
            door(path if door is load_vehicle else tmp_path / "rotor_paper.toml")
    with pytest.raises(SimulationError, match=r"upper\.torque_Nm"):
        build_plant(Simulation(path))


def test_a_lower_rotor_that_turns_by_itself_is_refused(tmp_path: Path) -> None:
    lower = ROTORS.replace('"u_l^2" = 1.466', '"u_l^2" = -1.466')
    with pytest.raises(InputError, match=r"lower\.torque_Nm: a lower rotor"):
        load_vehicle(files(tmp_path, rotors=lower))
    with pytest.raises(SimulationError, match=r"lower\.torque_Nm"):
        build_plant(Simulation(tmp_path / "frame.toml"))


@pytest.mark.parametrize(
    ("frame", "lost"),
    [
        (FRAME.replace("0.1807", "0.0"), "roll, pitch"),
        (FRAME.replace(", 0.1807, ", ", 0.0, ").replace(", -0.1807, ", ", 0.0, "), "roll"),
        (FRAME.replace('"cw"', '"ccw"'), "yaw"),
    ],
)
def test_rotors_that_lack_an_axis_are_refused(tmp_path: Path, frame: str, lost: str) -> None:
    with pytest.raises(InputError, match=rf"frame\.toml: rotors: these rotors cannot make {lost}, whatever"):
        load_vehicle(files(tmp_path, frame))
    if lost != "yaw":
        with pytest.raises(SimulationError, match=r"rotors\.position_m: rotors on one point or one line"):
            build_plant(Simulation(tmp_path / "frame.toml"))
