"""Moments from hand-made messages: expected numbers are worked out from the paper's eq. 17 by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest
from case_table import case_table
from monitor_messages import (
    X8,
    Scene,
    Sender,
    attitude,
    battery,
    escs,
    heartbeat,
    look,
    parameter,
    position,
    servo,
)  # fmt: skip
from pymavlink.dialects.v20 import common as mavlink

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.monitor.state.rotors import arm_name
from coaxlink.monitor.state.vehicle import Drain
from coaxlink.rotor import EffectEntry
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot.messages import MAVLink_esc_telemetry_1_to_4_message as EscTelemetry
from firmware_params.px4.messages import MAVLink_esc_info_message as EscInfo

UPPER_441 = 55.9517 * 0.441**2 + 22.4464 * 0.441  # N, eq. 17 by hand
LOWER_441_648 = (
    2.755 * 0.441**2 * 0.648**2
    + 64.721 * 0.648**2
    - 2.547 * 0.441 * 0.648
    + 12.402 * 0.648
    - 37.502 * 0.441**2
    + 0.801
)


def test_nothing_heard_is_a_moment_that_waits() -> None:
    seen = look()
    assert seen.link.state == "waiting"
    assert seen.link.detail == "a heartbeat at udpin:0.0.0.0:14550"
    assert seen.vehicle is None and seen.balance.thrust_N is None and seen.board.state == "unread"
    assert [a.upper_share for a in seen.arms] == [None] * 4


def test_hover_from_servo_outputs() -> None:
    seen = look(heartbeat(), servo(), attitude(), position(), battery())
    assert [a.name for a in seen.arms] == ["front right", "front left", "rear left", "rear right"]
    pairs = [(a.upper.number, a.lower.number) for a in seen.arms if a.lower]
    assert pairs == [(1, 6), (2, 5), (3, 8), (4, 7)]
    arm = seen.arms[0]
    assert arm.lower is not None
    assert arm.upper.thrust_N == pytest.approx(UPPER_441)
    assert arm.lower.thrust_N == pytest.approx(LOWER_441_648)
    assert arm.upper_share == pytest.approx(UPPER_441 / (UPPER_441 + LOWER_441_648))
    assert arm.ideal_share == pytest.approx(arm.upper_share, abs=0.002)  # the exact split in hover
    assert (arm.upper.rpm, arm.upper.throttle) == pytest.approx((0.441 * 5400, 0.441))
    assert seen.speeds.source == "SERVO_OUTPUT_RAW" and seen.speeds.basis == "commanded"
    b = seen.balance
    assert b.thrust_N == pytest.approx(4 * (UPPER_441 + LOWER_441_648))
    assert b.of_weight == pytest.approx(4 * (UPPER_441 + LOWER_441_648) / (20.0 * 9.80665))
    assert b.upper_torque_Nm == pytest.approx(4 * (1.2437 * 0.441**2 + 0.7155 * 0.441))
    assert b.wrench is not None and b.wrench[1:] == pytest.approx((0, 0, 0), abs=1e-9)
    assert b.error is None and "CA_" in b.error_note
    v = seen.vehicle
    assert v is not None
    assert (v.firmware, v.mode, v.armed) == ("PX4", "Position", True)
    assert (v.voltage_V, v.remaining, v.current_A) == pytest.approx((24.8, 0.83, 31.5))
    assert (v.height_m, v.yaw_rad, v.clock_s) == pytest.approx((3.02, 1.5708, 1.0))


def test_yaw_and_roll_have_the_airframes_signs() -> None:
    more_left = servo((1441, 1500, 1500, 1441, 1648, 1648, 1648, 1648))  # rotors 2, 3 are on the left
    left = look(heartbeat(), more_left).balance.wrench
    assert left is not None and left[1] > 0.5 and abs(left[2]) < 1e-9  # pushes the right side down
    more_ccw = servo((1500, 1441, 1500, 1441, 1648, 1648, 1648, 1648))  # rotors 1, 3 turn ccw
    ccw = look(heartbeat(), more_ccw).balance.wrench
    assert ccw is not None and ccw[3] > 0.1


def test_commands_run_between_the_boards_own_limits_on_its_own_outputs() -> None:
    """Eight pulses from 1150 to 1850 us; by the board's word, or as assumed, which is said."""
    pulses = tuple(range(1150, 1851, 100))
    px4 = {f"PWM_MAIN_FUNC{n}": 100.0 + (9 - n) for n in range(1, 9)}  # output 1 drives motor 8
    px4 |= {f"PWM_MAIN_{end}{n}": us for n in range(1, 9) for end, us in (("MIN", 1100.0), ("MAX", 1900.0))}
    ardupilot = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 9)} | {"FRAME_CLASS": 4.0}
    rising = [(us - 1100) / 800 for us in pulses]
    cases = {
        "PX4": (px4, rising[::-1], ""),
        "ESCs on CAN": (
            {f"UAVCAN_EC_FUNC{n}": 100.0 + n for n in range(1, 9)}
            | {f"UAVCAN_EC_{end}{n}": v for n in range(1, 9) for end, v in (("MIN", 100.0), ("MAX", 8000.0))},
            [(raw - 100) / 7900 for raw in pulses], "",
        ),
        "PX4, nothing read": ({}, [(us - 1000) / 1000 for us in pulses], "assumed"),
        "MOT_PWM_MIN": ({**ardupilot, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}, rising, ""),
        "by the radio": ({**ardupilot, "RC3_MIN": 1100.0, "RC3_MAX": 1900.0}, rising, ""),
        "DShot, whatever the radio says": (
            {**ardupilot, "MOT_PWM_TYPE": 6.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0},
            [(us - 1000) / 1000 for us in pulses], "",
        ),
        "ArduPilot, nothing read": (ardupilot, [(us - 1000) / 1000 for us in pulses], "assumed"),
    }  # fmt: skip
    with case_table() as case:
        for name, (parameters, expected, note) in cases.items():
            with case(name):
                seen = look(heartbeat(), servo(pulses), **parameters)
                assert seen.speeds.throttle == pytest.approx(expected)
                assert any("assumed" in n for n in seen.notes) == bool(note)


