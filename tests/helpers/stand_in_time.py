"""Stand logs in time: a bench that is run by a schedule of speeds, with rest, steps and ramps.

Imports nothing of coaxlink. Rotors follow their set-points as first-order lags, load cells read the loads at
the speeds of that moment, the rotors' inertia on the torque, a tare, and noise; rpm read a few turns at rest.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Array = np.ndarray
Loads = Callable[[Array, Array], Array]  # (rows,), (rows,) rpm -> (rows, 4) N, N m, N, N m
COLUMNS = ("upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")


@dataclass(frozen=True)
class Bench:
    """A pair on a stand, and the levels at which its map was taken."""

    loads: Loads
    points: Array  # (n, 2) rpm, in the order of the map: one rotor swept at each level of the other
    sweep: Array  # (n,) the sweep of each
    inertia_kg_m2: float  # a rotor's
    lag_s: float = 0.12
    noise: float = 0.003  # of each load's greatest
    rpm_noise: float = 4.0

    @property
    def full(self) -> float:
        """Fastest rpm of the map."""
        return float(self.points.max())

    def sweeps(self) -> list[Array]:
        """The points of each sweep."""
        return [self.points[self.sweep == k] for k in np.unique(self.sweep)]


Piece = tuple[float, Array, Array]  # seconds, set-points (2,) at its beginning and end, rpm


def hold(point: Array, seconds: float) -> Piece:
    return seconds, point, point


REST = np.zeros(2)


def _staircase(bench: Bench, seconds: float = 3.0) -> Iterator[Piece]:
    for point in bench.points:
        yield hold(point, seconds)


def _rests_between_steps(bench: Bench) -> Iterator[Piece]:
    for point in bench.points:
        yield hold(REST, 1.5)
        yield hold(point, 2.5)


def _rests_between_sweeps(bench: Bench) -> Iterator[Piece]:
    for sweep in bench.sweeps():
        yield hold(REST, 4.0)
        for point in sweep:
            yield hold(point, 2.0)


def _unequal(bench: Bench) -> Iterator[Piece]:
    random = np.random.default_rng(5)
    for point in bench.points:
        yield hold(point, float(random.uniform(1.5, 6.0)))


def _ramps(bench: Bench, seconds: float = 20.0) -> Iterator[Piece]:
    """One rotor up and down over its sweep, at each level of the other."""
    for sweep in bench.sweeps():
        low, high = sweep[np.argmin(sweep.sum(axis=1))], sweep[np.argmax(sweep.sum(axis=1))]
        yield hold(low, 1.0)
        yield seconds, low, high
        yield seconds, high, low


def _slowly(bench: Bench) -> Iterator[Piece]:
    yield hold(REST, 5.0)
    yield 8.0, REST, bench.points[0]
    yield from _staircase(bench)
    yield 8.0, bench.points[-1], REST
    yield hold(REST, 5.0)


def shapes(bench: Bench) -> dict[str, list[Piece]]:
    """Twelve runs of one map, by name."""
    stairs, rest = list(_staircase(bench)), [hold(REST, 3.0)]
    short, ramps = list(_staircase(bench, 0.5)), list(_ramps(bench))
    return {
        "steps": stairs,
        "rest first": rest + stairs,
        "rest last": stairs + rest,
        "rest at both ends": rest + stairs + rest,
        "long rest at both ends": [hold(REST, 60.0), *stairs, hold(REST, 60.0)],
        "rests between steps": list(_rests_between_steps(bench)) + rest,
        "rests between sweeps": list(_rests_between_sweeps(bench)) + rest,
        "steps of unequal length": rest + list(_unequal(bench)),
        "ramps": ramps,
        "ramps, rest at both ends": rest + ramps + rest,
        "steps of 0.5 s, rest at both ends": rest + short + rest,
        "spun up and down slowly": list(_slowly(bench)),
    }


def run(bench: Bench, pieces: list[Piece], seed: int, rate_hz: float = 10.0) -> dict[str, Array]:
    """The log of a schedule, rows at `rate_hz`."""
    random, fine = np.random.default_rng(seed), 200.0
    asked = np.concatenate([
        a + (b - a) * np.linspace(0.0, 1.0, round(seconds * fine), endpoint=False)[:, None]
        for seconds, a, b in pieces
    ])  # fmt: skip
    share = 1.0 - np.exp(-1.0 / (fine * bench.lag_s))
    speed = np.empty_like(asked)
    now = asked[0]
    for i, point in enumerate(asked):
        now = now + share * (point - now)
        speed[i] = now
    rate = np.gradient(speed, 1.0 / fine, axis=0) * np.pi / 30.0  # rad/s^2
    rows = np.arange(0, len(speed), round(fine / rate_hz))
    loads = bench.loads(*speed[rows].T)
    loads[:, [1, 3]] += bench.inertia_kg_m2 * rate[rows]
    top = np.abs(bench.loads(*bench.points.T)).max(axis=0)
    # a log without rest cannot tell its tare: that bench was set to zero
    tare = top * [0.004, -0.002, 0.003, 0.001] * (asked.max(axis=1) <= 0.0).any()
    loads += tare + bench.noise * top * random.standard_normal(loads.shape)
    read = speed[rows] + bench.rpm_noise * random.standard_normal((len(rows), 2))
    return _columns(rows / fine, np.round(read), loads)


def averaged(bench: Bench, seed: int, per_step: int = 25) -> dict[str, Array]:
    """What a careful person logs: a row a point of the map, the tare taken off."""
    random = np.random.default_rng(seed)
    loads = bench.loads(*bench.points.T)
    top = np.abs(loads).max(axis=0)
    loads = loads + bench.noise / np.sqrt(per_step) * top * random.standard_normal(loads.shape)
    read = bench.points + bench.rpm_noise / np.sqrt(per_step) * random.standard_normal(bench.points.shape)
    return _columns(3.0 * np.arange(len(loads)), read, loads)


def with_rest_rows(log: dict[str, Array], first: bool = True, last: bool = True) -> dict[str, Array]:
    """An averaged log with a row of rest at its ends."""
    times = log["time_s"]
    at = [*([times[0] - 3.0] if first else []), *([times[-1] + 3.0] if last else [])]
    out = {}
    for name, values in log.items():
        ends = [t if name == "time_s" else 0.0 for t in at]
        out[name] = np.concatenate([ends[:1] if first else [], values, ends[-1:] if last else []])
    return out


def _columns(time: Array, rpm: Array, loads: Array) -> dict[str, Array]:
    own = {"time_s": time, "upper_rpm": rpm[:, 0], "lower_rpm": rpm[:, 1]}
    return own | dict(zip(COLUMNS, loads.T, strict=True))


def save(path: Path, log: dict[str, Array]) -> Path:
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(log)
        out.writerows(zip(*(np.round(v, 5) for v in log.values()), strict=True))
    return path


def paper() -> Bench:
    """The paper's pair (Berra, Trujillo and Heredia 2024, eq. 17; u = 1 at 5400 rpm), 7 x 7 levels."""

    def loads(upper: Array, lower: Array) -> Array:
        u, v = upper / 5400.0, lower / 5400.0
        lifts = 2.755 * u**2 * v**2 + 64.721 * v**2 - 2.547 * u * v + 12.402 * v - 37.502 * u**2 + 0.801
        drags = 0.307 * u * v**2 + 1.466 * v**2 + 0.573 * v - 0.695 * u**2
        both = np.stack([55.9517 * u**2 + 22.4464 * u, 1.2437 * u**2 + 0.7155 * u, lifts, drags], axis=1)
        # eq. 17 has a lower thrust at rest; a rotor that stands has none
        both[:, 2] -= 0.801 * (v < 0.01)
        return both

    levels = 5400.0 * np.linspace(0.25, 1.0, 7)
    u, v = np.meshgrid(levels, levels, indexing="ij")
    return Bench(loads, np.stack([u.ravel(), v.ravel()], axis=1), np.arange(49) // 7, 4e-4)


def of_map(path: Path, inertia_kg_m2: float) -> Bench:
    """A public map (Buzzatto's stand): its loads between its rows by a thin-plate surface through them.

    Points are the rows in which both rotors are driven.
    """
    from scipy.interpolate import RBFInterpolator

    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    names, cells = rows[0], np.array(rows[1:], float)

    def columns(what: str) -> Array:
        return np.stack([cells[:, names.index(what.format(side))] for side in ("Left", "Right")], axis=1)

    driven = (columns("PWM {}") > 1000.0).all(axis=1)
    rpm, slow = columns("Speed {} [rpm]")[driven], columns("PWM {}")[driven, 1]
    thrust, torque = 9.80665e-3 * columns("Thrust {} [g]")[driven], columns("Torque {} [Nm]")[driven]
    loads = np.stack([thrust[:, 0], torque[:, 0], thrust[:, 1], torque[:, 1]], axis=1)
    loads *= np.sign(loads[np.argmax(rpm.min(axis=1))])
    known, index = np.unique(np.concatenate([rpm, [REST]]), axis=0, return_index=True)
    surface = RBFInterpolator(known / rpm.max(), np.concatenate([loads, np.zeros((1, 4))])[index])
    sweep = np.unique(slow, return_inverse=True)[1]
    return Bench(
        lambda u, v: np.array(surface(np.stack([u, v], axis=1) / rpm.max())), rpm, sweep, inertia_kg_m2
    )
