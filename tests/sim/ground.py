"""What the tests of the stand-ins talk with: a bare pymavlink client, and MAVSDK."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

os.environ.setdefault("MAVLINK20", "1")
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.system import System
from pymavlink import mavutil

PATIENCE_S = 60.0  # a guard against hanging: no answer is judged by when it came
AGAIN_S = 2.0  # a datagram may be lost where a busy machine reads slower than a vehicle talks


@contextmanager
def client(port: int, kind: str = "udpout", dialect: str = "ardupilotmega") -> Iterator[Any]:
    """A ground station, once it has heard a vehicle."""
    link = mavutil.mavlink_connection(f"{kind}:127.0.0.1:{port}", source_system=255, dialect=dialect)
    try:
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        assert link.wait_heartbeat(timeout=600) is not None
        yield link
    finally:
        link.close()


def get(
    link: Any, kind: str | list[str], timeout: float = PATIENCE_S, met: Callable[[Any], bool] = lambda _: True
) -> Any:
    """The next message of a kind that meets the condition; None when there was none in time."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        message = link.recv_match(type=kind, blocking=True, timeout=0.1)
        if message is not None and met(message):
            return message
    return None


def command(link: Any, number: int, *p: float, system: int = 1) -> int:
    """The vehicle's answer (MAV_RESULT) to a COMMAND_LONG."""
    ack = None
    for attempt in range(round(PATIENCE_S / AGAIN_S)):
        link.mav.command_long_send(system, 1, number, attempt, *[*p, *[0.0] * (7 - len(p))])
        ack = get(link, "COMMAND_ACK", AGAIN_S, lambda a: a.command == number)
        if ack is not None:
            break
    assert ack is not None, f"no answer to command {number}"
    assert ack.target_system in (0, 255)
    return int(ack.result)


@contextmanager
def mavsdk_system(port: int) -> Iterator[System]:
    """The vehicle at a port as MAVSDK sees it."""
    mavsdk = Mavsdk(Configuration.create_manual(245, 190, True))
    try:
        mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(timeout_s=60.0)
        assert system is not None
        yield system
    finally:
        mavsdk.destroy()


def until(met: Callable[[], bool], what: str) -> None:
    """Wait for it, and fail with these words when it does not come."""
    end = time.monotonic() + PATIENCE_S
    while not met():
        assert time.monotonic() < end, what
        time.sleep(0.02)