def test_which_speeds_are_believed() -> None:
    hovering, equal = servo(), servo((1580,) * 8)
    esc = [escs(0, [2700] * 4), escs(4, [3240] * 4)]
    twice = [escs(0, [2381] * 4), escs(4, [2381] * 4)]
    cases = {
        "measured before commanded": ([hovering, *esc], "ESC_STATUS rpm", ""),
        "6000 rpm at full, the model says 5400": (
            [hovering, escs(0, [2646] * 4), escs(4, [3888] * 4)],
            "ESC_STATUS rpm",
            "1.11 of the command on every rotor: full speed is not the model's 5400 rpm",
        ),
        "a pack that is not full": (
            [hovering, escs(0, [2143] * 4), escs(4, [3149] * 4)], "ESC_STATUS rpm", "",
        ),
        "a batch that repeats the first": (
            [hovering, *twice], "SERVO_OUTPUT_RAW", "repeats rotors 1-4 as 5-8",
        ),
        "equal, as the commands are": (
            [equal, escs(0, [3132] * 4), escs(4, [3132] * 4)], "ESC_STATUS rpm", "",
        ),
        "a dead telemetry wire": (
            [hovering, escs(0, [0] * 4), escs(4, [0] * 4)], "SERVO_OUTPUT_RAW", "reads 0 rpm",
        ),
        "the one that knows all rotors": (
            [hovering, esc[0]], "SERVO_OUTPUT_RAW", "ESC_STATUS knows 4 of 8 rotors",
        ),
        "more rotors than the airframe": (
            [escs(k, [2400 + k, 2400, 2400, 2400]) for k in (0, 4, 8)], "ESC_STATUS rpm", "reports 4 more",
        ),
        "NaN": ([hovering, escs(0, [math.nan] * 4)], "SERVO_OUTPUT_RAW", "1000 to 2000 us, assumed"),
    }  # fmt: skip
    wrong = []
    for name, (messages, source, note) in cases.items():
        seen = look(heartbeat(), *messages)
        noted = any(note in n for n in seen.notes) if note else not seen.notes
        if seen.speeds.source != source or not noted:
            wrong.append(f"{name}: {seen.speeds.source} {seen.notes}")
    assert wrong == []
    measured = look(heartbeat(), hovering, *esc)
    assert measured.speeds.u == pytest.approx((0.5,) * 4 + (0.6,) * 4)
    assert measured.arms[0].upper.throttle == pytest.approx(0.441)  # the command stays a command


def test_missing_rotors_leave_their_arms_unknown_only() -> None:
    seen = look(heartbeat(), escs(0, [2381, 2381, 2381, 2381]))
    upper = seen.arms[0].upper
    assert upper.thrust_N == pytest.approx(55.9517 * (2381 / 5400) ** 2 + 22.4464 * 2381 / 5400)
    assert seen.arms[0].lower is not None and seen.arms[0].lower.thrust_N is None
    assert seen.arms[0].upper_share is None and seen.balance.thrust_N is None
    assert "no speed of rotor 5, 6, 7, 8" in seen.notes


