"""The view from hand-made messages: expected numbers are worked out from the paper's eq. 17 by hand."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest
from monitor_messages import (
    EscStatus,
    Sender,
    attitude,
    battery,
    heartbeat,
    parameter,
    position,
    servo,
)

from coaxlink import files
from coaxlink.airframe import Airframe, load_airframe
from coaxlink.monitor.state import View, arm_name, observe
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.monitor.watch import Watch, to_json
from coaxlink.rotor import RotorModel, load_rotor_model
from coaxlink.vehicle import Vehicle

UPPER_441 = 55.9517 * 0.441**2 + 22.4464 * 0.441  # N, eq. 17 by hand
LOWER_441_648 = (
    2.755 * 0.441**2 * 0.648**2
    + 64.721 * 0.648**2
    - 2.547 * 0.441 * 0.648
    + 12.402 * 0.648
    - 37.502 * 0.441**2
    + 0.801
)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe(files.example("x8_paper.toml"))


@pytest.fixture(scope="module")
def model() -> RotorModel:
    return load_rotor_model(files.example("rotor_paper.toml"))


def look(airframe: Airframe, model: RotorModel, *messages: Any, now: float = 10.0, at: float = 10.0) -> View:
    collector, sender = Collector(), Sender()
    for message in messages:
        collector.take(sender(message), at)
    return observe(collector.readings(now), Vehicle(airframe, model), now, address="udpin:0.0.0.0:14550")


def test_nothing_heard_is_a_view_that_waits(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model)
    assert view.link.state == "waiting"
    assert view.link.detail == "a heartbeat at udpin:0.0.0.0:14550"
    assert view.vehicle is None and view.balance.thrust_N is None
    assert [a.upper_share for a in view.arms] == [None] * 4


def test_hover_from_servo_outputs(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model, heartbeat(), servo(), attitude(), position(), battery())
    assert [a.name for a in view.arms] == ["front right", "front left", "rear left", "rear right"]
    assert [(a.upper.number, a.lower.number) for a in view.arms if a.lower] == [
        (1, 6),
        (2, 5),
        (3, 8),
        (4, 7),
    ]
    arm = view.arms[0]
    assert arm.lower is not None
    assert arm.upper.thrust_N == pytest.approx(UPPER_441)
    assert arm.lower.thrust_N == pytest.approx(LOWER_441_648)
    assert arm.upper_share == pytest.approx(UPPER_441 / (UPPER_441 + LOWER_441_648))
    assert arm.upper.rpm == pytest.approx(0.441 * 5400)
    assert arm.upper.throttle == pytest.approx(0.441)
    assert view.speeds.source == "SERVO_OUTPUT_RAW" and view.speeds.basis == "commanded"
    b = view.balance
    assert b.thrust_N == pytest.approx(4 * (UPPER_441 + LOWER_441_648))
    assert b.of_weight == pytest.approx(4 * (UPPER_441 + LOWER_441_648) / (20.0 * 9.80665))
    assert b.upper_torque_Nm == pytest.approx(4 * (1.2437 * 0.441**2 + 0.7155 * 0.441))
    assert b.wrench is not None and b.wrench[1:] == pytest.approx((0, 0, 0), abs=1e-9)
    assert b.error is None and "CA_" in b.error_note
    v = view.vehicle
    assert v is not None
    assert (v.firmware, v.mode, v.armed) == ("PX4", "Position", True)
    assert v.voltage_V == pytest.approx(24.8) and v.remaining == pytest.approx(0.83)
    assert v.current_A == pytest.approx(31.5)
    assert v.height_m == pytest.approx(3.02) and v.yaw_rad == pytest.approx(1.5708)
    assert v.clock_s == pytest.approx(1.0)


def test_yaw_and_roll_have_the_airframes_signs(airframe: Airframe, model: RotorModel) -> None:
    more_left = servo((1441, 1500, 1500, 1441, 1648, 1648, 1648, 1648))  # rotors 2, 3 are on the left
    left = look(airframe, model, heartbeat(), more_left).balance.wrench
    assert left is not None and left[1] > 0.5 and abs(left[2]) < 1e-9  # pushes the right side down
    more_ccw = servo((1500, 1441, 1500, 1441, 1648, 1648, 1648, 1648))  # rotors 1, 3 turn ccw
    ccw = look(airframe, model, heartbeat(), more_ccw).balance.wrench
    assert ccw is not None and ccw[3] > 0.1


def test_measured_rpm_is_preferred_and_named(airframe: Airframe, model: RotorModel) -> None:
    esc = [EscStatus(0, [2700] * 4), EscStatus(4, [3240] * 4)]
    view = look(airframe, model, heartbeat(), servo(), *esc)
    assert view.speeds.source == "ESC_STATUS rpm" and view.speeds.basis == "measured"
    assert view.speeds.u == pytest.approx((0.5,) * 4 + (0.6,) * 4)
    assert view.arms[0].upper.throttle == pytest.approx(0.441)  # the command stays a command


def test_rpm_of_another_full_speed_is_named(airframe: Airframe, model: RotorModel) -> None:
    esc = [EscStatus(0, [2646] * 4), EscStatus(4, [3888] * 4)]  # 6000 at full, the model says 5400
    view = look(airframe, model, heartbeat(), servo(), *esc)
    assert any("1.11 of the command on every rotor" in note and "5400" in note for note in view.notes)
    sagging = [EscStatus(0, [2143] * 4), EscStatus(4, [3149] * 4)]  # 0.9: a pack that is not full does that
    assert not look(airframe, model, heartbeat(), servo(), *sagging).notes


def test_repeated_esc_batch_is_not_believed(airframe: Airframe, model: RotorModel) -> None:
    esc = [EscStatus(0, [2381] * 4), EscStatus(4, [2381] * 4)]
    view = look(airframe, model, heartbeat(), servo(), *esc)
    assert view.speeds.source == "SERVO_OUTPUT_RAW"
    assert any("repeats" in note for note in view.notes)


def test_equal_batches_are_fine_when_the_outputs_are_equal_too(airframe: Airframe, model: RotorModel) -> None:
    esc = [EscStatus(0, [3132] * 4), EscStatus(4, [3132] * 4)]
    view = look(airframe, model, heartbeat(), servo((1580,) * 8), *esc)
    assert view.speeds.source == "ESC_STATUS rpm" and not view.notes


def test_different_speeds_repeated_without_a_witness_are_not_believed(
    airframe: Airframe, model: RotorModel
) -> None:
    rpm = [2381, 2390, 2400, 2370]
    view = look(airframe, model, heartbeat(), EscStatus(0, rpm), EscStatus(4, rpm))
    assert view.arms[0].lower is not None and view.arms[0].lower.speed is None
    assert view.balance.thrust_N is None


def test_dead_telemetry_wire_is_seen(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model, heartbeat(), servo(), EscStatus(0, [0] * 4), EscStatus(4, [0] * 4))
    assert view.speeds.source == "SERVO_OUTPUT_RAW"
    assert any("0 rpm" in note for note in view.notes)


def test_missing_rotors_leave_their_arms_unknown_only(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model, heartbeat(), EscStatus(0, [2381] * 4))
    upper = view.arms[0].upper
    assert upper.thrust_N == pytest.approx(55.9517 * (2381 / 5400) ** 2 + 22.4464 * 2381 / 5400)
    assert view.arms[0].lower is not None and view.arms[0].lower.thrust_N is None
    assert view.arms[0].upper_share is None and view.balance.thrust_N is None
    assert "no speed of rotor 5, 6, 7, 8" in view.notes


def test_the_source_that_knows_all_rotors_wins(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model, heartbeat(), EscStatus(0, [2700] * 4), servo())
    assert view.speeds.source == "SERVO_OUTPUT_RAW"
    assert "ESC_STATUS knows 4 of 8 rotors" in view.notes


def test_more_rotors_than_the_airframe(airframe: Airframe, model: RotorModel) -> None:
    esc = [EscStatus(k, [2400 + k, 2400, 2400, 2400]) for k in (0, 4, 8)]
    view = look(airframe, model, heartbeat(), *esc)
    assert view.speeds.source == "ESC_STATUS rpm" and len(view.speeds.u) == 8
    assert any("4 more" in note for note in view.notes)


def test_nan_everywhere_is_unknown_not_a_crash(airframe: Airframe, model: RotorModel) -> None:
    nan = math.nan
    view = look(
        airframe,
        model,
        heartbeat(),
        attitude(nan, nan, nan),
        position(nan),
        EscStatus(0, [nan] * 4),
        servo(),  # type: ignore[list-item]
    )
    v = view.vehicle
    assert v is not None
    assert (v.roll_rad, v.pitch_rad, v.yaw_rad, v.height_m) == (None, None, None, None)
    assert view.speeds.source == "SERVO_OUTPUT_RAW"
    json.dumps(to_json(view), allow_nan=False)


def test_nan_and_infinite_parameters_do_not_break_the_table(airframe: Airframe, model: RotorModel) -> None:
    messages = [heartbeat(), servo()]
    messages += [parameter("CA_ROTOR_COUNT", math.nan), parameter("THR_MDL_FAC", math.inf)]
    view = look(airframe, model, *messages)
    assert view.board.state in ("unread", "invalid", "partial")


def test_standing_rotors_make_no_thrust_and_no_split(airframe: Airframe, model: RotorModel) -> None:
    view = look(airframe, model, heartbeat(armed=False), servo((900,) * 8))
    assert view.balance.thrust_N == 0.0  # not the 0.801 N of the fit's constant
    assert all(a.upper_share is None for a in view.arms)
    assert view.vehicle is not None and not view.vehicle.armed


def test_stale_speeds_keep_their_number_and_are_marked(airframe: Airframe, model: RotorModel) -> None:
    collector, sender = Collector(), Sender()
    collector.take(sender(heartbeat()), 1.0)
    collector.take(sender(servo()), 1.0)
    collector.take(sender(heartbeat()), 4.0)
    view = observe(collector.readings(4.0), Vehicle(airframe, model), 4.0)
    assert view.link.state == "live" and view.speeds_stale
    assert view.speeds_age_s == pytest.approx(3.0)
    assert view.arms[0].upper.thrust_N == pytest.approx(UPPER_441)


def test_stale_esc_gives_way_to_fresh_outputs(airframe: Airframe, model: RotorModel) -> None:
    collector, sender = Collector(), Sender()
    collector.take(sender(heartbeat()), 1.0)
    for k in (0, 4):
        collector.take(sender(EscStatus(k, [2700 + k] * 4)), 1.0)
    collector.take(sender(servo()), 4.0)
    view = observe(collector.readings(4.0), Vehicle(airframe, model), 4.0)
    assert view.speeds.source == "SERVO_OUTPUT_RAW" and "ESC_STATUS went quiet" in view.notes


def test_link_is_lost_after_silence_and_live_again(airframe: Airframe, model: RotorModel) -> None:
    collector, sender = Collector(), Sender()
    collector.take(sender(heartbeat()), 1.0)
    lost = observe(collector.readings(9.0), Vehicle(airframe, model), 9.0).link
    assert lost.state == "lost" and lost.age_s == pytest.approx(8.0) and lost.rate_hz == 0.0
    collector.take(sender(heartbeat()), 9.5)
    assert observe(collector.readings(9.6), Vehicle(airframe, model), 9.6).link.state == "live"


def test_loss_and_rate_come_from_sequence_numbers() -> None:
    collector, sender = Collector(), Sender()
    sender.sequence = 250  # wraps at 256 on the way
    for k in range(50):
        collector.take(sender(heartbeat(), skip=1 if k and k % 5 == 0 else 0), k * 0.1)
    traffic = collector.readings(4.9).traffic
    assert (traffic.received, traffic.missed) == (50, 9)
    assert traffic.loss == pytest.approx(9 / 59)
    assert traffic.rate_hz == pytest.approx(50 / 4.9, rel=0.02)


def test_a_sender_that_starts_again_has_lost_nothing() -> None:
    collector, sender = Collector(), Sender()
    sender.sequence = 200
    collector.take(sender(heartbeat()), 0.0)
    sender.sequence = 0  # 55 further on, modulo 256: counted; 199 back: not
    collector.take(sender(heartbeat()), 0.1)
    sender.sequence = 150
    collector.take(sender(heartbeat()), 0.2)
    assert collector.readings(0.3).traffic.missed == 55


def test_ground_stations_and_other_vehicles_do_not_mix_in(airframe: Airframe, model: RotorModel) -> None:
    collector, one, two, station = Collector(), Sender(1), Sender(2), Sender(255, 190)
    collector.take(station(heartbeat(autopilot=8)), 1.0)
    assert collector.readings(1.0).target is None
    collector.take(one(heartbeat()), 1.0)
    collector.take(two(heartbeat()), 1.0)
    collector.take(two(attitude(roll=1.0)), 1.0)
    readings = collector.readings(1.0)
    assert readings.target == (1, 1) and readings.others == (2,) and "ATTITUDE" not in readings.latest
    assert any("system 2" in note for note in observe(readings, Vehicle(airframe, model), 1.0).notes)


def test_bytewise_integers_of_px4() -> None:
    collector, sender = Collector(), Sender()
    collector.take(sender(heartbeat()), 1.0)
    collector.take(sender(parameter("CA_ROTOR_COUNT", 1.1210387714598537e-44, kind=6)), 1.0)
    assert collector.readings(1.0).parameters == {"CA_ROTOR_COUNT": 8.0}


def test_single_rotors_are_arms_of_their_own(tmp_path: Path, model: RotorModel) -> None:
    text = files.read_text(files.example("x8_paper.toml"))
    rotors = text.split("[[rotors]]")
    quad = rotors[0] + "".join("[[rotors]]" + r.split("level")[0] + 'level = "single"\n' for r in rotors[1:5])
    path = tmp_path / "quad.toml"
    path.write_text(quad)
    view = look(load_airframe(path), model, heartbeat(), servo((1441,) * 4))
    assert [a.lower for a in view.arms] == [None] * 4
    assert view.balance.thrust_N == pytest.approx(4 * UPPER_441)
    assert view.balance.upper_share is None


@pytest.mark.parametrize(
    ("position", "name"),
    [
        ((0.2, 0.2), "front right"),
        ((-0.2, -0.2), "rear left"),
        ((0.3, 0.01), "front"),
        ((0.0, -0.3), "left"),
        ((0.0, 0.0), "centre"),
    ],
)
def test_arm_names(position: tuple[float, float], name: str) -> None:
    assert arm_name(*position) == name


def test_effects_of_the_rotor_file_are_said_to_be_left_out(airframe: Airframe, model: RotorModel) -> None:
    from coaxlink.rotor import EffectEntry as Effect

    with_effect = dataclasses.replace(model, effects=(Effect("rotor_drag", {"k": 0.1}),))
    assert any("rotor_drag" in n for n in look(airframe, with_effect, heartbeat()).notes)


def test_text_without_control_characters(airframe: Airframe, model: RotorModel) -> None:
    from pymavlink.dialects.v20 import common as mavlink

    text = mavlink.MAVLink_statustext_message(4, b"\x1b[31mArming\x07 denied")
    view = look(airframe, model, heartbeat(), text)
    assert view.vehicle is not None and view.vehicle.text == r"\x1b[31mArming\x07 denied"


def test_watch_describes_the_table_again_after_an_upload(airframe: Airframe, model: RotorModel) -> None:
    watch = Watch("udpin:0.0.0.0:14550", Vehicle(airframe, model))
    assert watch.look(1.0).board.state == "unread"
    watch.collector.put_parameters({"CA_ROTOR_COUNT": 8.0})
    assert watch.look(1.0).board.state == "partial"


@pytest.mark.parametrize(("pulses", "live"), [((1441,) * 4 + (1648,) * 4, True), ((1290,) * 8, False)])
def test_a_legacy_demand_is_newtons_only_while_a_companion_mixes(
    airframe: Airframe, model: RotorModel, pulses: tuple[int, ...], live: bool
) -> None:
    from pymavlink.dialects.v20 import common as mavlink

    version = mavlink.MAVLink_autopilot_version_message(
        0, 1 << 24 | 13 << 16 | 3 << 8, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 0
    )
    controls = [0.0, 0.0, 0.0, 0.29, 0.0, 0.0, 0.0, 0.0]
    demand = mavlink.MAVLink_actuator_control_target_message(1000, 0, controls)
    b = look(airframe, model, heartbeat(), version, servo(pulses), demand).balance
    grid = [0.09 * k for k in range(11)]  # the lone rotor of eq. 18: least squares of p u^2 over 0..0.9
    thrust = [55.9517 * u**2 + 22.4464 * u for u in grid]
    p = sum(f * u**2 for f, u in zip(thrust, grid, strict=True)) / sum(u**4 for u in grid)
    if live:
        assert b.basis == "demand" and b.intended is not None and b.error is not None
        assert b.intended == pytest.approx((8 * p * 0.29, 0, 0, 0), rel=1e-4, abs=1e-4)
        assert b.error[0] == pytest.approx(4 * (UPPER_441 + LOWER_441_648) - 8 * p * 0.29, abs=0.1)
    else:
        assert b.error is None and "legacy mixer" in b.error_note


def test_two_vehicles_of_one_system_id_are_noticed(airframe: Airframe, model: RotorModel) -> None:
    collector, one, two = Collector(), Sender(), Sender()
    two.sequence = 100
    for k in range(100):
        for sender in (one, two) if k % 3 else (two, one):
            collector.take(sender(heartbeat()), 0.02 * k)
    view = observe(collector.readings(2.0), Vehicle(airframe, model), 2.0)
    assert view.link.loss is None and "two vehicles call themselves system 1" in view.notes[0]
    alone, single = Collector(), Sender()
    for k in range(100):
        alone.take(single(heartbeat(), skip=k % 4 == 0), 0.02 * k)
    assert not observe(alone.readings(2.0), Vehicle(airframe, model), 2.0).notes
