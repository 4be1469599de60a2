"""Sharing the line: one ground station, the one named or the first that speaks; nobody else through us."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from coaxlink.errors import InputError, LinkError
from coaxlink.live.forward import LEFT_S, Forwarder, parse_forward

ASK = mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_THR_HOVER", -1)
RIVAL = mavlink.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8)


def frame(message: Any) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, 255, 190)))


class Session:
    """What a forwarder needs of one: the vehicle's side."""

    source = (245, 191)

    def __init__(self) -> None:
        self.to_vehicle: list[bytes] = []

    def send_bytes(self, data: bytes) -> None:
        self.to_vehicle.append(data)

    def subscribe(self, callback: Callable[[Any], None], *, whole_system: bool = False) -> Callable[[], None]:
        return lambda: None

    watch = subscribe


def udp() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", 0))
    s.settimeout(5.0)
    return s


@pytest.fixture
def ground() -> Iterator[socket.socket]:
    with udp() as s:
        yield s


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    with udp() as s:
        yield s


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 600.0
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    assert true()


def test_towards_a_ground_station_that_is_named_nobody_elses_words_pass(
    ground: socket.socket, stranger: socket.socket
) -> None:
    session = Session()
    with Forwarder(session, f"127.0.0.1:{ground.getsockname()[1]}") as forward:  # type: ignore[arg-type]
        assert forward.own_address[0] == "127.0.0.1"  # no interface of the network
        assert not forward.exposed
        forward.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        _, own_address = ground.recvfrom(2048)
        stranger.sendto(frame(ASK), own_address)
        until(lambda: forward.strangers == 1)
        ground.sendto(frame(ASK), own_address)
        until(lambda: session.to_vehicle == [frame(ASK)])
        ground.sendto(frame(RIVAL), own_address)
        until(lambda: forward.held_back == 1)
    assert session.to_vehicle == [frame(ASK)]


def test_at_a_port_of_ours_the_first_that_speaks_mavlink_is_the_ground_station(
    ground: socket.socket, stranger: socket.socket
) -> None:
    with udp() as free:
        port = free.getsockname()[1]
    session = Session()
    with Forwarder(session, f"udpin:{port}") as forward:  # type: ignore[arg-type]
        assert forward.own_address == ("127.0.0.1", port)
        stranger.sendto(b"\xfd junk that is no frame", forward.own_address)
        until(lambda: forward.strangers == 1)
        ground.sendto(frame(ASK), forward.own_address)
        until(lambda: len(session.to_vehicle) == 1)
        stranger.sendto(frame(ASK), forward.own_address)
        until(lambda: forward.strangers == 2)
        forward.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        assert ground.recv(2048)
    assert len(session.to_vehicle) == 1
    stranger.settimeout(0.05)
    with pytest.raises(TimeoutError):  # it was told nothing, either
        stranger.recv(2048)


def test_a_ground_station_that_left_may_come_back_by_another_port_of_its_host_only() -> None:
    with udp() as free:
        port = free.getsockname()[1]
    session = Session()
    with Forwarder(session, f"udpin:{port}") as forward:  # type: ignore[arg-type]
        first, again, other = ("10.1.1.1", 5), ("10.1.1.1", 6), ("10.1.1.2", 5)
        forward.pass_on(frame(ASK), first, 100.0)
        forward.pass_on(frame(ASK), again, 100.0 + LEFT_S / 2)
        forward.pass_on(frame(ASK), other, 100.0 + 3 * LEFT_S)
        assert (len(session.to_vehicle), forward.strangers) == (1, 2)
        forward.pass_on(frame(ASK), again, 100.0 + 3 * LEFT_S)
        assert len(session.to_vehicle) == 2
        forward.pass_on(frame(ASK), first, 100.0 + 3 * LEFT_S + 1.0)
        assert len(session.to_vehicle) == 2


@pytest.mark.parametrize(
    ("where", "kind", "host"),
    [
        ("udpin:14550", "udpin", "127.0.0.1"),
        ("udpin::14550", "udpin", "127.0.0.1"),
        ("udpin://:14550", "udpin", "127.0.0.1"),
        ("udpin:0.0.0.0:14550", "udpin", "0.0.0.0"),
        ("127.0.0.1:14550", "udpout", "127.0.0.1"),
        ("udpout:127.0.0.1:14550", "udpout", "127.0.0.1"),
    ],
)
def test_the_network_is_listened_to_only_when_it_is_asked_for(where: str, kind: str, host: str) -> None:
    address = parse_forward(where)
    assert (address.kind, address.host, address.port) == (kind, host, 14550)


def test_listening_on_every_interface_is_owned_up_to() -> None:
    with udp() as free:
        port = free.getsockname()[1]
    with Forwarder(Session(), f"udpin:0.0.0.0:{port}") as forward:  # type: ignore[arg-type]
        assert forward.exposed


@pytest.mark.parametrize("where", ["", "14550", "udpin:", "tcp:127.0.0.1:5", "127.0.0.1:99999", ":14550"])
def test_what_is_no_place_of_a_ground_station_is_refused(where: str) -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        parse_forward(where)


def test_a_port_that_is_taken_is_one_line(ground: socket.socket) -> None:
    with pytest.raises(LinkError, match="`forward`"):
        Forwarder(Session(), f"udpin:{ground.getsockname()[1]}")  # type: ignore[arg-type]
