"""MAVLink 2 signing on the stand-in: with a key nothing unsigned is taken, and a key may be set up."""

import os
import socket
import time
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil

from sim.errors import WorldError
from sim.testing import standin
from sim.world import read_key

KEY = bytes(range(32))


def client(port: int, key: bytes | None) -> Any:
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255, dialect="common")
    if key is not None:
        link.setup_signing(key, sign_outgoing=True)
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    return link


def takes(link: Any, number: float, name: bytes = b"CA_ROTOR0_CT") -> bool:
    """Whether a parameter set comes back with the new value."""
    link.mav.param_set_send(1, 1, name, number, 9)
    while (message := link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.7)) is not None:
        if message.param_value == number:
            return True
    return False


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_only_who_has_the_key_is_heard(tmp_path: Path, firmware: str) -> None:
    (tmp_path / "key").write_bytes(KEY)
    name = b"CA_ROTOR0_CT" if firmware == "px4" else b"MOT_THST_EXPO"

    with standin("--firmware", firmware, "--signing-key", str(tmp_path / "key")) as port:
        friend, stranger, forger = client(port, KEY), client(port, None), client(port, bytes(32 * [7]))
        assert friend.wait_heartbeat(timeout=600) is not None
        assert takes(friend, 0.5, name)
        assert not takes(stranger, 0.75, name) and not takes(forger, 0.75, name)
        friend.mav.param_request_read_send(1, 1, name, -1)
        assert friend.recv_match(type="PARAM_VALUE", blocking=True, timeout=600).param_value == 0.5
        for link in (friend, stranger, forger):
            link.close()


def test_a_key_is_set_up_and_taken_away() -> None:
    with standin() as port:
        link = client(port, None)
        assert link.wait_heartbeat(timeout=600) is not None
        link.mav.setup_signing_send(1, 1, KEY, int((time.time() - 1420070400) * 1e5))
        assert not takes(link, 9.0)
        link.setup_signing(KEY, sign_outgoing=True)
        assert takes(link, 9.0)
        link.mav.setup_signing_send(1, 1, bytes(32), 0)
        link.disable_signing()
        assert takes(link, 8.0)
        link.close()


def test_keys_are_read_as_ground_stations_write_them(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    path.write_text(KEY.hex() + "\n")
    assert read_key(path) == KEY
    path.write_text("open sesame")
    assert len(read_key(path)) == 32
    path.write_text("")
    with pytest.raises(WorldError, match="found nothing"):
        read_key(path)
    with pytest.raises(WorldError, match="cannot be read"):
        read_key(tmp_path / "none")


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_what_was_said_on_one_link_is_a_replay_on_another(tmp_path: Path, firmware: str) -> None:
    (tmp_path / "key").write_bytes(KEY)
    name = b"CA_ROTOR0_CT" if firmware == "px4" else b"MOT_THST_EXPO"
    with standin("--firmware", firmware, "--signing-key", str(tmp_path / "key")) as port:
        friend = client(port, KEY)
        assert friend.wait_heartbeat(timeout=600) is not None
        said: list[bytes] = []
        write = friend.write
        friend.write = lambda data: said.append(bytes(data)) or write(data)
        assert takes(friend, 0.5, name) and takes(friend, 0.625, name)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
            for frame in said:
                thief.sendto(frame, ("127.0.0.1", port))
            future = bytearray(said[-1])
            future[-12:-6] = b"\xff" * 6  # a forger must not move the clock of the true sender
            thief.sendto(future, ("127.0.0.1", port))
            time.sleep(0.3)
            friend.mav.param_request_read_send(1, 1, name, -1)
            answer = friend.recv_match(type="PARAM_VALUE", blocking=True, timeout=600)
        assert answer is not None and answer.param_value == 0.625
        friend.close()


def test_a_key_may_be_taken_away_again(tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(KEY)
    with standin("--signing-key", str(tmp_path / "key")) as port:
        friend, plain = client(port, KEY), client(port, None)
        assert friend.wait_heartbeat(timeout=600) is not None
        assert not takes(plain, 0.75)
        friend.mav.setup_signing_send(1, 1, [0] * 32, 0)
        time.sleep(0.3)
        assert takes(plain, 0.75)
        for link in (friend, plain):
            link.close()
