"""Sharing the line: one ground station, the one named or the first that speaks; nobody else through us."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from live_line import RIVAL, Session
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError
from coaxlink.live.forward import LEFT_S, Forwarder, parse_forward
from coaxlink.studies.simulator import free_port


def frame(message: Any) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, 255, 190)))


ASK = frame(mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_THR_HOVER", -1))


class Line(Session):
    """The vehicle's side."""

    def __init__(self) -> None:
        super().__init__()
        self.to_vehicle: list[bytes] = []

    def send_bytes(self, data: bytes) -> None:
        self.to_vehicle.append(data)


@pytest.fixture
def ground() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        s.settimeout(5.0)
        yield s


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 600.0
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    assert true()


def test_both_ways_through_real_sockets(ground: socket.socket) -> None:
    session = Line()
    with Forwarder(session, f"127.0.0.1:{ground.getsockname()[1]}") as forward:  # type: ignore[arg-type]
        assert forward.own_address[0] == "127.0.0.1" and not forward.exposed  # no interface of the network
        forward.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        _, own_address = ground.recvfrom(2048)
        ground.sendto(ASK, own_address)
        until(lambda: session.to_vehicle == [ASK])
    assert not session.listeners


@pytest.fixture
def listening() -> Iterator[Callable[..., tuple[Line, Forwarder]]]:
    """Makes one whose port nobody reads: what comes is handed in."""
    made = []

    def make(where: str = "udpin:PORT") -> tuple[Line, Forwarder]:
        session = Line()
        made.append(Forwarder(session, where.replace("PORT", str(free_port()))))  # type: ignore[arg-type]
        return session, made[-1]

    yield make
    for forward in made:
        forward._socket.close()


def test_towards_a_ground_station_that_is_named_nobody_elses_words_pass(listening: Any) -> None:
    session, forward = listening("127.0.0.1:14550")
    named, stranger = ("127.0.0.1", 14550), ("127.0.0.1", 14551)
    forward.pass_on(ASK, stranger, 0.0)
    forward.pass_on(ASK, named, 0.0)
    forward.pass_on(frame(RIVAL), named, 0.0)  # a frame that commands motors
    assert session.to_vehicle == [ASK] and (forward.strangers, forward.held_back) == (1, 1)


def test_at_a_port_of_ours_the_first_that_speaks_mavlink_is_the_ground_station(listening: Any) -> None:
    session, forward = listening()
    one, two = ("127.0.0.1", 5), ("127.0.0.1", 6)
    forward.pass_on(b"\xfd junk that is no frame", two, 0.0)
    forward.pass_on(ASK, one, 0.1)
    forward.pass_on(ASK, two, 0.2)
    assert session.to_vehicle == [ASK] and forward.strangers == 2


def test_a_ground_station_that_left_may_come_back_by_another_port_of_its_host_only(listening: Any) -> None:
    session, forward = listening()
    first, again, other = ("10.1.1.1", 5), ("10.1.1.1", 6), ("10.1.1.2", 5)
    forward.pass_on(ASK, first, 100.0)
    forward.pass_on(ASK, again, 100.0 + LEFT_S / 2)
    forward.pass_on(ASK, other, 100.0 + 3 * LEFT_S)
    assert (len(session.to_vehicle), forward.strangers) == (1, 2)
    forward.pass_on(ASK, again, 100.0 + 3 * LEFT_S)
    forward.pass_on(ASK, first, 100.0 + 3 * LEFT_S + 1.0)
    assert (len(session.to_vehicle), forward.strangers) == (2, 3)


def test_the_network_is_listened_to_only_when_it_is_asked_for(listening: Any) -> None:
    for where, kind, host in (
        ("udpin:14550", "udpin", "127.0.0.1"),
        ("udpin::14550", "udpin", "127.0.0.1"),
        ("udpin://:14550", "udpin", "127.0.0.1"),
        ("udpin:0.0.0.0:14550", "udpin", "0.0.0.0"),
        ("127.0.0.1:14550", "udpout", "127.0.0.1"),
        ("udpout:127.0.0.1:14550", "udpout", "127.0.0.1"),
    ):
        address = parse_forward(where)
        assert (address.kind, address.host, address.port) == (kind, host, 14550), where
    assert listening("udpin:0.0.0.0:PORT")[1].exposed and not listening()[1].exposed


def test_what_is_no_place_of_a_ground_station_is_refused(ground: socket.socket, listening: Any) -> None:
    for where in ("", "14550", "udpin:", "tcp:127.0.0.1:5", "127.0.0.1:99999", ":14550"):
        with pytest.raises(InputError, match="HOST:PORT"):
            parse_forward(where)
    with pytest.raises(LinkError, match="`forward`"):
        listening(f"udpin:{ground.getsockname()[1]}")  # taken
