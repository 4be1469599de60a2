"""The store of newest telemetry: what is decoded, what is passed over, how old it is."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.mavlink.clock import VirtualClock
from coaxlink.mavlink.telemetry import ON_BOARD, STALE_S, Telemetry
from firmware_params.ardupilot.messages import MAVLink_esc_telemetry_5_to_8_message as EscTelemetry
from firmware_params.px4.messages import MAVLink_esc_info_message as EscInfo
from firmware_params.px4.messages import MAVLink_esc_status_message as EscStatus
from sim.words import spoken


def heard(*messages: Any) -> Telemetry:
    telemetry = Telemetry(VirtualClock().monotonic)
    for message in messages:
        telemetry.hear(message)
    return telemetry


def battery(cells: list[int], *, remaining: int = 80, number: int = 0) -> Any:
    padded = [*cells, *[0xFFFF] * (10 - len(cells))]
    return mavlink.MAVLink_battery_status_message(number, 0, 1, 32767, padded, 1250, -1, -1, remaining)


def sys_status(millivolts: int) -> Any:
    return mavlink.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, -1, 0, 0, 0, 0, 0, 0)


def distance(cm: int, orientation: int = 25) -> Any:
    return mavlink.MAVLink_distance_sensor_message(0, 20, 400, cm, 0, 0, orientation, 1)


def test_every_quantity_is_decoded_in_its_unit() -> None:
    cases: list[tuple[Any, str, Any]] = [
        (mavlink.MAVLink_attitude_message(0, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0), "attitude", (0.1, 0.2, 0.3)),
        (mavlink.MAVLink_attitude_message(0, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0), "rates", (1.0, 2.0, 3.0)),
        (
            mavlink.MAVLink_local_position_ned_message(0, 1.0, 2.0, -3.0, 4.0, 5.0, 6.0),
            "position",
            (1, 2, -3),
        ),
        (mavlink.MAVLink_local_position_ned_message(0, 1.0, 2.0, -3.0, 4.0, 5.0, 6.0), "velocity", (4, 5, 6)),
        (mavlink.MAVLink_local_position_ned_message(0, 1.0, 2.0, -3.0, 4.0, 5.0, 6.0), "sinking", 6.0),
        (mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 1.5), "sinking", -1.5),
        (mavlink.MAVLink_global_position_int_message(0, 0, 0, 512000, 7500, 0, 0, 50, 0), "home_height", 7.5),
        (mavlink.MAVLink_global_position_int_message(0, 0, 0, 512000, 7500, 0, 0, 50, 0), "altitude", 512.0),
        (distance(125), "height", 1.25),
        (distance(500), "height", None),  # beyond what it can see
        (distance(125, orientation=0), "height", None),  # looks ahead
        (mavlink.MAVLink_scaled_pressure_message(0, 1013.25, 0.0, 4000), "pressure", 101325.0),
        (mavlink.MAVLink_hygrometer_sensor_message(0, 2150, 5000), "air", 21.5),
        (battery([8000, 8000, 8000]), "voltage", 24.0),
        (battery([8000], number=1), "voltage", None),  # of another circuit
        (battery([8000], number=1), "remaining", 0.8),
        (sys_status(24700), "voltage", 24.7),
        (sys_status(0), "voltage", None),  # no monitor is fitted
        (mavlink.MAVLink_attitude_message(0, math.nan, 0.2, 0.3, 1.0, 2.0, 3.0), "attitude", None),
    ]
    wrong = [
        f"{m.get_type()}: {name} is {heard(m).get(name)}, {value} is expected"
        for m, name, value in cases
        if heard(m).get(name) != (pytest.approx(value) if value is not None else None)
    ]
    assert wrong == []


def test_escs_are_told_apart_by_their_number() -> None:
    status = EscStatus(4, 0, [100, 200, 300, 400], [0.0] * 4, [1.0, 2.0, 3.0, math.nan])
    info = EscInfo(0, 0, 0, 8, 0, 0, [0] * 4, [0] * 4, [3150, 0, 32767, 4000])
    px4 = heard(status, info)
    assert {k: t.value for k, t in px4.each("esc_rpm").items()} == {4: 100, 5: 200, 6: 300, 7: 400}
    assert list(px4.each("esc_current")) == [4, 5, 6]  # the last one is no number
    assert {k: t.value for k, t in px4.each("esc_temperature").items()} == {0: 31.5, 3: 40.0}
    copter = heard(
        EscTelemetry([41, 0, 43, 44], [0] * 4, [1030, 900, 800, 700], [0] * 4, [2381] * 4, [1] * 4)
    )
    assert {k: t.value for k, t in copter.each("esc_temperature").items()} == {4: 41, 6: 43, 7: 44}
    assert copter.each("esc_current")[4] == (10.3, 1000.0, "ESC_TELEMETRY_5_TO_8")


def test_batteries_are_kept_by_their_id_and_the_board_s_own_beside_them() -> None:
    found = heard(battery([8000], number=1), sys_status(24700)).each("battery")
    assert list(found) == [1, ON_BOARD]
    assert (found[1].value.current_A, found[1].value.remaining) == (12.5, 0.8)
    assert (found[ON_BOARD].value.current_A, found[ON_BOARD].value.remaining) == (None, None)


def test_a_value_grows_stale_and_what_is_no_number_does_not_renew_it() -> None:
    clock = VirtualClock()
    telemetry = Telemetry(clock.monotonic)
    assert (telemetry.get("attitude"), telemetry.age("attitude")) == (None, 0.0)
    telemetry.hear(mavlink.MAVLink_attitude_message(7000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
    clock.sleep(1.0)
    telemetry.hear(mavlink.MAVLink_attitude_message(8000, math.nan, 0.2, 0.3, 0.0, 0.0, 0.0))
    assert telemetry.age("attitude") == 1.0 and telemetry.age("rates") == 0.0
    assert telemetry.get("attitude") is not None and telemetry.clock_s == 8.0
    clock.sleep(STALE_S)
    assert telemetry.get("attitude") is None
    assert telemetry.latest("attitude") == ((0.1, 0.2, 0.3), 1000.0, "ATTITUDE")
    telemetry.clear()
    assert telemetry.newest("ATTITUDE") is None and telemetry.clock_s is None


def test_armed_and_landed_are_the_last_word() -> None:
    telemetry = heard()
    assert not telemetry.armed and telemetry.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED
    for armed in (True, False):
        telemetry.hear(mavlink.MAVLink_heartbeat_message(14, 12, 128 if armed else 0, 0, 4, 3))
        assert telemetry.armed == armed
    telemetry.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR))
    assert telemetry.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR


def test_texts_are_plain_and_long_ones_are_joined() -> None:
    long = [mavlink.MAVLink_statustext_message(4, b"x" * 49 + b" ", 7, k) for k in range(2)]
    first, event = "Arming denied: Resolve system health failures first", "Preflight Fail: no words\t"
    telemetry = heard(
        mavlink.MAVLink_statustext_message(6, b"\x1b[31mArming\x07\0rest"), *long,
        *spoken(2, f"{first}\t"), *spoken(2, event),
    )  # fmt: skip
    assert [(t.word, t.text) for t in telemetry.texts] == [
        ("info", r"\x1b[31mArming\x07"), ("warning", f"{'x' * 49} {'x' * 49}"),
        ("critical", first), ("critical", event.strip()),
    ]  # fmt: skip
