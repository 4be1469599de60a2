"""Plant steps a second: the CRM rotor and blades in moving air, beside other simulators.

    python research/plant.py [--steps 30000]

Million steps of 1 ms a second of a processor's time (neighbours on the machine cost less of it), best of
several. Peers are measured where this interpreter has them (pip install crazyflow rotorpy): four rotors where
coaxlink's vehicle has eight; crazyflow steps by Euler, rotorpy by scipy's RK45.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sim.physics.plant import Plant
from sim.physics.rotors import read_pair
from sim.vehicle import read_vehicle

EXAMPLES = Path(__file__).parents[1] / "examples"
HOVER = np.array([0.441] * 4 + [0.65] * 4)


def best(work: Callable[[], int], times: int = 5) -> float:
    """Million steps a second of a processor's time; the first call compiles."""
    work()
    rates = []
    for _ in range(times):
        spent = time.process_time()
        rates.append(work() / 1e6 / (time.process_time() - spent))
    return max(rates)


def plant(rotor: Path, steps: int, everything: bool) -> float:
    """The demo's vehicle, high up; `everything` that may act in flight, or calm air."""
    p = Plant(read_vehicle(EXAMPLES / "x8_demo.toml"), read_pair(rotor))
    p.state[2] = -1e4
    if everything:
        k = p.index
        p.parameters[[k.GROUND_GAIN, k.BODY_DRAG, k.ROTOR_INERTIA]] = 0.1, 0.1, 1e-3
        p.parameters[[k.WIND, k.VOLT_POWER, k.HEAT_SHARE]] = 3.0, 0.3, 0.05
        p.parameters[[k.CEILING_GAIN, k.CEILING_Z]] = 0.125, 3e4

    def work() -> int:
        p.advance(HOVER, steps)
        return steps

    return best(work)


def crazyflow(steps: int) -> float:
    """One vehicle, JAX on the processor."""
    import jax
    from crazyflow.sim import Sim

    sim = Sim(n_worlds=1, n_drones=1, freq=1000, attitude_freq=1000)
    sim.reset()

    def work() -> int:
        sim.step(steps)
        jax.block_until_ready(sim.data.states.pos)
        return steps

    return best(work)


def rotorpy(steps: int) -> float:
    """One vehicle."""
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle, control = Multirotor(quad_params), {"cmd_motor_speeds": np.full(4, 1788.53)}

    def work() -> int:
        state = vehicle.initial_state
        for _ in range(steps // 100):
            state = vehicle.step(state, control, 0.001)
        return steps // 100

    return best(work, 3)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=30_000)
    parser.add_argument("--small", action="store_true", help="a thousand steps")
    o = parser.parse_args()
    steps = 1000 if o.small else o.steps
    crm, blades = EXAMPLES / "rotor_paper.toml", Path("kde5215_bemt")
    rows: list[tuple[str, Callable[[], float]]] = [
        ("CRM, calm air", lambda: plant(crm, steps, False)),
        ("CRM, every effect", lambda: plant(crm, steps, True)),
        ("blades in moving air", lambda: plant(blades, steps, False)),
        ("blades, every effect", lambda: plant(blades, steps, True)),
        ("crazyflow, one vehicle", lambda: crazyflow(steps)),
        ("rotorpy, one vehicle", lambda: rotorpy(steps)),
    ]
    for name, rate in rows:
        try:
            print(f"{name:30s}{rate():10.4f}", flush=True)
        except ImportError:
            print(f"{name:30s}{'not installed':>15s}", flush=True)


if __name__ == "__main__":
    main()
