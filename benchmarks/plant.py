"""Plant steps a second with the CRM rotor: one vehicle, a thousand on all cores, one with effects.


Run: python benchmarks/plant.py
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sim import kernel
from sim.plant import Plant
from sim.rotors import read_pair
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
HOVER = np.array([0.441] * 4 + [0.65] * 4)


def best(work: Callable[[], int], times: int = 15) -> tuple[float, float]:
    """Best and median million steps a second."""
    rates = []
    for _ in range(times):
        start = time.perf_counter()
        steps = work()
        rates.append(steps / (time.perf_counter() - start) / 1e6)
    return max(rates), statistics.median(rates)


def plant() -> Plant:
    """The demo's vehicle, high up."""
    p = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(EXAMPLES / "rotor_paper.toml"))
    p.state[2] = -1e4
    return p


def one(p: Plant, steps: int = 100_000) -> int:
    """Many steps of one vehicle in one call."""
    p.advance(HOVER, steps)
    return steps


def many(p: Plant, vehicles: int = 1000, steps: int = 200) -> Callable[[], int]:
    """Some steps of many vehicles."""
    states = np.tile(p.state, (vehicles, 1))
    commands = np.tile(HOVER, (vehicles, 1))
    outs = np.zeros((vehicles, len(p.out)))

    def work() -> int:
        p.advance_many(states, commands, steps, outs)
        return vehicles * steps

    return work


def main() -> None:
    """Print the table."""
    p = plant()
    rows = [("one vehicle, calm air", *best(lambda: one(p)))]
    rows.append(("1000 vehicles, all cores, calm air", *best(many(p))))
    p.parameters[[kernel.INFLOW, kernel.DRAG, kernel.GROUND_GAIN, kernel.BODY_DRAG]] = 3.0, 1.0, 0.1, 0.1
    rows.append(("one vehicle, inflow, drag, ground and wind", *best(lambda: one(p, 20_000))))
    print(f"{'million steps of 1 ms a second':45s} {'best':>7s} {'median':>7s}")
    for name, top, middle in rows:
        print(f"{name:45s} {top:7.2f} {middle:7.2f}")


if __name__ == "__main__":
    main()