def test_absurd_numbers_are_unknown_and_break_nothing() -> None:
    nan = math.nan
    table = [parameter("CA_ROTOR_COUNT", nan), parameter("THR_MDL_FAC", math.inf)]
    seen = look(heartbeat(), attitude(nan, nan, nan), position(nan), servo(), *table)
    v = seen.vehicle
    assert v is not None
    assert (v.roll_rad, v.pitch_rad, v.yaw_rad, v.height_m) == (None, None, None, None)
    assert seen.board.state in ("unread", "invalid", "partial")
    json.dumps(seen.to_json(), allow_nan=False)


def test_standing_rotors_make_no_thrust_and_no_split() -> None:
    seen = look(heartbeat(armed=False), servo((900,) * 8))
    assert seen.balance.thrust_N == 0.0  # not the 0.801 N of the fit's constant
    assert all(a.upper_share is None and a.ideal_share is None for a in seen.arms)
    assert seen.vehicle is not None and not seen.vehicle.armed


def test_what_grew_old_keeps_its_number_and_is_marked() -> None:
    scene = Scene()
    scene.hear(heartbeat(), servo(), escs(0, [2700] * 4), escs(4, [2704] * 4))
    scene.clock.sleep(3.0)
    old = scene.look(heartbeat())
    assert old.link.state == "live" and old.speeds_stale and old.speeds_age_s == pytest.approx(3.0)
    assert old.arms[0].upper.thrust_N is not None
    fresh = scene.look(servo())
    assert fresh.speeds.source == "SERVO_OUTPUT_RAW" and "ESC_STATUS went quiet" in fresh.notes
    lost = scene.look(later_s=8.0).link
    assert lost.state == "lost" and lost.age_s == pytest.approx(8.0) and lost.rate_hz == 0.0
    assert scene.look(heartbeat(), later_s=0.1).link.state == "live"


def test_loss_and_rate_come_from_sequence_numbers() -> None:
    scene = Scene()
    scene.send.sequence = 250  # wraps at 256 on the way
    for k in range(50):
        scene.heard.take(scene.send(heartbeat(), skip=1 if k and k % 5 == 0 else 0))
        scene.clock.sleep(0.099)
    traffic = scene.heard.traffic
    assert (traffic.received, traffic.missed) == (50, 9)
    assert traffic.loss == pytest.approx(9 / 59)
    assert traffic.rate_hz == pytest.approx(10.0, rel=0.05)
    scene.send.sequence = 0  # a sender that starts again: back by less than half of all numbers
    scene.hear(heartbeat())
    assert scene.heard.traffic.missed == 9


def test_ground_stations_other_vehicles_and_cameras_do_not_mix_in() -> None:
    scene, two, station, camera = Scene(), Sender(2), Sender(255, 190), Sender(1, 100)
    scene.heard.take(station(heartbeat(autopilot=8)))
    scene.hear(heartbeat())
    for other in (two, camera):
        scene.heard.take(other(attitude(roll=1.0)))
    scene.heard.take(two(heartbeat()))
    assert scene.heard.telemetry.get("attitude") is None and scene.heard.others == (2,)
    assert any("system 2" in note for note in scene.look().notes)


def test_two_vehicles_of_one_system_id_are_noticed() -> None:
    crowd, one, two, alone = Scene(), Sender(), Sender(), Scene()
    two.sequence = 100
    for k in range(100):
        for sender in (one, two) if k % 3 else (two, one):
            crowd.heard.take(sender(heartbeat()))
        alone.heard.take(alone.send(heartbeat(), skip=k % 4 == 0))
    seen = crowd.look()
    assert seen.link.loss is None and "two vehicles call themselves system 1" in seen.notes[0]
    assert not alone.look().notes


def test_parameters_heard_in_passing_are_decoded_as_the_autopilot_sends_them() -> None:
    scene = Scene()
    scene.hear(heartbeat(), parameter("CA_ROTOR_COUNT", 1.1210387714598537e-44, kind=6))
    assert scene.heard.parameters == {"CA_ROTOR_COUNT": 8.0}
    assert scene.look().board.state == "partial"
    scene.heard.put_parameters({"CA_METHOD": 2.0}, replace_prefix="CA_")
    assert scene.heard.parameters == {"CA_METHOD": 2.0}


