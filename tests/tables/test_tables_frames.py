"""Every frame of ArduCopter with pairs, through what a user does with it: read, tabled, uploaded, turned."""

import math

import pytest
from case_table import case_table

from coaxlink.files import example
from coaxlink.premises import turned_otherwise
from coaxlink.rotor import load_rotor_model
from coaxlink.setup import Body, ardupilot_layout, check_against, completed, px4_layout
from coaxlink.tables.ardupilot import report_ap
from coaxlink.tables.px4 import report_px4
from coaxlink.uploading.ardupilot_table import moved_rotors, planned_table, present_table
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import motor_test_sequence
from firmware_params.ardupilot.owners_script import own_matrix

MODEL = load_rotor_model(example("rotor_paper.toml"))
BODY = Body("a", 20.0, 0.4, 0.15)
# the angle of motor 1, 2, ... and which turn counter-clockwise, from ArduPilot's motor order diagrams
DIAGRAMS = {
    (4, 0): ((0, -90, 180, 90, -90, 0, 90, 180), {1, 3, 5, 7}),
    (4, 1): ((45, -45, -135, 135, -45, 45, 135, -135), {1, 3, 5, 7}),
    (4, 2): ((45, -45, -135, 135, -45, 45, 135, -135), {1, 3, 5, 7}),
    (4, 3): ((45, -45, -135, 135, -45, 45, 135, -135), {2, 4, 6, 8}),
    (4, 12): ((135, 45, -135, -45, 135, 45, -135, -45), {2, 3, 5, 8}),
    (4, 14): ((45, 45, 135, 135, -135, -135, -45, -45), {1, 4, 5, 8}),
    (4, 18): ((135, 45, -135, -45, 135, 45, -135, -45), {1, 4, 6, 7}),
    (4, 20): ((45, -45, -135, 135, -45, 45, 135, -135), {1, 3, 6, 8}),
    (4, 21): ((45, 45, 135, 135, -135, -135, -45, -45), {1, 2, 5, 6}),
    (5, 0): ((60, -60, -60, 180, 60, 180), {1, 3, 6}),
    (5, 1): ((60, -60, -60, 180, 60, 180), {1, 3, 6}),
    (5, 10): ((60, 60, 180, 180, -60, -60), {2, 4, 6}),
    (5, 11): ((180, 60, -60, 180, 60, -60), {1, 2, 3}),
    (12, 0): ((0, 0, 60, 60, 120, 120, 180, 180, -120, -120, -60, -60), {1, 4, 5, 8, 9, 12}),
    (12, 1): ((30, 30, 90, 90, 150, 150, -150, -150, -90, -90, -30, -30), {1, 4, 5, 8, 9, 12}),
}


@pytest.mark.slow
def test_every_coaxial_frame_through_every_step():
    with case_table() as case:
        for (kind, shape), (angles, ccw) in DIAGRAMS.items():
            params = {"FRAME_CLASS": float(kind), "FRAME_TYPE": float(shape)}
            with case(f"{kind} {shape}"):
                layout = ardupilot_layout(params, "board")
                frame = completed(layout, BODY)
                for rotor, angle in zip(frame.rotors, angles, strict=True):
                    assert check_direction(rotor, angle) and (rotor.number in ccw) == (rotor.yaw_sign > 0)
                assert check_against(frame, layout) == ()
                vehicle = Vehicle(frame, MODEL)
                assert bool(turned_otherwise(vehicle.declared, vehicle.rotors)) == (shape in (20, 21))
                made = report_ap(vehicle, "standard")
                assert not made.blocking
                scripts = {name: text.encode() for name, text in made.scripts.items()}
                planned, present = planned_table(made.params, scripts), present_table(params, lambda: None)
                assert moved_rotors(present, planned) == []
                assert own_matrix(next(iter(made.scripts.values())), made.params).factors == planned.factors
                assert sorted(motor_test_sequence(kind, shape)) == list(range(1, len(angles) + 1))
                back = completed(px4_layout(report_px4(vehicle, "standard").params, "board"), BODY)
                assert [(r.pair, r.level, r.yaw_sign) for r in back.rotors] == [
                    (r.pair, r.level, r.yaw_sign) for r in frame.rotors
                ]


def check_direction(rotor, degrees):
    """Whether a rotor stands at this angle from the nose, clockwise."""
    x, y, _ = rotor.position_m
    return abs((math.degrees(math.atan2(y, x)) - degrees + 180) % 360 - 180) < 0.01
