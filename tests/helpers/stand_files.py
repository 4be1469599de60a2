"""A pair of propellers of our own making, and the files that stands write of it. No code of coaxlink."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RHO, G = 1.225, 9.80665
SIDES = ("upper", "lower")
UNITS = {  # of ours: what a reading is multiplied by
    "thrust": {"N": 1.0, "kgf": 1 / G, "gf": 1000 / G, "lbf": 0.22480894, "ozf": 3.5969431},
    "torque": {
        "N m": 1.0,
        "N cm": 100.0,
        "N mm": 1000.0,
        "kgf cm": 100 / G,
        "ozf in": 141.61193,
        "lbf in": 8.8507458,
    },
    "speed": {"rpm": 1.0, "rad/s": math.pi / 30, "rev/s": 1 / 60, "erpm": 7.0},
}


@dataclass(frozen=True)
class Pair:
    """Two propellers of diameter d (m), the lower one in the wake of the upper one."""

    diameter: float
    thrust_coefficient: float
    figure_of_merit: float
    top_rpm: float
    wake: float = 0.38  # share of thrust that goes at equal speeds

    def loads(self, u: Array, v: Array) -> dict[str, Array]:
        """N and N m at shares of the top speed."""
        n, d = self.top_rpm / 60, self.diameter
        power_coefficient = math.sqrt(2 / math.pi) * self.thrust_coefficient**1.5 / self.figure_of_merit
        thrust = self.thrust_coefficient * RHO * n**2 * d**4
        torque = power_coefficient / (2 * math.pi) * RHO * n**2 * d**5
        return {
            "upper_thrust": thrust * u**2,
            "lower_thrust": thrust * (v**2 - self.wake * u * v),
            "upper_torque": torque * u**2,
            "lower_torque": torque * (v**2 - 0.3 * self.wake * u * v),
        }


def readings(pair: Pair, u: Array, v: Array, seed: int, noise: float = 0.01) -> dict[str, Array]:
    """What good sensors read: loads, rpm, throttle, volts and amperes of both rotors."""
    random = np.random.default_rng(seed)
    out = {
        name: x + noise * np.abs(x).max() * random.standard_normal(len(x))
        for name, x in pair.loads(u, v).items()
    }
    efficiency = 0.78
    for side, share in (("upper", u), ("lower", v)):
        out[f"{side}_speed"] = pair.top_rpm * share
        out[f"{side}_throttle"] = 0.1 + 0.85 * share
        out[f"{side}_voltage"] = 24.0 - 1.5 * share
        shaft = pair.loads(u, v)[f"{side}_torque"] * 2 * math.pi / 60 * pair.top_rpm * share
        out[f"{side}_current"] = shaft / efficiency / out[f"{side}_voltage"]
    return out


def grid(steps: int = 7, low: float = 0.25) -> tuple[Array, Array]:
    """Every speed of one with every speed of the other."""
    u, v = np.meshgrid(np.linspace(low, 1, steps), np.linspace(low, 1, steps), indexing="ij")
    return u.ravel(), v.ravel()


def equal(rows: int = 30) -> tuple[Array, Array]:
    """Both rotors at one speed."""
    u = np.linspace(0.25, 1, rows)
    return u, u.copy()


def table(columns: dict[str, Array | list[str]], mark: str = ",", comma: bool = False) -> str:
    """Columns as text."""
    rows = []
    for cells in zip(*columns.values(), strict=True):
        shown = [c if isinstance(c, str) else f"{c:.7g}" for c in cells]
        rows.append(mark.join(c.replace(".", ",") if comma else c for c in shown))
    return mark.join(columns) + "\n" + "\n".join(rows) + "\n"


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    """A file of this text."""
    path.write_bytes(text.encode(encoding))
    return path
