"""The paper's Table 4, flown: hover at 3 m and the circle of 2 m around 4.5 m, a row a mixer.

Run: python research/table4.py. The first rows are the paper's own figures. Controller: Lee, Leok and
McClamroch 2010, eq. 12, 15, 16, in NED and FRD. Gains are near those of the simulator the paper used: soft in
position, so that a mixer that misses thrust is seen in the height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coaxlink.airframe import load_airframe
from coaxlink.mixer import make_law
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.flights import paper
from sim.physics.plant import GRAVITY, STEP_S, Plant
from sim.px4.cascade import Goal
from sim.px4.tuning import wrench as steady_wrench
from sim.world import World, build_plant

EXAMPLES = Path(__file__).parents[1] / "examples"
PAPER = {
    "coaxial": (0.3653, 0.3662, 0.0698, 0.10785, 0.08570, 0.4667, 0.58),
    "standard": (0.3656, 0.3661, 0.6373, 0.10451, 0.08423, 0.00105, 4.78),
    "reduced": (0.3652, 0.3659, 0.3335, 0.10624, 0.0850, 0.00108, 2.75),
}
LAWS = (
    ("standard-printed", "rotor_srm_paper.toml"),
    ("standard", "rotor_paper.toml"),
    ("reduced", "rotor_rcrm_paper.toml"),
    ("reduced", "rotor_paper.toml"),
    ("coaxial-printed", "rotor_paper.toml"),
    ("coaxial", "rotor_paper.toml"),
    ("fitted", "rotor_paper.toml"),
    ("exact", "rotor_paper.toml"),
)


Law = Callable[[NDArray[np.float64]], NDArray[np.float64]]
EVERY = 4  # plant steps a decision: 250 Hz
SECONDS = 60.0
START_DOWN_M = -3.0
SETTLE_S = 5.0
ROWS = ("p_x_m", "p_y_m", "p_z_m", "tau_x_Nm", "tau_y_Nm", "tau_z_Nm", "f_N")


@dataclass(frozen=True)
class Gains:
    """Force over position (N/m) and speed; attitude as a natural frequency and damping."""

    position: float = 8.0
    velocity: float = 20.0
    attitude_rad_s: float = 9.0
    yaw_rad_s: float = 3.0
    damping: float = 0.8


class Controller:
    """Position, attitude and rates to the wrench that follows a goal."""

    def __init__(self, mass_kg: float, inertia: NDArray[np.float64], dt: float, gains: Gains) -> None:
        self._mass, self._inertia, self._dt, self._gains = mass_kg, inertia, dt, gains
        self._last: NDArray[np.float64] | None = None

    def wrench(self, goal: Goal, plant: Plant) -> NDArray[np.float64]:
        """(4,) thrust up (N), roll, pitch, yaw (N m)."""
        g = self._gains
        r = rotation(plant.quaternion)
        force = self._mass * (np.array(goal.acceleration) - [0.0, 0.0, GRAVITY])
        force -= g.position * (plant.position - goal.position) + g.velocity * (plant.velocity - goal.velocity)
        wanted = self._attitude(force, goal.yaw)
        error = 0.5 * vee(wanted.T @ r - r.T @ wanted)
        turn = np.zeros(3) if self._last is None else vee(self._last.T @ wanted) / self._dt
        self._last = wanted
        rate_error = plant.rates - r.T @ wanted @ turn
        w0 = np.array([g.attitude_rad_s, g.attitude_rad_s, g.yaw_rad_s])
        moment = -self._inertia * (w0**2 * error + 2.0 * g.damping * w0 * rate_error)
        moment += np.cross(plant.rates, self._inertia * plant.rates)
        return np.concatenate([[-force @ r[:, 2]], moment])

    def _attitude(self, force: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
        down = -force / np.linalg.norm(force)
        across = np.cross(down, [np.cos(yaw), np.sin(yaw), 0.0])
        across /= np.linalg.norm(across)
        return np.column_stack([np.cross(across, down), across, down])


def fly_law(
    plant: Plant, law: Law, *, gains: Gains | None = None, seconds: float = SECONDS
) -> dict[str, float]:
    """Table 4's rows for one mixer: mean errors of position, and of the delivered wrench."""
    k = plant.index
    plant.state[k.POS + 2] = START_DOWN_M
    weight = plant.vehicle.mass_kg * GRAVITY
    plant.speeds[:] = law(np.array([weight, 0.0, 0.0, 0.0]))
    controller = Controller(
        plant.vehicle.mass_kg, plant.vehicle.inertia_kg_m2, EVERY * STEP_S, gains or Gains()
    )
    positions, missed = [], []
    for step in range(round(seconds / (EVERY * STEP_S))):
        t = step * EVERY * STEP_S
        goal = paper(t)
        demanded = controller.wrench(goal, plant)
        plant.advance(np.clip(law(demanded), 0.0, 1.0), EVERY)
        if t > SETTLE_S:
            positions.append(np.abs(plant.position - paper(t + EVERY * STEP_S).position))
            missed.append(np.abs(steady_wrench(plant, plant.speeds) - demanded))
    f, roll, pitch, yaw = np.mean(missed, axis=0).tolist()
    return dict(zip(ROWS, [*np.mean(positions, axis=0).tolist(), roll, pitch, yaw, f], strict=True))


def rotation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) body to NED."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def vee(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vector of a skew matrix (of the skew part)."""
    return 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def main() -> None:
    """Print the table."""
    airframe = load_airframe(EXAMPLES / "x8_demo.toml")
    print(f"{'':38s}" + "".join(f"{name:>11s}" for name in ROWS))
    for name, row in PAPER.items():
        print(f"{'paper: ' + name:38s}" + "".join(f"{value:11.4f}" for value in row))
    for law, rotor in LAWS:
        plant, _ = build_plant(World(EXAMPLES / "x8_demo.toml"))
        errors = fly_law(plant, make_law(law, Vehicle(airframe, load_rotor_model(EXAMPLES / rotor))).speeds)
        print(f"{law + ' on ' + rotor:38s}" + "".join(f"{errors[name]:11.4f}" for name in ROWS), flush=True)


if __name__ == "__main__":
    main()
