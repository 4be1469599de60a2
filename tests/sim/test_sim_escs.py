"""What the stand-ins' ESCs tell, over the wire, and what an ArduPilot says to a request it does not know."""

from __future__ import annotations

import math
import os
import time

import numpy as np
import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from firmware_params.px4 import messages
from sim.physics.escs import KINDS
from sim.testing import standin

messages.register(ardupilotmega)
FULL_RPM = 5400.0  # of the paper's rotors


def link_to(port: int):
    address = f"udpout:127.0.0.1:{port}"
    link = mavutil.mavlink_connection(address, source_system=255, dialect="ardupilotmega")
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    assert link.wait_heartbeat(timeout=600) is not None
    return link


def ask(link, number: int) -> int:
    link.mav.command_long_send(1, 1, 511, 0, number, 50_000, 0, 0, 0, 0, 0)
    ack = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=600)
    return ack.result


def hovering(link, copter: bool) -> None:
    end, armed = time.monotonic() + 600.0, False
    while not armed:
        assert time.monotonic() < end
        if copter:
            link.mav.command_long_send(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0)
        link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        link.mav.command_long_send(1, 1, 22, 0, 0, 0, 0, math.nan, math.nan, math.nan, 3.0 if copter else 491)
        beat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.3)
        armed = beat is not None and beat.get_srcSystem() == 1 and beat.base_mode & 128 > 0
    servo = link.recv_match(type="SERVO_OUTPUT_RAW", blocking=True, timeout=600)
    while servo.servo1_raw < 1300:
        assert time.monotonic() < end + 60.0
        servo = link.recv_match(type="SERVO_OUTPUT_RAW", blocking=True, timeout=600)


@pytest.mark.parametrize("kind", KINDS)
def test_px4(kind: str) -> None:
    with standin("--esc", kind) as port:
        link = link_to(port)
        assert ask(link, 291) == 0
        hovering(link, copter=False)
        rpm, outputs = [], []
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            found = link.recv_match(type=["ESC_STATUS", "SERVO_OUTPUT_RAW"], blocking=True, timeout=0.5)
            if found is not None and found.get_type() == "ESC_STATUS":
                rpm += [found.rpm[:4]]
            elif found is not None:
                outputs.append([(found.servo1_raw - 1000) / 1000, (found.servo5_raw - 1000) / 1000])
        link.close()
    if kind == "none":
        assert not rpm
        return
    full = np.mean(rpm) / np.mean(outputs)
    assert full == pytest.approx(6000.0 if kind == "sitl" else FULL_RPM, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_ardupilot(kind: str) -> None:
    with standin("--firmware", "ardupilot", "--esc", kind) as port:
        link = link_to(port)
        assert ask(link, 36) == 0 and ask(link, 11030) == 0
        hovering(link, copter=True)
        found: dict[str, list[float]] = {}
        outputs = []
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            one = link.recv_match(blocking=True, timeout=0.5)
            if one is not None and one.get_type().startswith("ESC_TELEMETRY"):
                found.setdefault(one.get_type(), []).append(float(np.mean(one.rpm)))
            elif one is not None and one.get_type() == "SERVO_OUTPUT_RAW":
                outputs.append(np.mean([(getattr(one, f"servo{n}_raw") - 1000) / 1000 for n in range(1, 9)]))
        link.close()
    if kind == "none":
        assert not found
        return
    assert set(found) == {"ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8"}  # all for a request of the first
    turns = np.mean([np.mean(v) for v in found.values()])
    assert turns == (0.0 if kind == "sitl" else pytest.approx(np.mean(outputs) * FULL_RPM, rel=0.05))


def test_what_ardupilot_does_not_know_it_tells_everyone() -> None:
    with standin("--firmware", "ardupilot") as port:
        link = link_to(port)
        for number in (291, 11031):
            link.mav.command_long_send(1, 1, 511, 0, number, 50_000, 0, 0, 0, 0, 0)
            text = link.recv_match(type="STATUSTEXT", blocking=True, timeout=600)
            assert text.text == f"No ap_message for mavlink id ({number})"
            assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=600).result == 2  # denied
        link.close()
