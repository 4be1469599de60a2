"""Which output drives which motor, between which numbers, whose rpm an ESC tells: by the log's parameters."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from pymavlink.dialects.v20 import common
from test_data_flight import recorded

from coaxlink.airframe import load_airframe
from coaxlink.channels.flight import flight_frame
from coaxlink.data import read_flight_log
from coaxlink.data.logs.outputs import ardupilot_map, as_motors, motors_of_escs, px4_maps, px4_outputs
from coaxlink.data.samples import OUTPUTS_AS_MOTORS
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.rotor import load_rotor_model

FUNCTIONS = {33: 1, 40: 8, 82: 9, 85: 12, 160: 13, 179: 32}


def test_ardupilots_functions_and_ranges() -> None:
    with case_table() as case:
        for function, motor in FUNCTIONS.items():
            with case(str(function)):
                (output,) = ardupilot_map({"SERVO31_FUNCTION": function})
                assert (output.motor, output.channel, output.low, output.high) == (motor, 31, 1000, 2000)
        for parameters, expected in (
            ({"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900}, (1100, 1900)),
            ({"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900, "MOT_PWM_TYPE": 6}, (1000, 2000)),  # DShot
            ({"MOT_PWM_TYPE": 8, "SERVO1_MIN": 1050, "SERVO1_MAX": 1950}, (1050, 1950)),
            ({"MOT_PWM_MIN": 0, "MOT_PWM_MAX": 0}, (1000, 2000)),
        ):
            with case(str(parameters)):
                (output,) = ardupilot_map({"SERVO1_FUNCTION": 33, **parameters})
                assert (output.low, output.high) == expected
    assert ardupilot_map({"SERVO1_FUNCTION": 70}) == ()


def test_px4s_drivers_and_ranges() -> None:
    with case_table() as case:
        for driver, more, expected in (
            ("PWM_MAIN", {}, (1000, 2000)),
            ("PWM_AUX", {"PWM_AUX_MIN3": 1100, "PWM_AUX_MAX3": 1900}, (1100, 1900)),
            ("PCA9685", {"PCA9685_MIN3": 1150}, (1150, 2000)),
            ("UAVCAN_EC", {"UAVCAN_EC_MAX3": 8191}, (0, 8191)),
            ("PWM_MAIN", {"PWM_MAIN_TIM0": -3}, (0, 1999)),
            ("PWM_MAIN", {"PWM_MAIN_TIM0": -1}, (1000, 2000)),  # OneShot: pulses
        ):
            with case(f"{driver} {more}"):
                ((output,),) = px4_maps({f"{driver}_FUNC3": 112, f"{driver}_FUNC4": 201, **more})
                assert (output.motor, output.channel, output.low, output.high) == (12, 3, *expected)


def test_a_drivers_instance_is_the_one_in_which_its_motors_run() -> None:
    rests, pulses, can = ({n: np.full(9, v + n) for n in (1, 2)} for v in (0.0, 1500.0, 5000.0))
    rests = {n: np.zeros(9) for n in rests}
    functions = {"PWM_AUX_FUNC1": 102, "PWM_AUX_FUNC2": 101}
    ((outputs, instance),), known = px4_outputs([rests, can, pulses], functions)
    assert (instance, known, [o.channel for o in outputs]) == (2, True, [2, 1])
    ((outputs, instance),), known = px4_outputs([rests, can], {})  # before 1.13; no pulse has 5000 us
    assert (instance, known, outputs[0].high) == (1, False, 8191)
    assert [o.high for o in as_motors(pulses, {"DSHOT_CONFIG": 600}, "PWM_MAIN")] == [1999, 1999]


def test_an_esc_bears_the_number_of_its_output() -> None:
    turn = ardupilot_map({"SERVO1_FUNCTION": 33, "SERVO2_FUNCTION": 37, "SERVO3_FUNCTION": 34})
    high = ardupilot_map({f"SERVO{8 + n}_FUNCTION": 32 + n for n in range(1, 5)})
    notes: list[str] = []
    assert motors_of_escs(turn, [0, 1, 2], notes, []) == {0: 1, 1: 5, 2: 2}
    assert motors_of_escs(high, [8, 9, 10, 11], notes, []) == {8: 1, 9: 2, 10: 3, 11: 4}
    assert motors_of_escs(high, [0, 1, 2, 3], notes, []) == {0: 1, 1: 2, 2: 3, 3: 4}  # before 4.5
    assert notes == []
    assert motors_of_escs(turn, [0, 1, 2, 30], notes, []) == {0: 1, 1: 5, 2: 2} and "ESC 30" in notes[0]
    premises: list[str] = []
    assert motors_of_escs((), [0], notes, premises) == {0: 1} and premises == [OUTPUTS_AS_MOTORS]


def test_a_tlog_is_mapped_by_the_parameters_in_it(tmp_path: Path) -> None:
    plain = read_flight_log(recorded(tmp_path / "plain.tlog", seconds=1.0).write())
    assert plain.premises == (OUTPUTS_AS_MOTORS,) and plain.motors == ()
    log = recorded(tmp_path / "mapped.tlog", seconds=1.0)
    for channel in range(1, 9):  # PX4 sends the bytes of an integer in the place of the float
        (value,) = struct.unpack("<f", struct.pack("<i", 109 - channel))
        name = f"PWM_MAIN_FUNC{channel}".encode()
        log.add(common.MAVLink_param_value_message(name, value, 6, 800, channel))
    mapped = read_flight_log(log.write())
    assert mapped.premises == () and mapped.motors == tuple(range(1, 9))
    np.testing.assert_allclose(mapped["motor1"], plain["motor8"])
    np.testing.assert_allclose(mapped["motor8"], plain["motor1"])


@pytest.mark.parametrize("motors", [tuple(range(1, 7)), tuple(range(1, 13))])
def test_a_vehicle_of_more_or_fewer_motors_is_another(tmp_path: Path, motors: tuple[int, ...]) -> None:
    log = recorded(tmp_path / "other.tlog", seconds=1.0)
    for n in motors:
        (value,) = struct.unpack("<f", struct.pack("<i", 100 + n))
        log.add(common.MAVLink_param_value_message(f"PWM_MAIN_FUNC{n}".encode(), value, 6, 800, n))
    rotors = load_rotor_model(example("rotor_paper.toml"))
    with pytest.raises(InputError, match=r"by the log's own parameters the vehicle has motors 1, 2"):
        flight_frame([read_flight_log(log.write())], load_airframe(example("x8_paper.toml")), rotors)
