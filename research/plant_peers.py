"""Peer simulators' steps a second, for `plant.py --peers PYTHON`: million steps, or 'not installed'.

Needs crazyflow and rotorpy (pip install crazyflow rotorpy, in an environment of their own). Four rotors
where coaxlink's vehicle has eight; crazyflow steps by Euler, rotorpy by scipy's RK45.
"""

from __future__ import annotations

import time
from collections.abc import Callable


def best(work: Callable[[], int], times: int) -> tuple[float, float]:
    """Best million steps a second, of the clock and of a processor's time."""
    work()  # compiled at the first call
    rates = []
    for _ in range(times):
        start, spent = time.perf_counter(), time.process_time()
        steps = work() / 1e6
        rates.append((steps / (time.perf_counter() - start), steps / (time.process_time() - spent)))
    return max(r[0] for r in rates), max(r[1] for r in rates)


def crazyflow(worlds: int, steps: int) -> tuple[float, float]:
    """Its batch of `worlds` vehicles, JAX on the processor."""
    import jax
    from crazyflow.sim import Sim

    sim = Sim(n_worlds=worlds, n_drones=1, freq=1000, attitude_freq=1000)
    sim.reset()

    def work() -> int:
        sim.step(steps)
        jax.block_until_ready(sim.data.states.pos)
        return worlds * steps

    return best(work, 5)


def rotorpy() -> tuple[float, float]:
    """One vehicle at a time."""
    import numpy as np
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle = Multirotor(quad_params)
    control = {"cmd_motor_speeds": np.full(4, 1788.53)}

    def work() -> int:
        state = vehicle.initial_state
        for _ in range(300):
            state = vehicle.step(state, control, 0.001)
        return 300

    return best(work, 3)


def main() -> None:
    """A line a peer."""
    peers: list[tuple[str, Callable[[], tuple[float, float]]]] = [
        ("crazyflow, one vehicle", lambda: crazyflow(1, 5000)),
        ("crazyflow, 1000 vehicles, all cores", lambda: crazyflow(1000, 1000)),
        ("rotorpy, one vehicle", rotorpy),
    ]
    for name, rate in peers:
        try:
            clock, processor = rate()
            print(f"{name:45s} {clock:9.4f} {processor:13.4f}", flush=True)
        except ImportError:
            print(f"{name:45s} {'not installed':>9s}", flush=True)


if __name__ == "__main__":
    main()