def test_single_rotors_are_arms_of_their_own(tmp_path: Path) -> None:
    text = files.read_text(files.example("x8_paper.toml"))
    rotors = text.split("[[rotors]]")
    quad = rotors[0] + "".join("[[rotors]]" + r.split("level")[0] + 'level = "single"\n' for r in rotors[1:5])
    path = tmp_path / "quad.toml"
    path.write_text(quad)
    seen = look(heartbeat(), servo((1441,) * 4), vehicle=Vehicle(load_airframe(path), X8.rotors))
    assert [a.lower for a in seen.arms] == [None] * 4
    assert seen.balance.thrust_N == pytest.approx(4 * UPPER_441)
    assert seen.balance.upper_share is None


def test_arm_names() -> None:
    places = [(0.2, 0.2), (-0.2, -0.2), (0.3, 0.01), (0.0, -0.3), (0.0, 0.0)]
    assert [arm_name(*p) for p in places] == ["front right", "rear left", "front", "left", "centre"]


def test_effects_that_are_not_in_the_thrusts_are_named_and_texts_are_plain() -> None:
    rotors = dataclasses.replace(X8.rotors, effects=(EffectEntry("rotor_drag", {"k": 0.1}),))
    text = mavlink.MAVLink_statustext_message(4, b"\x1b[31mArming\x07 denied")
    seen = look(heartbeat(), text, vehicle=Vehicle(X8.airframe, rotors))
    assert any("rotor_drag" in n for n in seen.notes)
    assert seen.vehicle is not None and seen.vehicle.text == r"\x1b[31mArming\x07 denied"


@pytest.mark.parametrize(("pulses", "live"), [((1441,) * 4 + (1648,) * 4, True), ((1290,) * 8, False)])
def test_a_legacy_demand_is_newtons_only_while_a_companion_mixes(pulses: tuple[int, ...], live: bool) -> None:
    number = 1 << 24 | 13 << 16 | 3 << 8
    version = mavlink.MAVLink_autopilot_version_message(0, number, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 0)
    controls = [0.0, 0.0, 0.0, 0.29, 0.0, 0.0, 0.0, 0.0]
    demand = mavlink.MAVLink_actuator_control_target_message(1000, 0, controls)
    b = look(heartbeat(), version, servo(pulses), demand).balance
    grid = [0.09 * k for k in range(11)]  # the lone rotor of eq. 18: least squares of p u^2 over 0..0.9
    thrust = [55.9517 * u**2 + 22.4464 * u for u in grid]
    p = sum(f * u**2 for f, u in zip(thrust, grid, strict=True)) / sum(u**4 for u in grid)
    if live:
        assert b.basis == "demand" and b.intended is not None and b.error is not None
        assert b.intended == pytest.approx((8 * p * 0.29, 0, 0, 0), rel=1e-4, abs=1e-4)
        assert b.error[0] == pytest.approx(4 * (UPPER_441 + LOWER_441_648) - 8 * p * 0.29, abs=0.1)
    else:
        assert b.error is None and "legacy mixer" in b.error_note


def test_a_motor_is_at_its_bound_at_full_command_and_in_flight_at_its_least() -> None:
    ardupilot = {"autopilot": 3}
    cases = [
        (2000, True, -3.0, {}, None, "max"),
        (1999, True, -3.0, {}, None, ""),
        (1000, True, -3.0, {}, None, "min"),
        (1001, True, -3.0, {}, None, ""),
        (1000, True, -0.1, {}, None, ""),  # it stands: motors may
        (1000, False, -3.0, {}, None, ""),
        (1150, True, -3.0, ardupilot, 0.15, "min"),  # ArduPilot goes no lower in flight
        (1152, True, -3.0, ardupilot, 0.15, ""),
    ]
    wrong = []
    for case in cases:
        pulse, armed, down, firmware, least, bound = case
        parameters = {} if least is None else {"MOT_SPIN_MIN": least}
        seen = look(heartbeat(armed, **firmware), position(down), servo((pulse, *[1500] * 7)), **parameters)
        bounds = [r.bound for arm in seen.arms for r in (arm.upper, arm.lower) if r]
        if bounds != [bound] + [""] * 7:
            wrong.append(f"{case}: {bounds}")
    assert wrong == []


def test_current_and_temperature_are_shown_where_they_are_sent() -> None:
    px4 = look(heartbeat(), servo(), escs(0, [2381] * 4), escs(4, [3499] * 4)).arms[0]
    assert px4.upper.current_A == 5.0 and px4.upper.temperature_C is None
    assert look(heartbeat(), servo(), escs(0, [2381] * 4, current_A=0.0)).arms[0].upper.current_A is None
    warm = EscInfo(0, 0, 0, 8, 0, 0, [0] * 4, [0] * 4, [3150, 0, 32767, 4000])
    assert look(heartbeat(), servo(), warm).arms[0].upper.temperature_C == 31.5
    sent = EscTelemetry([41, 42, 0, 44], [0] * 4, [1030, 900, 800, 700], [0] * 4, [2381] * 4, [1] * 4)
    seen = look(heartbeat(autopilot=3), servo(), sent)
    uppers = [a.upper for a in seen.arms]
    assert [r.current_A for r in uppers] == [10.3, 9.0, 8.0, 7.0]
    assert [r.temperature_C for r in uppers] == [41.0, 42.0, None, 44.0]
    assert not seen.escs_stale and look(heartbeat(autopilot=3), servo(), sent, later_s=2.0).escs_stale


