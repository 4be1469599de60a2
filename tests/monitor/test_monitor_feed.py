"""The feed over a real UDP port against a vehicle of a few lines: connect, table, upload, loss, return."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from monitor_vehicle import Vehicle
from test_monitor_board import table

import coaxlink as cx
from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.errors import InputError, LinkError
from coaxlink.monitor.feed import Feed, check_address
from coaxlink.monitor.state import View
from coaxlink.monitor.watch import Watch
from coaxlink.rotor import load_rotor_model
from coaxlink.studies.simulator import free_port


@pytest.fixture(autouse=True)
def _hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coaxlink.monitor.feed.SETTLE_S", 0.3)
    monkeypatch.setattr("coaxlink.monitor.feed.TABLE_EVERY_S", 0.5)
    monkeypatch.setattr("coaxlink.monitor.state.LOST_S", 1.0)


@contextmanager
def watching(port: int, patience_s: float = 0.7) -> Iterator[Callable[[], View]]:
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(files.example("rotor_paper.toml"))
    watch = Watch(f"udpin:127.0.0.1:{port}", cx.Vehicle(airframe, model))
    feed = Feed(watch, patience_s=patience_s)
    feed.start()
    try:
        yield lambda: watch.look(time.monotonic())
    finally:
        feed.stop()
    assert feed.failure is None


def until(look: Callable[[], View], met: Callable[[View], bool], timeout_s: float = 120.0) -> View:
    end = time.monotonic() + timeout_s
    while not met(view := look()):
        assert time.monotonic() < end, f"not seen in time: {view}"
        time.sleep(0.05)
    return view


def test_waits_then_lives_then_reads_the_table_and_sees_an_upload() -> None:
    port = free_port()
    with watching(port) as look:
        assert look().link.state == "waiting"
        time.sleep(1.0)  # longer than one attempt lasts: it tries again
        with Vehicle(port, table(73.06, 73.06)) as vehicle:
            live = until(look, lambda v: v.link.state == "live" and v.balance.thrust_N is not None)
            assert live.balance.of_weight == pytest.approx(1.0, abs=0.01)
            first = until(look, lambda v: v.board.state == "read")
            assert first.board.kind == "standard"
            assert first.vehicle is not None and first.vehicle.version == "1.16.1"
            assert first.balance.error is not None
            vehicle.parameters = table(46.95, 69.89)
            second = until(look, lambda v: v.board.kind == "reduced")
            assert second.board.digest != first.board.digest


def test_an_unchanged_table_is_not_read_over_and_over() -> None:
    port = free_port()
    with watching(port) as look, Vehicle(port, table(73.06, 73.06)) as vehicle:
        until(look, lambda v: v.board.state == "read")
        until(look, lambda v: vehicle.reads.count("_HASH_CHECK") >= 3)
        assert vehicle.reads.count("CA_ROTOR0_CT") == 1


def test_link_lost_is_shown_and_heals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coaxlink.monitor.feed.GONE_S", 2.0)
    port = free_port()
    with watching(port) as look, Vehicle(port) as vehicle:
        until(look, lambda v: v.balance.thrust_N is not None)
        vehicle.mute = True
        lost = until(look, lambda v: v.link.state == "lost")
        assert lost.arms[0].upper.thrust_N is not None
        time.sleep(1.8)  # long enough for the session to be given up
        vehicle.mute = False
        until(look, lambda v: v.link.state == "live" and not v.speeds_stale)


def test_addresses_are_checked_before_the_screen() -> None:
    with pytest.raises(InputError):
        check_address("carrier-pigeon")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match=r"cannot be opened|in use"):
            check_address(f"udpin:127.0.0.1:{holder.getsockname()[1]}")
    with pytest.raises(LinkError):
        check_address("/dev/no-such-line,57600")
    check_address("tcp:127.0.0.1:9")  # a server may come up later
