"""What a steady hover says of measured rotor speeds, from hand-made messages.

The hover of `HOVER_PULSES` carries 20 kg by eq. 17; thrust goes nearly as the square of speed, so that rpm
beyond the command by 1.111 (6000 / 5400, PX4's simulation) means about a fifth too much.
"""

from __future__ import annotations

import math
from typing import Any

import pytest
from monitor_messages import HOVER_PULSES, Scene, attitude, escs, heartbeat, position, servo
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.monitor.state.moment import Moment


class Flight(Scene):
    """A vehicle whose clock is the watch's own, looked at five times a second."""

    def fly(
        self,
        seconds: float,
        *,
        full_rpm: float,
        pulses: tuple[int, ...] = HOVER_PULSES,
        tilt: float = 0.0,
        sinking: float = 0.0,
        down: float = -3.0,
        armed: bool = True,
        landed: int | None = None,
        turning: float = 1.0,
    ) -> Moment:
        """`turning` is what the rotors do over their commands."""
        for _ in range(round(5 * seconds)):
            self.clock.sleep(0.2)
            ms = round(1000 * self.clock.now)
            rpm = [round(full_rpm * turning * (p - 1000) / 1000) for p in pulses]
            heard: list[Any] = [heartbeat(armed), servo(pulses), attitude(tilt, 0.0, 0.0, ms)]
            heard += [position(down, ms, sinking), escs(0, rpm[:4]), escs(4, rpm[4:])]
            if landed is not None:
                heard.append(mavlink.MAVLink_extended_sys_state_message(0, landed))
            view = self.look(*heard)
        return view


def test_a_simulations_rpm_is_passed_over_for_the_commands() -> None:
    flight = Flight()
    first = flight.fly(1.0, full_rpm=6000)
    assert first.speeds.source == "ESC_STATUS rpm"  # no hover of two seconds yet
    view = flight.fly(2.0, full_rpm=6000)
    assert view.speeds.source == "SERVO_OUTPUT_RAW" and view.speeds.basis == "commanded"
    assert view.balance.of_weight == pytest.approx(1.0, abs=0.01)
    note = view.notes[0]
    assert "ESC_STATUS rpm passed over, SERVO_OUTPUT_RAW used" in note and "the weight is 196 N" in note
    moved = flight.fly(1.0, full_rpm=6000, sinking=-3.0)  # the verdict outlives the hover
    assert moved.speeds.source == "SERVO_OUTPUT_RAW"
    mended = flight.fly(3.0, full_rpm=5400)  # and another hover mends it
    assert mended.speeds.source == "ESC_STATUS rpm" and not mended.notes


def test_only_a_steady_hover_judges() -> None:
    for how in (
        {"tilt": math.radians(12.0)},
        {"sinking": 1.0},
        {"armed": False},
        {"down": -0.2},
        {"landed": 1},
    ):
        view = Flight().fly(4.0, full_rpm=6000, **how)
        assert view.speeds.source == "ESC_STATUS rpm", how


def test_a_fall_that_gathers_speed_judges_nothing() -> None:
    flight = Flight()
    for k in range(20):
        view = flight.fly(0.2, full_rpm=6000, sinking=-0.45 + 0.4 * 0.2 * k)
        if k > 11:  # past half a metre a second it is no hover anyhow
            break
    assert view.speeds.source == "ESC_STATUS rpm"


def test_an_autopilot_that_says_it_flies_needs_no_height() -> None:
    assert Flight().fly(4.0, full_rpm=6000, down=0.0, landed=2).speeds.source == "SERVO_OUTPUT_RAW"


def test_ten_per_cent_of_thrust() -> None:
    for full, passed_over in ((5400, False), (5600, False), (5760, True), (4900, True)):
        view = Flight().fly(3.0, full_rpm=full)
        assert (view.speeds.source == "SERVO_OUTPUT_RAW") == passed_over, full


def test_a_low_pack_speaks_against_the_commands_not_the_escs() -> None:
    # asked for 15 % more speed than they reach: the measured speeds carry the weight
    pulses = tuple(round(1000 + 1.15 * (p - 1000)) for p in HOVER_PULSES)
    view = Flight().fly(4.0, full_rpm=5400, pulses=pulses, turning=1 / 1.15)
    assert view.speeds.source == "ESC_STATUS rpm"
    assert view.balance.of_weight == pytest.approx(1.0, abs=0.01)


def test_a_load_that_both_show_is_believed() -> None:
    pulses = tuple(round(1000 + 1.12 * (p - 1000)) for p in HOVER_PULSES)
    view = Flight().fly(4.0, full_rpm=5400, pulses=pulses)
    assert view.speeds.source == "ESC_STATUS rpm" and view.balance.of_weight == pytest.approx(1.2, abs=0.03)


def test_the_escs_are_kept_where_the_commands_are_no_better() -> None:
    # 1.33 of the weight by the ESCs, 1.9 by the commands: neither is right, the ESCs are nearer
    pulses = tuple(round(1000 + 1.4 * (p - 1000)) for p in HOVER_PULSES)
    view = Flight().fly(4.0, full_rpm=5400, pulses=pulses, turning=1.16 / 1.4)
    assert view.speeds.source == "ESC_STATUS rpm"


def test_without_commands_there_is_nothing_to_turn_to() -> None:
    flight = Flight()
    flight.fly(4.0, full_rpm=6000)
    for _ in range(15):
        flight.clock.sleep(0.2)
        view = flight.look(escs(0, [2646] * 4), escs(4, [3888] * 4))
    assert view.speeds.source == "ESC_STATUS rpm"
