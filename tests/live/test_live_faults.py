"""What happens when something dies: each fault in flight on the stand-in, judged by the world's own account.

The milliseconds are those of docs/live.md, with room for a loaded machine where nothing hangs on it.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import slow_clock
from live_flight import EXAMPLES, Companion, Flight, demand, real_time

from coaxlink.airframe import load_airframe
from coaxlink.errors import SafetyRefusal
from coaxlink.live.mixer import LiveMixer
from coaxlink.mixer import make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")
SILENT_S = 0.080  # coaxlink's last word after the last good demand
AUTOPILOT_S = 0.100  # its own timeout
SLACK_S = 0.060  # a machine with other things to do


@pytest.fixture(scope="module")
def flight() -> Iterator[Flight]:
    vehicle = Flight()
    yield vehicle
    vehicle.close()


@pytest.fixture(scope="module", params=["plain", "compiled"])
def native(request: pytest.FixtureRequest) -> Any:
    """The loop in Python, and the compiled one that takes over wherever all is well."""
    if request.param == "plain":
        return None
    from coaxlink.live import compiled

    if not compiled.available():
        pytest.skip("the compiled loop runs on 64-bit Linux")
    return compiled.load()


class Live:
    """A companion that mixes, and the vehicle under it."""

    def __init__(self, flight: Flight, law: Any = None, component: int = 191, **options: Any) -> None:
        self.flight = flight
        self.companion = Companion(flight, component)
        law = law or make_law("exact", Vehicle(X8, CRM))
        self.mixer = LiveMixer(self.companion.session, Vehicle(X8, CRM), law, own_curve=1.0, **options)

    def start(self) -> None:
        starting = threading.Thread(target=self.mixer.start)
        starting.start()
        self.flight.fly(3.0, until=lambda: not starting.is_alive())
        starting.join()

    def until_live(self) -> None:
        self.flight.fly(3.0, until=lambda: self.mixer.state == "live")
        assert self.mixer.state == "live"
        self.flight.fly(0.3)
        self.flight.rows.clear()

    def close(self) -> None:
        self.mixer.session.tap = None
        self.companion.close()


@pytest.fixture
def live(flight: Flight, native: Any) -> Iterator[Live]:
    flight.back_to_hover()
    one = Live(flight, native=native)
    one.start()
    one.until_live()
    exchange = one.mixer.exchange
    if native is not None:
        assert exchange is not None
        flight.fly(30.0, until=lambda: exchange.answers > 20)
        assert exchange.answers > 20  # it is this loop that is tried
    flight.rows.clear()
    yield one
    one.close()
    flight.rush(0.2)


def stays_up(flight: Flight, seconds: float = 3.0) -> None:
    """The vehicle, alone again, neither hits the ground nor tips over, and every output was sound."""
    flight.rush(seconds)
    assert flight.outputs_are_sound()
    assert flight.lowest_m > 1.0
    assert flight.steepest_deg < 25.0
    assert not flight.autopilot.landed
    assert abs(flight.autopilot.plant.velocity[2]) < 0.5


def lose(message: Any) -> None:
    return None


def with_controls(values: list[float]) -> Any:
    return lambda message: demand(message.time_usec, values + [0.0] * 4)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lose, id="demand stops"),
        pytest.param(with_controls([math.nan, 0.0, 0.0, 0.3]), id="demand turns NaN"),
        pytest.param(with_controls([1e9, -1e30, 0.0, 0.3]), id="demand turns absurd"),
    ],
)
@real_time
def test_without_a_sane_demand_the_vehicle_is_handed_back_and_taken_again(live: Live, change: Any) -> None:
    flight, line = live.flight, live.companion.line
    before = live.mixer.summary()["hand_overs"]
    line.change = change
    stopped = time.monotonic()
    flight.fly(0.4)
    assert live.mixer.state == "silent"
    handed = flight.own_since(stopped)
    assert handed is not None
    assert 0.05 < handed < SILENT_S + AUTOPILOT_S + SLACK_S
    line.change = None
    took = flight.fly(1.0, until=lambda: flight.driven)
    assert took < 0.1 + SLACK_S
    live.until_live()
    assert live.mixer.summary()["hand_overs"] > before
    live.mixer.session.tap = None
    stays_up(flight)


@real_time
def test_the_motors_do_not_jump_when_the_demand_stops(live: Live) -> None:
    flight = live.flight
    live.companion.line.change = lose
    flight.fly(0.4)
    u = np.array([row[2] for row in flight.rows])
    # the law's lower rotors turn about 0.13 faster than its upper ones, the own mixer's alike
    step = np.abs(u[-1] - u[0]).max()
    assert step > 0.05
    assert np.abs(np.diff(u, axis=0)).max() < 0.75 * step


@real_time
def test_a_link_that_dies_and_returns(live: Live) -> None:
    flight, line = live.flight, live.companion.line
    line.dead = True
    died = time.monotonic()
    flight.fly(0.5)
    handed = flight.own_since(died)
    assert handed is not None
    assert handed < AUTOPILOT_S + SLACK_S
    assert live.mixer.state == "silent"
    line.dead = False
    assert flight.fly(1.0, until=lambda: flight.driven) < 0.1 + SLACK_S
    live.until_live()
    live.mixer.session.tap = None
    stays_up(flight)


@real_time
def test_a_demand_out_of_reach_gets_bounded_outputs_and_is_owned_up_to(live: Live) -> None:
    flight, left = live.flight, [8]

    def reach(message: Any) -> Any:
        left[0] -= 1
        return demand(message.time_usec, [0.0, 0.0, 1.0, 1.0] + [0.0] * 4) if left[0] >= 0 else message

    live.companion.line.change = reach
    flight.fly(0.3)
    assert live.mixer.state == "live"
    assert max(live.mixer.summary()["allocation_error"]["max"]) > 1.0
    live.mixer.session.tap = None
    stays_up(flight)


@pytest.mark.parametrize("jump_s", [3600.0, -30.0])
@real_time
def test_the_vehicles_clock_jumps(live: Live, jump_s: float) -> None:
    flight = live.flight

    def late(message: Any) -> Any:
        return demand(max(message.time_usec + round(jump_s * 1e6), 0), list(message.controls))

    flight.rush(0.0)
    live.companion.line.change = late
    flight.fly(0.4)
    assert all(row[1] for row in flight.rows)  # driven throughout
    assert live.mixer.state == "live"
    assert live.mixer.summary()["unanswered"]["clock_jumps"] == 1
    live.mixer.session.tap = None
    stays_up(flight)


@real_time
def test_our_own_wall_clock_jumps(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = live.flight
    real, real_ns = time.time, time.time_ns
    monkeypatch.setattr(time, "time", lambda: real() - 86400.0)
    monkeypatch.setattr(time, "time_ns", lambda: real_ns() - 86400 * 10**9)
    flight.fly(0.3)
    assert all(row[1] for row in flight.rows)
    assert live.mixer.state == "live"


def poison_compiled_law(live: Live) -> None:
    """No number is left in what the compiled loop's law works on."""
    if live.mixer.exchange is not None:
        for numbers in live.mixer.exchange.law:
            if numbers.dtype == float:
                numbers.fill(math.nan)