def test_an_esc_that_px4_has_offline_says_nothing_of_now() -> None:
    """ESC_INFO's bits; none at all is a driver's that does not keep them."""
    for bits, notes in ((0xFD, True), (0xFF, False), (0, False)):
        info = EscInfo(0, 0, 0, 8, 0, bits, [0] * 4, [0] * 4, [0] * 4)
        seen = look(heartbeat(), servo(), escs(0, [2381] * 4), escs(4, [3499] * 4), info)
        assert any("ESC 1 (from 0) is offline" in note for note in seen.notes) == notes


def test_the_battery_s_word() -> None:
    cases = [
        (83, None, 0, "ok"),
        (15, None, 0, "low"),
        (7, None, 0, "critical"),
        (5, None, 0, "emergency"),
        (25, 0.3, 0, "low"),  # the board's own threshold
        (83, None, 3, "critical"),  # the autopilot's word
        (5, None, 1, "emergency"),  # the worse of the two
        (83, None, 6, "unhealthy"),
        (-1, None, 0, ""),
    ]
    wrong = []
    for case in cases:
        remaining, threshold, state, word = case
        pack = battery(remaining=remaining)
        pack.charge_state = state
        seen = look(heartbeat(), pack, **({} if threshold is None else {"BAT_LOW_THR": threshold})).vehicle
        if seen is None or seen.battery_word != word:
            wrong.append(f"{case}: {seen}")
    assert wrong == []
    bare = look(heartbeat(), attitude()).vehicle
    assert bare is not None and bare.battery_word == "" and bare.voltage_V is None


def test_the_battery_of_either_message() -> None:
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 24700, 3100, 81, 0, 0, 0, 0, 0, 0)
    for packs, voltage in (([status], 24.7), ([status, battery(24800)], 24.8), ([status, battery(0)], 24.7)):
        seen = look(heartbeat(), *packs).vehicle
        assert seen is not None and seen.voltage_V == pytest.approx(voltage)


def test_minutes_are_the_autopilot_s_else_by_energy_else_by_the_trend() -> None:
    power_W = 24.8 * 31.5
    large = Vehicle(dataclasses.replace(X8.airframe, battery_Wh=500.0), X8.rotors)
    determined = battery()
    determined.time_remaining = 600
    for pack, vehicle, minutes, by in (
        (determined, large, 10.0, "autopilot"),
        (battery(), large, 60 * 500 * 0.83 / power_W, "battery_Wh"),
        (battery(), X8, None, ""),
    ):
        seen = look(heartbeat(), pack, vehicle=vehicle).vehicle
        assert seen is not None and seen.battery_minutes_by == by
        assert seen.battery_minutes == (None if minutes is None else pytest.approx(minutes))


def test_the_trend_counts_from_fall_to_fall_and_begins_anew_with_a_new_pack() -> None:
    drain = Drain()
    for second in range(200):  # 1 % in 10 s
        drain = drain.extended(float(second), round(0.90 - 0.001 * second, 2), True)
        assert second > 30 or drain.minutes is None
    assert drain.minutes == pytest.approx(drain.falls[-1][1] / 0.1 * 100 / 60, rel=0.02)
    assert drain.extended(200.0, 0.95, True).minutes is None
    assert drain.extended(5.0, 0.5, True).minutes is None  # the vehicle restarted


def test_what_a_pack_lost_on_the_ground_says_nothing_of_the_flight() -> None:
    scene = Scene()

    def left(second: int, armed: bool, percent: int) -> float | None:
        pack = battery(remaining=percent)
        seen = scene.look(heartbeat(armed), pack, attitude(boot_ms=1000 * second), later_s=1.0).vehicle
        assert seen is not None
        return seen.battery_minutes

    ground = [left(second, False, 99 - second // 30) for second in range(120)]  # 1 % in 30 s
    assert set(ground) == {None}
    flight = [left(120 + second, True, 95 - second // 3) for second in range(31)]  # 1 % in 3 s
    assert flight[9] is None and flight[-1] == pytest.approx(85 * 3 / 60, rel=0.05)
