"""What is marked: motors at their bound, the ideal split, ESC readings, the battery's word and minutes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from monitor_messages import EscStatus, Sender, attitude, battery, heartbeat, parameter, position, servo

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.mixer import make_law
from coaxlink.monitor.state import View, observe
from coaxlink.monitor.telemetry.battery import Drain
from coaxlink.monitor.telemetry.readings import Collector
from coaxlink.monitor.watch import Watch
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle
from firmware_params.ardupilot.messages import MAVLink_esc_telemetry_1_to_4_message as EscTelemetry

AIRFRAME = load_airframe(files.example("x8_paper.toml"))
MODEL = load_rotor_model(files.example("rotor_paper.toml"))


def see(*messages: object, now: float = 1.0, **rest: object) -> View:
    collector, sender = Collector(), Sender()
    for message in messages:
        collector.take(sender(message), 1.0)
    return observe(collector.readings(now), Vehicle(AIRFRAME, MODEL), now, **rest)


def bounds(view: View) -> list[str]:
    return [r.bound for arm in view.arms for r in (arm.upper, arm.lower) if r]


def test_a_motor_at_full_command_is_at_max_and_one_step_below_is_not() -> None:
    pulses = (2000, 1999, 1441, 1441, 1648, 1648, 1648, 1648)
    view = see(heartbeat(), servo(pulses))
    assert [a.upper.bound for a in view.arms] == ["max", "", "", ""]


@pytest.mark.parametrize(
    ("armed", "down", "autopilot", "least", "pulse", "bound"),
    [
        (True, -3.0, 12, None, 1000, "min"),
        (True, -3.0, 12, None, 1001, ""),
        (True, -0.1, 12, None, 1000, ""),  # it stands: motors may
        (False, -3.0, 12, None, 1000, ""),
        (True, -3.0, 3, 0.15, 1150, "min"),  # ArduPilot goes no lower in flight
        (True, -3.0, 3, 0.15, 1152, ""),
    ],
)
def test_a_motor_at_its_least_is_at_min_only_in_flight(
    armed: bool, down: float, autopilot: int, least: float | None, pulse: int, bound: str
) -> None:
    parameters = [] if least is None else [parameter("MOT_SPIN_MIN", least)]
    pulses = (pulse, *[1500] * 7)
    view = see(heartbeat(armed, autopilot=autopilot), *parameters, position(down), servo(pulses))
    assert bounds(view) == [bound] + [""] * 7


def test_the_ideal_split_is_the_actual_one_where_the_exact_law_flies_and_another_elsewhere() -> None:
    law = make_law("exact", Vehicle(AIRFRAME, MODEL))
    good = see(heartbeat(), servo(), law=law)  # the exact split in hover
    for arm in good.arms:
        assert arm.ideal_share == pytest.approx(arm.upper_share, abs=0.002)
    equal = see(heartbeat(), servo((1560,) * 8), law=law)
    for arm in equal.arms:
        assert arm.upper_share is not None and arm.upper_share > 0.6
        assert arm.ideal_share == pytest.approx(0.42, abs=0.02)
    assert all(a.ideal_share is None for a in see(heartbeat(), servo((1000,) * 8), law=law).arms)


def test_current_and_temperature_are_shown_where_they_are_sent() -> None:
    px4 = see(heartbeat(), servo(), EscStatus(0, [2381] * 4), EscStatus(4, [3499] * 4)).arms[0]
    assert px4.upper.current_A == 5.0 and px4.upper.temperature_C is None
    silent = EscStatus(0, [2381] * 4)
    silent.current = [0.0] * 4
    assert see(heartbeat(), servo(), silent).arms[0].upper.current_A is None
    sent = EscTelemetry([41, 42, 0, 44], [0] * 4, [1030, 900, 800, 700], [0] * 4, [2381] * 4, [1] * 4)
    view = see(heartbeat(autopilot=3), servo(), sent)
    uppers = [a.upper for a in view.arms]
    assert [r.current_A for r in uppers] == [10.3, 9.0, 8.0, 7.0]
    assert [r.temperature_C for r in uppers] == [41.0, 42.0, None, 44.0]
    assert not view.escs_stale and see(heartbeat(autopilot=3), servo(), sent, now=3.0).escs_stale


@pytest.mark.parametrize(
    ("remaining", "threshold", "state", "word"),
    [
        (83, None, 0, "ok"),
        (15, None, 0, "low"),
        (7, None, 0, "critical"),
        (5, None, 0, "emergency"),
        (25, 0.3, 0, "low"),  # the board's own threshold
        (83, None, 3, "critical"),  # the autopilot's word
        (5, None, 1, "emergency"),  # the worse of the two
        (83, None, 6, "unhealthy"),
        (-1, None, 0, ""),
    ],
)
def test_the_battery_s_word(remaining: int, threshold: float | None, state: int, word: str) -> None:
    pack = battery(remaining=remaining)
    pack.charge_state = state
    heard = [] if threshold is None else [parameter("BAT_LOW_THR", threshold)]
    vehicle = see(heartbeat(), *heard, pack).vehicle
    assert vehicle is not None and vehicle.battery_word == word


def test_minutes_are_the_autopilot_s_else_by_energy_else_by_the_trend() -> None:
    def minutes(pack: object, trend: float | None = None, energy_Wh: float | None = None) -> tuple:
        collector, sender = Collector(), Sender()
        for message in (heartbeat(), pack):
            collector.take(sender(message), 1.0)
        airframe = replace(AIRFRAME, battery_Wh=energy_Wh)
        said = observe(collector.readings(1.0), Vehicle(airframe, MODEL), 1.0, trend_min=trend).vehicle
        assert said is not None
        return said.battery_minutes, said.battery_minutes_by

    message = battery()
    message.time_remaining = 600
    assert minutes(message, 3.0, 500.0) == (10.0, "autopilot")
    power_W = 24.8 * 31.5
    assert minutes(battery(), 3.0, 500.0) == (pytest.approx(60 * 500 * 0.83 / power_W), "battery_Wh")
    assert minutes(battery(), 3.0) == (3.0, "trend")
    assert minutes(battery()) == (None, "")


def test_the_trend_counts_from_fall_to_fall_and_begins_anew_with_a_new_pack() -> None:
    drain = Drain()
    for second in range(200):  # 1 % in 10 s
        drain = drain.extended(float(second), round(0.90 - 0.001 * second, 2), True)
        assert second > 30 or drain.minutes is None
    assert drain.minutes == pytest.approx(drain.falls[-1][1] / 0.1 * 100 / 60, rel=0.02)
    assert drain.extended(200.0, 0.95, True).minutes is None
    assert drain.extended(5.0, 0.5, True).minutes is None  # the vehicle restarted


def test_what_a_pack_lost_on_the_ground_says_nothing_of_the_flight() -> None:
    watch, send = Watch("", Vehicle(AIRFRAME, MODEL)), Sender()

    def left(second: int, armed: bool, percent: int) -> float | None:
        for message in (heartbeat(armed), battery(remaining=percent), attitude(boot_ms=1000 * second)):
            watch.collector.take(send(message), float(second))
        vehicle = watch.look(float(second)).vehicle
        assert vehicle is not None
        return vehicle.battery_minutes

    ground = [left(second, False, 99 - second // 60) for second in range(280)]  # 1 % a minute
    assert set(ground) == {None}
    flight = [left(280 + second, True, 95 - second // 3) for second in range(31)]  # 1 % in 3 s
    assert flight[9] is None and flight[-1] == pytest.approx(85 * 3 / 60, rel=0.05)


def test_attitude_alone_does_not_make_a_battery() -> None:
    vehicle = see(heartbeat(), attitude()).vehicle
    assert vehicle is not None and vehicle.battery_word == "" and vehicle.battery_minutes is None
