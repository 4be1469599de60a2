"""Plant steps a second: the CRM rotor and blades in moving air, one vehicle and a thousand on all cores.

Run: python research/plant.py [--peers PYTHON]. PYTHON is an interpreter that has the peer simulators of
`plant_peers.py`; without it this one is asked.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
HOVER = np.array([0.441] * 4 + [0.65] * 4)


def best(work: Callable[[], int], times: int = 15) -> tuple[float, float]:
    """Best million steps a second, of the clock and of a processor's time (which neighbours cost less)."""
    rates = []
    for _ in range(times):
        start, spent = time.perf_counter(), time.process_time()
        steps = work() / 1e6
        rates.append((steps / (time.perf_counter() - start), steps / (time.process_time() - spent)))
    return max(r[0] for r in rates), max(r[1] for r in rates)


def plant(rotor: Path = EXAMPLES / "rotor_paper.toml") -> Plant:
    """The demo's vehicle, high up."""
    p = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(rotor))
    p.state[2] = -1e4
    return p


def everything(p: Plant) -> None:
    """With all that may act in flight: ground and ceiling, wind, body drag, sag, heat, rotors' inertia."""
    k = p.index
    p.parameters[[k.GROUND_GAIN, k.BODY_DRAG, k.ROTOR_INERTIA]] = 0.1, 0.1, 1e-3
    p.parameters[[k.WIND, k.VOLT_POWER, k.HEAT_SHARE]] = 3.0, 0.3, 0.05
    p.parameters[[k.CEILING_GAIN, k.CEILING_Z]] = 0.125, 3e4


def one(p: Plant, steps: int = 100_000) -> int:
    """Many steps of one vehicle in one call."""
    p.advance(HOVER, steps)
    return steps


def many(p: Plant, vehicles: int = 1000, steps: int = 1000) -> Callable[[], int]:
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
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--peers", default=sys.executable)
    peers = parser.parse_args().peers
    p, blades = plant(), plant(Path("kde5215_bemt"))
    rows = [("one vehicle, CRM, calm air", *best(lambda: one(p)))]
    rows.append(("1000 vehicles, CRM, calm air, all cores", *best(many(p), 8)))
    rows.append(("one vehicle, blades in moving air", *best(lambda: one(blades, 30_000))))
    everything(p)
    everything(blades)
    rows.append(("one vehicle, CRM, every effect", *best(lambda: one(p, 30_000))))
    rows.append(("one vehicle, blades, every effect", *best(lambda: one(blades, 30_000))))
    print(f"{'million steps of 1 ms a second, best of several':45s} {'clock':>9s} {'processor':>13s}")
    for name, clock, processor in rows:
        print(f"{name:45s} {clock:9.4f} {processor:13.4f}", flush=True)
    beside = Path(__file__).resolve().with_name("plant_peers.py")
    subprocess.run([peers, str(beside)], check=False, stderr=subprocess.DEVNULL, cwd=tempfile.gettempdir())


if __name__ == "__main__":
    main()