@real_time
def test_where_the_compiled_law_fails_the_plain_one_flies_on(live: Live) -> None:
    flight = live.flight
    poison_compiled_law(live)
    flight.fly(0.4)
    assert all(row[1] for row in flight.rows)
    assert not live.mixer.failed.is_set()
    live.mixer.session.tap = None
    stays_up(flight)


@real_time
def test_a_law_that_fails_in_flight(live: Live) -> None:
    flight = live.flight

    class Broken:
        name, dropped = "broken", ()

        def speeds(self, wrench: Any) -> Any:
            raise FloatingPointError("singular")

    live.mixer.core.law = Broken()
    poison_compiled_law(live)
    failed = time.monotonic()
    flight.fly(0.4)
    assert live.mixer.failed.is_set()
    handed = flight.own_since(failed)
    assert handed is not None
    assert handed < AUTOPILOT_S + SLACK_S
    stays_up(flight)


@real_time
def test_of_two_companions_one_lets_go_and_says_why(live: Live) -> None:
    flight = live.flight
    flight.fly(0.8)  # long enough for the first to have seen its outputs on the motors
    assert live.mixer.summary()["outputs_confirmed"]
    second = Live(flight, make_law("standard", Vehicle(X8, CRM)), component=192)
    second.start()
    pair = (second.mixer, live.mixer)
    took = flight.fly(8.0, until=lambda: any(m.failed.is_set() for m in pair))
    second.close()
    # the newcomer as a rule; on a machine that stalls the first may be the one that loses the motors
    gone = [m for m in pair if m.failed.is_set()]
    assert gone and took < 8.0
    for mixer in gone:
        assert isinstance(mixer.error, SafetyRefusal)
        assert "another companion" in str(mixer.error)
    flight.fly(0.3)
    # the first one keeps the vehicle, or let go: then the autopilot has it
    assert flight.driven != live.mixer.failed.is_set()
    live.mixer.session.tap = None
    stays_up(flight)


@contextmanager
def mixing_process(flight: Flight, *options: str) -> Iterator[subprocess.Popen[str]]:
    """`coaxlink mix` driving the vehicle, in a process of its own that does not outlive the test."""
    flight.back_to_hover()
    command = slow_clock.command("mix", str(EXAMPLES / "x8_demo.toml"), "--connect", flight.address, *options)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)
    try:
        flight.fly(120.0, until=lambda: flight.driven)
        flight.fly(0.6)
        assert flight.driven
        flight.rows.clear()
        yield process
    finally:
        process.kill()
        process.wait()


@real_time
def test_a_companion_starved_of_its_processor_and_then_killed(flight: Flight) -> None:
    with mixing_process(flight) as process:
        os.kill(process.pid, signal.SIGSTOP)
        stopped = time.monotonic()
        flight.fly(0.4)
        handed = flight.own_since(stopped)
        assert handed is not None
        assert handed < AUTOPILOT_S + SLACK_S
        flight.rows.clear()
        os.kill(process.pid, signal.SIGCONT)
        assert flight.fly(1.0, until=lambda: flight.driven) < 0.15 + SLACK_S
        flight.fly(0.5)
        assert flight.driven
        os.kill(process.pid, signal.SIGKILL)
        killed = time.monotonic()
        flight.fly(0.3)
        handed = flight.own_since(killed)
        assert handed is not None
        assert handed < AUTOPILOT_S + SLACK_S
        stays_up(flight)


@real_time
def test_a_companion_stopped_for_longer_than_a_link_may_be_silent_takes_the_vehicle_again(
    flight: Flight,
) -> None:
    with mixing_process(flight, "--lost", "1") as process:
        os.kill(process.pid, signal.SIGSTOP)
        flight.fly(3.5)
        assert not flight.driven
        os.kill(process.pid, signal.SIGCONT)
        assert flight.fly(1.0, until=lambda: flight.driven) < 0.15 + SLACK_S
        flight.fly(1.5)
        assert flight.driven
        assert process.poll() is None
        # nobody ticks the vehicle now: a link that is gone still ends it
        assert process.wait(60.0 * slow_clock.factor) == 3
        stays_up(flight)
