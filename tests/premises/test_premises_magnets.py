"""ESC speeds against commands and weight: a wrong number of magnets is named, a vehicle that sags is not."""

import numpy as np
from case_table import case_table

from coaxlink.airframe import load_airframe
from coaxlink.constants import GRAVITY_M_S2
from coaxlink.data import Samples
from coaxlink.files import example
from coaxlink.premises.magnets import miscounted
from coaxlink.rotor import load_rotor_model

X8, ROTORS = load_airframe(example("x8_paper.toml")), load_rotor_model(example("rotor_paper.toml"))
UPPER, LOWER = 0.444, 0.647  # of full speed: hover of the shipped X8


def hover(rpm_factor, command_factor=1.0, parameters=None):
    pairs = {n for pair in X8.pairs for n in pair[:1]}
    speeds = {r.number: UPPER if i in pairs else LOWER for i, r in enumerate(X8.rotors)}
    columns = {f"motor{n}": np.full(200, u * command_factor) for n, u in speeds.items()}
    columns |= {f"rpm{n}": np.full(200, u * ROTORS.speed_max_rpm * rpm_factor) for n, u in speeds.items()}
    columns["accel_z_m_s2"] = np.full(200, -GRAVITY_M_S2)
    return Samples(columns, "hover", parameters=parameters or {})


def test_magnets_are_named_with_their_parameter():
    with case_table() as case:
        for parameters, taken, right, name in (
            *(({"SERVO_BLH_POLES": 14.0}, 14, n, "SERVO_BLH_POLES") for n in (8, 10, 12, 20, 22, 28, 42)),
            ({"SERVO_BLH_POLES": 28.0}, 28, 14, "SERVO_BLH_POLES"),
            ({"MOT_POLE_COUNT": 12.0}, 12, 20, "MOT_POLE_COUNT"),
            ({"SERVO1_FUNCTION": 33.0}, 14, 42, "SERVO_BLH_POLES"),
            ({"CA_ROTOR_COUNT": 8.0}, 14, 22, "MOT_POLE_COUNT"),
        ):
            with case(f"{parameters} {right}"):
                found = miscounted(hover(right / taken, parameters=parameters), X8, ROTORS)
                assert (
                    f"{right} magnets counted as {taken}? set {name} (or the ESC's own) to {right}"
                    in found.why
                )


def test_a_pack_that_sags_is_no_miscount():
    for more in (1.0, 1.1, 1.2):  # commands go up, the motors turn as they must
        assert miscounted(hover(1.0, more), X8, ROTORS) is None
