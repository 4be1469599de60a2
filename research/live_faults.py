"""The milliseconds of docs/live.md's fault matrix, measured in flight on the stand-in.

    python research/live_faults.py [--times 5] [--way compiled|plain] [--curve 1]

For each fault: from its onset to the first tick flown on the autopilot's own mixer for good, what the height
and the tilt did in the 3 s after, and from its end to the first tick driven again.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "helpers"))

from live_flight import EXAMPLES, HEIGHT_M, Companion, Flight, demand

from coaxlink.airframe import load_airframe
from coaxlink.live import compiled
from coaxlink.live.mixer import LiveMixer
from coaxlink.mixer import make_law
from coaxlink.rotor.model import load_rotor_model
from coaxlink.vehicle import Vehicle

X8 = load_airframe(EXAMPLES / "x8_demo.toml")
CRM = load_rotor_model(EXAMPLES / "rotor_paper.toml")


class Own:
    """A companion in this process."""

    def __init__(self, flight: Flight, curve: float, native: Any) -> None:
        self.flight = flight
        self.companion = Companion(flight)
        law = make_law("exact", Vehicle(X8, CRM))
        self.mixer = LiveMixer(self.companion.session, Vehicle(X8, CRM), law, own_curve=curve, native=native)
        starting = threading.Thread(target=self.mixer.start)
        starting.start()
        flight.fly(3.0, until=lambda: not starting.is_alive())
        flight.fly(3.0, until=lambda: self.mixer.state == "live")
        flight.fly(1.0)
        if native is not None and (self.mixer.exchange is None or self.mixer.exchange.answers < 100):
            sys.exit("the compiled loop did not take over")

    def close(self) -> None:
        self.mixer.session.tap = None
        self.companion.close()


def broken(_: object) -> None:
    raise FloatingPointError("singular")


def set_change(values: list[float] | None) -> Callable[[Own], None]:
    def begin(own: Own) -> None:
        own.companion.line.change = (
            (lambda m: None) if values is None else (lambda m: demand(m.time_usec, values + [0.0] * 4))
        )

    return begin


def die(own: Own) -> None:
    own.companion.line.dead = True


def break_law(own: Own) -> None:
    own.mixer.core.law = type(
        "Broken", (), {"name": "broken", "dropped": (), "speeds": staticmethod(broken)}
    )()
    if own.mixer.exchange is not None:
        for numbers in own.mixer.exchange.law:
            if numbers.dtype == float:
                numbers.fill(math.nan)


FAULTS: dict[str, Callable[[Own], None]] = {
    "demand stops": set_change(None),
    "demand turns NaN": set_change([math.nan, 0.0, 0.0, 0.3]),
    "demand turns absurd": set_change([1e9, -1e30, 0.0, 0.3]),
    "link dies": die,
    "law fails": break_law,
}


def aftermath(flight: Flight) -> tuple[float, float]:
    """(m lost, deg of tilt) in the 3 s after."""
    flight.rush(3.0)
    return HEIGHT_M + 0.2 - flight.lowest_m, flight.steepest_deg


def in_process(name: str, curve: float, native: Any) -> tuple[float, float, float, float]:
    flight = Flight(own_curve=curve)
    own = Own(flight, curve, native)
    flight.rows.clear()
    FAULTS[name](own)
    since = time.monotonic()
    flight.fly(0.35)
    handed = flight.own_since(since)
    own.companion.line.change, own.companion.line.dead = None, False
    back = math.nan
    if name != "law fails":
        back = flight.fly(1.0, until=lambda: flight.driven)
    own.close()
    lost, tilt = aftermath(flight)
    flight.close()
    return (handed or math.nan) * 1e3, back * 1e3, lost, tilt


def killed(
    number: int, curve: float, native: Any, seconds: float = 0.35
) -> tuple[float, float, float, float]:
    flight = Flight(own_curve=curve)
    command = [sys.executable, "-m", "coaxlink", "mix", str(EXAMPLES / "x8_demo.toml")]
    way = ["--plain"] if native is None else []
    process = subprocess.Popen(
        [*command, "--connect", flight.address, *way], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    flight.fly(15.0, until=lambda: flight.driven)
    flight.fly(1.0)
    flight.rows.clear()
    os.kill(process.pid, number)
    since = time.monotonic()
    flight.fly(seconds)
    handed, back = flight.own_since(since), math.nan
    if number == signal.SIGSTOP:
        os.kill(process.pid, signal.SIGCONT)
        back = flight.fly(1.0, until=lambda: flight.driven)
    process.kill()
    process.wait()
    lost, tilt = aftermath(flight)
    flight.close()
    return (handed or math.nan) * 1e3, back * 1e3, lost, tilt


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--curve", type=float, default=1.0, help="THR_MDL_FAC on board")
    parser.add_argument("--way", choices=("compiled", "plain"), default="compiled")
    o = parser.parse_args()
    native = compiled.load() if o.way == "compiled" else None
    runs: dict[str, Callable[[], tuple[float, float, float, float]]] = {
        name: (lambda name=name: in_process(name, o.curve, native)) for name in FAULTS
    }
    runs["processor starved (SIGSTOP)"] = lambda: killed(signal.SIGSTOP, o.curve, native)
    runs["the same for 4 s"] = lambda: killed(signal.SIGSTOP, o.curve, native, 4.0)
    runs["killed (SIGKILL)"] = lambda: killed(signal.SIGKILL, o.curve, native)
    print(f"THR_MDL_FAC {o.curve:g}, {o.way}; the worst of each:")
    print(f"{'':28s} ms to own mixer, ms back, m of height lost, deg of tilt")
    for name, once in runs.items():
        rows = np.array([once() for _ in range(o.times)])
        worst = np.nanmax(rows, axis=0) if not np.isnan(rows[:, 1]).all() else rows.max(axis=0)
        print(f"{name:28s} {worst[0]:6.0f} {worst[1]:6.0f} {worst[2]:6.2f} {worst[3]:6.1f}")


if __name__ == "__main__":
    main()
