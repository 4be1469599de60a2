"""The monitor against the stand-in autopilot in a process of its own, flying."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from test_monitor_board import table

from coaxlink import files
from coaxlink.airframe import load_airframe
from coaxlink.link import connect
from coaxlink.link.parameters import Parameters
from coaxlink.link.vehicle import Vehicle
from coaxlink.monitor.feed import Feed
from coaxlink.monitor.state import View
from coaxlink.monitor.watch import Watch
from coaxlink.rotor import load_rotor_model
from sim.testing import standin


def until(look: Callable[[], View], met: Callable[[View], bool], timeout_s: float = 20.0) -> View:
    end = time.monotonic() + timeout_s
    while not met(view := look()):
        assert time.monotonic() < end, f"not seen in time: {view}"
        time.sleep(0.1)
    return view


@pytest.mark.timeout(110)
def test_a_hover_and_an_upload_are_seen() -> None:
    airframe = load_airframe(files.example("x8_paper.toml"))
    model = load_rotor_model(files.example("rotor_paper.toml"))
    with standin("--speed", "4") as port:
        address = f"udpout:127.0.0.1:{port}"
        watch = Watch(address, airframe, model)
        feed = Feed(watch)
        feed.start()

        def look() -> View:
            return watch.look(time.monotonic())

        try:
            ground = until(look, lambda v: v.board.state == "read" and v.balance.thrust_N is not None)
            assert ground.vehicle is not None and not ground.vehicle.armed
            assert ground.balance.thrust_N == 0.0 and ground.board.kind == "standard"
            with connect(address) as session:
                parameters = Parameters(session)
                for name, value in table(73.06, 73.06, km=1.9 / 73.06).items():
                    parameters.write(name, value, 6 if name.endswith(("COUNT", "AIRFRAME", "METHOD")) else 9)
                vehicle = Vehicle(session)
                vehicle.arm()
                vehicle.take_off(3.0)
            hover = until(
                look, lambda v: v.board.digest != ground.board.digest and v.balance.error is not None
            )
            time.sleep(0.5)
            hover = look()
        finally:
            feed.stop()
    assert feed.failure is None
    assert hover.speeds.source == "ESC_STATUS rpm" and hover.speeds.basis == "measured"
    assert hover.vehicle is not None and hover.vehicle.armed and hover.link.state == "live"
    # it hovers, so the thrust is its weight; equal speeds leave the lower rotors the smaller part
    assert hover.balance.of_weight == pytest.approx(1.0, abs=0.06)
    assert hover.balance.upper_share == pytest.approx(0.66, abs=0.03)
    assert hover.board.upper_ct == pytest.approx(73.06)
