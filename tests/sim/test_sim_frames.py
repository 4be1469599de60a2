"""A stand-in boots with its vehicle's own frame, or says in one line that its firmware has none."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from sim_pilot import Pilot

from sim.ardupilot.store import ArduPilotStore
from sim.errors import SimulationError
from sim.simulation import Simulation, build
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[2] / "examples"
# from ArduPilot's motor order diagrams: the arm of motor 1, 2, ... (degrees from the nose, clockwise), those
# that turn counter-clockwise, those on top
X8 = ((45, -45, -135, 135, -45, 45, 135, -135), {1, 3, 5, 7}, {1, 2, 3, 4})
X8_CW = ((45, 45, 135, 135, -135, -135, -45, -45), {1, 4, 5, 8}, {1, 3, 5, 7})
PLUS8 = ((0, -90, 180, 90, -90, 0, 90, 180), {1, 3, 5, 7}, {1, 2, 3, 4})
Y6A = ((60, -60, -60, 180, 60, 180), {1, 3, 6}, {1, 2, 6})
Y6B = ((60, 60, 180, 180, -60, -60), {2, 4, 6}, {1, 3, 5})
Y6F = ((180, 60, -60, 180, 60, -60), {1, 2, 3}, {1, 2, 3})
TWELVE = (
    (30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30),
    {1, 4, 5, 8, 9, 12},
    {1, 3, 5, 7, 9, 11},
)
KNOWN = [
    (X8, 4, 1), (X8_CW, 4, 14), (PLUS8, 4, 0), (Y6A, 5, 1), (Y6B, 5, 10), (Y6F, 5, 11), (TWELVE, 12, 1),
]  # fmt: skip


def airframe(path, frame, *, mass=12.0, renumbered=lambda n: n):
    """A vehicle file with arms of 0.4 m."""
    angles, ccw, top = frame
    number = {n: renumbered(n) for n in range(1, len(angles) + 1)}
    lines = [f"mass_kg = {mass}", "inertia_kg_m2 = [0.4, 0.4, 0.7]", "motor_lag_s = 0.04"]
    lines.append(f'rotor_model = "{EXAMPLES / "rotor_paper.toml"}"')
    for n, angle in enumerate(angles, 1):
        pair = next(k for k, other in enumerate(angles, 1) if other == angle and k != n)
        x, y = (0.4 * f(math.radians(angle)) for f in (math.cos, math.sin))
        lines += ["[[rotors]]", f"number = {number[n]}", f"pair = {number[pair]}"]
        lines += [f"position_m = [{x:.4f}, {y:.4f}, {-0.08 if n in top else 0.08}]"]
        lines += [f'spin = "{"ccw" if n in ccw else "cw"}"', f'level = "{"upper" if n in top else "lower"}"']
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(("frame", "number", "kind"), KNOWN)
def test_arducopters_frames_are_known_by_their_rotors(frame, number, kind, tmp_path):
    store = ArduPilotStore(read_vehicle(airframe(tmp_path / "a.toml", frame)))
    assert (store["FRAME_CLASS"], store["FRAME_TYPE"]) == (number, kind)


def test_a_real_frame_is_not_square(tmp_path):
    angles, ccw, top = X8
    flat = tuple(math.copysign(55 if abs(a) < 90 else 125, a) for a in angles)
    store = ArduPilotStore(read_vehicle(airframe(tmp_path / "a.toml", (flat, ccw, top))))
    assert (store["FRAME_CLASS"], store["FRAME_TYPE"]) == (4, 1)


def test_a_vehicle_that_is_no_frame_is_refused_in_one_line(tmp_path):
    turned = airframe(tmp_path / "turned.toml", X8_CW, renumbered=lambda n: n % 8 + 1)
    upside = airframe(tmp_path / "upside.toml", (Y6B[0], Y6B[1], {2, 3, 5}))  # as Y6A leaves it open
    alike = airframe(tmp_path / "alike.toml", (X8[0], X8[2], X8[2]))  # all upper ones counter-clockwise
    for frame, firmware, named in (
        (turned, "ardupilot", "are motors 1 to 8 of FRAME_CLASS 4"),
        (alike, "ardupilot", "no frame of ArduCopter's own"),
        (upside, "ardupilot", "are motors 1 to 6 of FRAME_CLASS 5"),
        (EXAMPLES / "mixed_hexa.toml", "ardupilot", "no frame of ArduCopter's own"),
        (airframe(tmp_path / "many.toml", TWELVE), "px4:1.13", "PX4 1.13.3 holds 8, found 12"),
    ):
        with pytest.raises(SimulationError) as caught:
            build(Simulation(frame, firmware=firmware), [])
        assert (
            named in str(caught.value) and str(frame) in str(caught.value) and "\n" not in str(caught.value)
        )
    build(Simulation(airframe(tmp_path / "twelve.toml", TWELVE)), [])
    build(Simulation(turned), [])


@pytest.mark.parametrize("frame", [X8_CW, Y6A, Y6B])
def test_the_numbers_that_it_advises_are_taken(frame, tmp_path):
    path = tmp_path / "a.toml"
    with pytest.raises(SimulationError) as caught:
        build(
            Simulation(
                airframe(path, frame, renumbered=lambda n: (n % len(frame[0])) + 1), firmware="ardupilot"
            ),
            [],
        )
    listed = re.search(r"rotors ([\d, ]+) are", str(caught.value))
    advised = {int(n): motor for motor, n in enumerate(listed[1].split(", "), 1)}
    build(
        Simulation(
            airframe(path, frame, renumbered=lambda n: advised[n % len(frame[0]) + 1]), firmware="ardupilot"
        ),
        [],
    )


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
@pytest.mark.parametrize("frame", [Y6A, Y6B])
def test_a_y6_flies_on_its_own_stand_in(frame, firmware, tmp_path):
    pilot = Pilot(firmware, frame=airframe(tmp_path / "y6.toml", frame))
    pilot.climb()
    pilot.run(6.0)
    plant = pilot.autopilot.plant
    assert plant.height == pytest.approx(3.2, abs=0.4)
    assert np.abs(plant.quaternion[1:3]).max() < 0.02 and np.abs(plant.rates).max() < 0.1
