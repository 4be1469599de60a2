"""The table on board of a PX4 and of an ArduPilot, from parameters as an upload leaves them; numbers from the
paper's eq. 15 and 18."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from monitor_messages import X8, heartbeat, look, px4_table, servo
from pymavlink.dialects.v20 import ardupilotmega

from coaxlink.data.logs.outputs import motor_map
from coaxlink.files import example
from coaxlink.monitor.incoming.table_reader import TableReader, table_parameters
from coaxlink.monitor.state.table import describe, intended
from coaxlink.tables.px4 import report_px4
from coaxlink.vehicle import load_vehicle
from firmware_params.ardupilot import MotorParameters

COPTER = heartbeat(autopilot=3)


def test_standard_reduced_and_fitted_are_told_apart() -> None:
    assert describe(px4_table(73.06, 73.06), X8).kind == "standard"
    assert describe(px4_table(46.95, 69.89), X8).kind == "reduced"
    assert describe(px4_table(43.0, 78.18, fac=0.725), X8).kind == "fitted"
    assert describe(px4_table(46.95, 69.89) | {"CA_ROTOR2_CT": 60.0}, X8).kind == "custom"
    # least squares on the eq. 17 surface over 0..0.9 gives 85.7 - 34.6 and 80.4, not the printed eq. 15
    assert describe(px4_table(85.7 - 34.6, 80.4), X8).of_model
    assert not describe(px4_table(46.95, 69.89), X8).of_model


def test_the_hash_follows_the_values_only() -> None:
    one = describe(px4_table(46.95, 69.89), X8)
    again = describe(dict(reversed(px4_table(46.95, 69.89).items())), X8)
    assert one.digest == again.digest != describe(px4_table(46.95, 69.9), X8).digest
    assert len(one.digest) == 8 and one.rotors == 8
    assert (one.upper_ct, one.lower_ct, one.thr_mdl_fac) == pytest.approx((46.95, 69.89, 1.0))


def test_half_read_wrong_and_foreign_tables() -> None:
    assert describe({}, X8).state == "unread"
    half = px4_table(46.95, 69.89)
    del half["CA_ROTOR7_KM"]
    assert describe(half, X8).state == "partial"
    assert describe({"CA_ROTOR_COUNT": 0.0}, X8).state == "invalid"
    assert describe(px4_table(46.95, 69.89) | {"CA_AIRFRAME": 1}, X8).state == "invalid"
    quad = {n: v for n, v in px4_table(70, 70).items() if not n.startswith(("CA_ROTOR4", "CA_ROTOR5"))}
    assert any("4 rotors" in note for note in describe(quad | {"CA_ROTOR_COUNT": 4}, X8).notes)


def test_what_a_pilot_must_know_is_noted() -> None:
    turned = px4_table(46.95, 69.89)
    turned["CA_ROTOR1_KM"] *= -1
    assert any("rotor 2 turns the other way" in n for n in describe(turned, X8).notes)
    assert any("elsewhere" in n for n in describe(px4_table(46.95, 69.89, arm=0.4), X8).notes)
    weak = px4_table(46.95 * 0.02, 69.89 * 0.02, km=0.02)  # every yaw entry below 0.05
    assert any("yaw" in note for note in describe(weak, X8).notes)


def test_intended_wrench_is_the_tables_own_arithmetic() -> None:
    parameters = px4_table(40.0, 60.0, fac=0.5)
    wrench = intended(parameters, [0.4] * 4 + [0.6] * 4)
    expected = 4 * 40.0 * (0.5 * 0.16 + 0.5 * 0.4) + 4 * 60.0 * (0.5 * 0.36 + 0.5 * 0.6)
    assert wrench == pytest.approx((expected, 0, 0, 0), abs=1e-4)
    assert intended(parameters, [0.4] * 7) is None
    assert intended({}, [0.4] * 8) is None
    assert intended(parameters, [0.4] * 7 + [None]) is None


def test_why_there_is_no_allocation_error() -> None:
    unread = look(heartbeat(), servo()).balance
    assert unread.error is None and "needs the table on board (CA_*)" in unread.error_note
    small = look(heartbeat(), servo(), **px4_table(6.5, 6.5)).balance
    assert small.error is None and "not in newtons" in small.error_note
    quad = px4_table(70, 70) | {"CA_ROTOR_COUNT": 4.0}
    assert "not this airframe's" in look(heartbeat(), servo(), **quad).balance.error_note
    assert look(heartbeat(), servo(), **px4_table(46.95, 69.89)).balance.error is not None


def test_numbers_that_no_table_should_hold_break_nothing() -> None:
    wrong = []
    for name in ("CA_ROTOR0_CT", "CA_ROTOR0_PX", "CA_ROTOR0_AZ", "CA_ROTOR0_KM", "THR_MDL_FAC"):
        for value in (1e38, -1e38, 3e-38, float("nan"), float("inf")):
            parameters = px4_table(46.95, 69.89) | {name: value}
            wrench = intended(parameters, [0.5] * 8)
            finite = wrench is None or all(abs(w) < float("inf") for w in wrench)
            if describe(parameters, X8).state not in ("read", "invalid") or not finite:
                wrong.append(f"{name} = {value}: {wrench}")
    assert wrong == []


# -- ArduPilot ---------------------------------------------------------------------------------------------


def builtin(frame: float = 4.0) -> dict[str, float]:
    """A board as it comes, class 4 (octaquad), type 1 (X)."""
    return {"FRAME_CLASS": frame, "FRAME_TYPE": 1.0, **MotorParameters().to_params()}


def test_an_ardupilots_table_is_its_class_and_its_curve() -> None:
    board = describe(table_parameters(builtin()), X8)
    assert (board.state, board.frame_class, board.thst_expo) == ("read", 4, 0.65)
    learned = builtin() | {"MOT_THST_HOVER": 0.31, "SERVO1_FUNCTION": 33.0, "ATC_RAT_RLL_P": 0.2}
    assert describe(table_parameters(learned), X8).digest == board.digest
    half = builtin()
    del half["MOT_SPIN_MIN"]
    assert describe(half, X8).state == "partial"
    assert describe(builtin(float("nan")), X8).state == "invalid"
    assert "no newtons" in look(COPTER, servo(), **builtin()).balance.error_note


def test_pulses_and_escs_go_by_the_board_s_own_range_and_wiring() -> None:
    # motor 1 on output 9, motors 2..8 on 2..8; pulses from 1100 to 1900
    wired = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(2, 9)}
    wired |= {"SERVO1_FUNCTION": 0.0, "SERVO9_FUNCTION": 33.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}
    pulses = (0, 1500, 1500, 1500, 1500, 1500, 1500, 1500, 1300)
    assert look(COPTER, servo(pulses), **wired).speeds.u == pytest.approx((0.25, *(0.5,) * 7))
    assert look(COPTER, servo((1500,) * 8)).speeds.u == pytest.approx((0.5,) * 8)

    def esc_telemetry(first: int, rpm: list[int]) -> object:
        kind = ardupilotmega.mavlink_map[11030 + first // 4]
        return kind([30] * 4, [2500] * 4, [900] * 4, [0] * 4, rpm, [1] * 4)

    heard = [COPTER, esc_telemetry(0, [2700] * 4), esc_telemetry(4, [3240] * 4)]
    seen = look(*heard)
    assert seen.speeds.source == "ESC_TELEMETRY rpm" and seen.speeds.basis == "measured"
    assert seen.speeds.u == pytest.approx((0.5,) * 4 + (0.6,) * 4)
    lowers_first = {f"SERVO{n + 1}_FUNCTION": 33.0 + (n + 4) % 8 for n in range(8)}
    assert look(*heard, **lowers_first).speeds.u == pytest.approx((0.6,) * 4 + (0.5,) * 4)
    still = look(COPTER, servo(), esc_telemetry(0, [0] * 4), esc_telemetry(4, [0] * 4))
    assert still.speeds.source == "SERVO_OUTPUT_RAW"  # ArduPilot's simulation measures none
    assert any("ESC_TELEMETRY reads 0 rpm" in note for note in still.notes)
    unused = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 9)} | {"SERVO8_FUNCTION": 0.0}
    assert any("1 more than the airframe's" in n for n in look(*heard, **unused).notes)


@pytest.mark.slow
def test_what_table_writes_is_called_by_its_law_on_every_kind_of_vehicle() -> None:
    """Y6: the fitted columns differ from arm to arm; the mixed one has rotors without a pair."""
    for name in ("y6", "mixed_hexa"):
        vehicle = load_vehicle(example(f"{name}.toml"))
        for law in ("standard", "reduced", "fitted"):
            params = {"CA_METHOD": 2.0, "CA_AIRFRAME": 0.0} | report_px4(vehicle, law).params
            assert describe(params, vehicle).kind == law, (name, law)


@pytest.mark.parametrize("driver", ["PWM_MAIN", "PWM_AUX", "UAVCAN_EC"])
def test_the_limits_of_whatever_drives_the_motors_are_read(driver: str) -> None:
    board = {f"{driver}_FUNC{n}": 100.0 + n for n in range(1, 9)} | {"CA_ROTOR_COUNT": 8.0, "CA_METHOD": 0.0}
    board |= {f"{driver}_{end}{n}": v for n in range(1, 9) for end, v in (("MIN", 90.0), ("MAX", 8000.0))}
    heard: dict[str, float] = {}
    session = SimpleNamespace(identity=SimpleNamespace(is_px4=True, version=(1, 15)))
    reader = TableReader.__new__(TableReader)
    reader._heard = SimpleNamespace(put_parameters=lambda table, **_: heard.update(table))
    reader._session, reader._hash, reader._complete, reader._outputs = session, None, False, {}
    reader._parameters = SimpleNamespace(
        answering=lambda names: {n: SimpleNamespace(value=board[n]) for n in names if n in board}
    )
    reader.refresh()
    outputs, taken = motor_map(heard, 8)
    assert taken == "" and {(o.motor, o.low, o.high) for o in outputs} == {
        (n, 90.0, 8000.0) for n in range(1, 9)
    }
