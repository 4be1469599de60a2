"""ArduPilot on the screen: its table, its ESCs, its outputs and its battery, from hand-made messages."""

from __future__ import annotations

from typing import Any

import pytest
from monitor_messages import Sender, attitude, battery, heartbeat, position, servo
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.airframe import Airframe, load_airframe
from coaxlink.monitor.board.ardupilot import TABLE_NAMES, intended
from coaxlink.monitor.board.description import describe, table_parameters
from coaxlink.monitor.state import View, observe
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.tables.ardupilot import report_ap
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot import MotorParameters, scripts

COPTER = 3


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe(files.example("x8_paper.toml"))


@pytest.fixture(scope="module")
def model() -> RotorModel:
    return load_rotor_model(files.example("rotor_paper.toml"))


def builtin(frame: float = 4.0) -> dict[str, float]:
    """A board as it comes, class 4 (octaquad), type 1 (X)."""
    return {"FRAME_CLASS": frame, "FRAME_TYPE": 1.0, **MotorParameters().to_params()}


def on_board(airframe: Airframe, model: RotorModel, law: str, frame: int = 15) -> dict[str, float]:
    report = report_ap(Vehicle(airframe, model), law, frame_class=frame)
    table = {n: v for n, v in {**builtin(), **report.params}.items() if n in TABLE_NAMES}
    return {**table, "FRAME_CLASS": float(frame), **scripts.loader_params(report.table.factors)}


def look(airframe: Airframe, model: RotorModel, *messages: Any, **parameters: float) -> View:
    collector, sender = Collector(), Sender()
    for message in messages:
        collector.take(sender(message), 10.0)
    collector.put_parameters(parameters)
    return observe(collector.readings(10.0), Vehicle(airframe, model), 10.0)


def escs(first: int, rpm: list[int]) -> Any:
    kind = ardupilotmega.mavlink_map[11030 + first // 4]
    return kind([30] * 4, [2500] * 4, [900] * 4, [0] * 4, rpm, [1] * 4)


@pytest.mark.parametrize("frame", [15, 17])
@pytest.mark.parametrize("law", ["standard", "curved", "reduced", "fitted"])
def test_a_law_is_known_by_its_factors(airframe: Airframe, model: RotorModel, law: str, frame: int) -> None:
    board = describe(on_board(airframe, model, law, frame), Vehicle(airframe, model))
    assert (board.state, board.kind, board.of_model) == ("read", law, True)
    assert board.frame_class == frame and board.rotors == 8 and len(board.digest) == 8
    assert board.upper_factor is not None and board.lower_factor == pytest.approx(1.0, abs=1e-3)
    assert (board.upper_factor > 0.99) == (law in ("standard", "curved"))


def test_the_hash_follows_the_table_and_nothing_else(airframe: Airframe, model: RotorModel) -> None:
    table = on_board(airframe, model, "reduced")
    one = describe(table, Vehicle(airframe, model)).digest
    learned = table | {"MOT_THST_HOVER": 0.31, "SERVO1_FUNCTION": 33.0, "ATC_RAT_RLL_P": 0.2}
    assert describe(learned, Vehicle(airframe, model)).digest == one
    assert describe(table | {"MOT_THST_EXPO": 0.5}, Vehicle(airframe, model)).digest != one
    assert (
        describe(table | {"CXL_T1": 0.7}, Vehicle(airframe, model)).state == "invalid"
    )  # its sum does not agree


def test_a_board_as_it_comes_and_one_half_read(airframe: Airframe, model: RotorModel) -> None:
    board = describe(builtin(), Vehicle(airframe, model))
    assert (board.kind, board.frame_class) == ("standard", 4)
    assert any("MOT_THST_EXPO is 0.650" in note for note in board.notes)
    half = builtin()
    del half["MOT_SPIN_MIN"]
    assert describe(half, Vehicle(airframe, model)).state == "partial"
    assert (
        describe(builtin(15.0), Vehicle(airframe, model)).state == "partial"
    )  # the script is still to be read
    foreign = describe(builtin(15.0) | {"CXL_N": 0.0}, Vehicle(airframe, model))
    assert foreign.kind == "custom" and "none of coaxlink's" in foreign.notes[0]
    assert describe(builtin(99.0), Vehicle(airframe, model)).state == "invalid"
    assert describe(builtin(float("nan")), Vehicle(airframe, model)).state in ("invalid", "partial")
    assert "CXL_N" not in table_parameters(builtin() | {"CXL_N": 8.0})  # class 4 reads no script


def test_a_law_s_newtons_come_back_from_the_pulses(airframe: Airframe, model: RotorModel) -> None:
    report = report_ap(Vehicle(airframe, model), "reduced")
    table = on_board(airframe, model, "reduced")
    board = describe(table, Vehicle(airframe, model))
    u = [0.45] * 4 + [0.62] * 4
    # squares by eq. 6, uppers and lowers each with their column
    ct = [r.ct for r in report.columns.rotors]
    expected = sum(c * s * s for c, s in zip(ct, u, strict=True))
    meant = intended(board, table, u)
    assert meant is not None and meant[0] == pytest.approx(expected, rel=2e-3)
    assert meant[1:] == pytest.approx((0, 0, 0), abs=1e-6)
    assert intended(board, table, [None, *u[1:]]) is None
    view = look(airframe, model, heartbeat(autopilot=COPTER), servo(), **table)
    assert view.balance.error is not None and view.board.kind == "reduced"


def test_factors_of_another_model_have_no_newtons(airframe: Airframe, model: RotorModel) -> None:
    table = on_board(airframe, model, "reduced")
    other = scripts.loader_params([(-0.5, 0.5, 0.5, 0.8)] * 4 + [(0.5, 0.4, 0.5, 1.0)] * 4)
    view = look(airframe, model, heartbeat(autopilot=COPTER), servo(), **{**table, **other})
    assert view.board.kind == "custom" and view.balance.error is None
    assert "newtons only as a table of this rotor model" in view.balance.error_note


def test_pulses_go_by_the_board_s_own_range_and_wiring(airframe: Airframe, model: RotorModel) -> None:
    # motor 1 on output 9, motors 2..8 on 2..8; pulses from 1100 to 1900
    wired = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(2, 9)}
    wired |= {"SERVO1_FUNCTION": 0.0, "SERVO9_FUNCTION": 33.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}
    pulses = (0, 1500, 1500, 1500, 1500, 1500, 1500, 1500, 1300)
    view = look(airframe, model, heartbeat(autopilot=COPTER), servo(pulses), **wired)
    assert view.speeds.u == pytest.approx((0.25, *(0.5,) * 7))
    plain = look(airframe, model, heartbeat(autopilot=COPTER), servo((1500,) * 8))
    assert plain.speeds.u == pytest.approx((0.5,) * 8)


def test_esc_telemetry_is_read_by_output(airframe: Airframe, model: RotorModel) -> None:
    heard = [heartbeat(autopilot=COPTER), escs(0, [2700] * 4), escs(4, [3240] * 4)]
    view = look(airframe, model, *heard)
    assert view.speeds.source == "ESC_TELEMETRY rpm" and view.speeds.basis == "measured"
    assert view.speeds.u == pytest.approx((0.5,) * 4 + (0.6,) * 4)
    wired = {f"SERVO{n + 1}_FUNCTION": 33.0 + (n + 4) % 8 for n in range(8)}  # lowers on the first outputs
    turned = look(airframe, model, *heard, **wired)
    assert turned.speeds.u == pytest.approx((0.6,) * 4 + (0.5,) * 4)
    assert not turned.notes


def test_the_simulation_s_escs_read_nothing(airframe: Airframe, model: RotorModel) -> None:
    heard = [heartbeat(autopilot=COPTER), servo(), escs(0, [0] * 4), escs(4, [0] * 4)]
    view = look(airframe, model, *heard)
    assert view.speeds.source == "SERVO_OUTPUT_RAW"
    assert any("ESC_TELEMETRY reads 0 rpm" in note for note in view.notes)


def test_the_battery_of_either_message(airframe: Airframe, model: RotorModel) -> None:
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 24700, 3100, 81, 0, 0, 0, 0, 0, 0)
    none = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0)
    here = [heartbeat(autopilot=COPTER), attitude(), position()]
    by_status = look(airframe, model, *here, status).vehicle
    assert by_status is not None and by_status.voltage_V == pytest.approx(24.7)
    assert by_status.current_A == pytest.approx(31.0) and by_status.remaining == pytest.approx(0.81)
    both = look(airframe, model, *here, status, battery(24800)).vehicle
    assert both is not None and both.voltage_V == pytest.approx(24.8)
    empty = look(airframe, model, *here, status, battery(0)).vehicle
    assert empty is not None and empty.voltage_V == pytest.approx(24.7)
    bare = look(airframe, model, *here, none).vehicle
    assert bare is not None and bare.voltage_V is None and bare.remaining is None
