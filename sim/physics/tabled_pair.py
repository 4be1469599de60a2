"""A pair as tables: of a raw stand map by interpolation of its rows, or of surfaces with a drive.

Eight tables over two axes, 0 .. REACH: thrust and torque of both rotors over both *speeds*, speeds of both
over both *commands* (at the reference supply), watts of both over both speeds. Between points the kernel goes
straight. Nothing here is fitted by a form: rows are joined by thin plates. Beyond the fastest row loads go
on with the square of speed and watts with its cube, along the ray from rest; below the slowest, what a rotor
gives of its own falls to rest with the square of its speed, what the other one's wake does to it stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.physics.layout import REACH
from sim.physics.pair import Pair
from sim.physics.stand_map import Side, read_map

Array = NDArray[np.float64]
Plate = Callable[[Array], Array]  # values (...) at points (..., 2)
POINTS = 101  # of every axis
THRUST, TORQUE, LOW_THRUST, LOW_TORQUE, SPEED, LOW_SPEED, WATTS, LOW_WATTS = range(8)
CELL_V = 3.72  # of a lithium cell under load, half empty
STIFF = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of the plates: as stiff as rows left out want it, for rows have noise
PARTS = 5  # left out in turn
EFFICIENCY = 0.80  # shaft over battery watts where no volts and amps were logged
FAST = 0.9  # quantile of throttle whose rows say what the supply was
# of currents: rows of this share of the most shaft watts, the other side's watts at most so many times the
# shaft's, so many of them; the share of all rows that reads less than the shaft has
LOADED, OUTDRAWN, LEAST_ROWS, IMPOSSIBLE = 0.05, 5.0, 20, 0.1


@dataclass(frozen=True)
class TabledPair(Pair):
    """See the module; `coefficients` are none."""

    tables: Array = field(default_factory=lambda: np.zeros((8, POINTS, POINTS)))
    supply_V: float | None = None
    radius: float = 0.235

    @property
    def reference_V(self) -> float | None:  # noqa: N802
        """Supply at which commands mean what they mean; None: any."""
        return self.supply_V

    @property
    def radius_m(self) -> float:
        """Of the disc."""
        return self.radius

    @property
    def cells(self) -> int | None:
        """In series, of a pack whose usual voltage is the reference."""
        return None if self.supply_V is None else max(round(self.supply_V / CELL_V), 1)

    def compiled(self) -> tuple[Array, Array]:
        """Tables in the place of coefficients, (POINTS, POINTS, 8): the kernel knows them by that."""
        return np.ascontiguousarray(np.moveaxis(self.tables, 0, -1)), np.empty(0)

    def loads(self, u_upper: ArrayLike, u_lower: ArrayLike) -> Array:
        """(4, ...) at normalised speeds."""
        return self._looked_up(slice(THRUST, SPEED), u_upper, u_lower)

    def turned(self, upper: ArrayLike, lower: ArrayLike) -> Array:
        """(2, ...) steady normalised speeds at commands, at the reference supply."""
        return self._looked_up(slice(SPEED, WATTS), upper, lower)

    def watts(self, u_upper: ArrayLike, u_lower: ArrayLike) -> Array:
        """(2, ...) that both sides draw at normalised speeds."""
        return self._looked_up(slice(WATTS, LOW_WATTS + 1), u_upper, u_lower)

    def _looked_up(self, which: slice, a: ArrayLike, b: ArrayLike) -> Array:
        x, y = np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float))
        x, y = (np.clip(v * ((POINTS - 1) / REACH), 0.0, POINTS - 1 - 1e-9) for v in (x, y))
        i, j = x.astype(int), y.astype(int)
        p, q, t = x - i, y - j, self.tables[which]
        low = (1 - q) * t[:, i, j] + q * t[:, i, j + 1]
        return np.asarray((1 - p) * low + p * ((1 - q) * t[:, i + 1, j] + q * t[:, i + 1, j + 1]))


def axes() -> Array:
    """(POINTS, POINTS, 2) where tables have their points: of the upper rotor, of the lower one."""
    axis = np.linspace(0.0, REACH, POINTS)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)


def map_pair(path: Path) -> TabledPair:
    """The pair of a raw stand map, as `stand_map` reads it. Raises WorldError."""
    sides = read_map(path)
    reference = _supply(sides)
    commands = np.stack([_effective(side, reference) for side in sides], axis=1)
    turned = [_plate(commands, side.rpm) for side in sides]
    top = max(float(plate(np.ones(2))) for plate in turned)
    speeds = np.stack([side.rpm / top for side in sides], axis=1)
    tables, grid = np.zeros((8, POINTS, POINTS)), axes()
    for k, side in enumerate(sides):
        tables[2 * k] = _loads(_plate(speeds, side.thrust_N), grid, speeds, k)
        tables[2 * k + 1] = _loads(_plate(speeds, side.torque_Nm), grid, speeds, k)
        tables[SPEED + k] = _driven(turned[k], grid, commands, k) / top
        tables[WATTS + k] = _drawn(_plate(speeds, _watts(side, sides[1 - k])), grid, speeds, k)
    return TabledPair(top, np.zeros((4, 1, 1)), tables, reference)


def _supply(sides: tuple[Side, Side]) -> float | None:
    """Volts at which full throttle means full speed: those of the fast rows."""
    known = [
        s.voltage_V[s.throttle >= np.quantile(s.throttle, FAST)] for s in sides if s.voltage_V is not None
    ]
    return float(np.mean([np.median(v) for v in known])) if known else None


def _effective(side: Side, reference: float | None) -> Array:
    """Throttles as they count at the reference supply."""
    if reference is None or side.voltage_V is None:
        return side.throttle
    return side.throttle * side.voltage_V / reference


def _shaft(side: Side) -> Array:
    return side.torque_Nm * side.rpm * (math.pi / 30.0)


def _read(side: Side) -> Array | None:
    return None if side.voltage_V is None or side.current_A is None else side.voltage_V * side.current_A


def _watts(side: Side, other: Side) -> Array:
    """From the battery: measured, or by the shaft.

    Readings below the shaft's power, which no motor can do, are of sensors that share a ground: of the other
    side's watts is put back what least squares over shaft, copper and iron want; a rotor that barely draws
    beside one that does, where a reading may end at nothing, has the efficiency of the rest.
    """
    shaft, read, beside = _shaft(side), _read(side), _read(other)
    if read is None:
        return shaft / EFFICIENCY
    if beside is None:
        return read
    known = (shaft > LOADED * shaft.max()) & (beside < OUTDRAWN * shaft)
    less = np.maximum(np.mean(read < shaft), np.mean(beside < _shaft(other)))
    if known.sum() < LEAST_ROWS or less < IMPOSSIBLE:
        return read
    x = np.stack([np.ones(len(shaft)), shaft, side.torque_Nm**2, side.rpm**2, beside], axis=1)
    x = x / np.abs(x).max(axis=0)
    lost = -float(np.linalg.lstsq(x[known], read[known], rcond=None)[0][-1]) * beside / np.abs(beside).max()
    true = read + np.maximum(lost, 0.0)
    return np.where(known, true, np.maximum(shaft, 0.0) * np.median(true[known] / shaft[known]))


def _plate(x: Array, y: Array) -> Plate:
    """A thin plate through rows (n, 2), as stiff as rows left out want it."""
    from scipy.interpolate import RBFInterpolator

    part = np.random.default_rng(0).permutation(len(y)) % PARTS

    def through(rows: NDArray[np.bool_], stiff: float) -> Any:
        return RBFInterpolator(x[rows], y[rows], smoothing=stiff, kernel="thin_plate_spline", degree=1)

    def missed(stiff: float) -> float:
        every = (part == k for k in range(PARTS))
        return sum(float(np.sum((through(~out, stiff)(x[out]) - y[out]) ** 2)) for out in every)

    found = through(part >= 0, min(STIFF, key=missed))
    return lambda at: np.asarray(found(at.reshape(-1, 2))).reshape(at.shape[:-1])


def _reach(rows: Array) -> tuple[Array, Array]:
    """(2,) least and most at which the plate holds: rows (n, 2), and all of the cells that they lie in."""
    step, least = REACH / (POINTS - 1), rows.min(axis=0)
    return np.maximum(least - step, 0.5 * least), rows.max(axis=0) + step


def _over_speeds(grid: Array, speeds: Array, k: int) -> tuple[Array, Array, Array, Array]:
    """Points within the plate, how fast side k turns there of its least (at most 1), how many times as fast
    as the nearest point on their rays they are (at least 1), and the slowest point."""
    least, most = _reach(speeds)
    times = np.maximum((grid / most).max(axis=-1), 1.0)
    near = grid / times[..., None]
    return np.maximum(near, least), np.minimum(near[..., k] / least[k], 1.0), times, least


def _loads(plate: Plate, grid: Array, speeds: Array, k: int) -> Array:
    """Thrust or torque of side k over speeds: see the module."""
    inside, slow, times, least = _over_speeds(grid, speeds, k)
    own = float(plate(least))  # both at their slowest: what the rotor gives without a wake to speak of
    return (plate(inside) - own * (1.0 - slow**2)) * times**2


def _drawn(plate: Plate, grid: Array, speeds: Array, k: int) -> Array:
    """Watts of side k over speeds, none where it rests."""
    inside, slow, times, _ = _over_speeds(grid, speeds, k)
    return np.maximum(plate(inside), 0.0) * slow**2 * times**3


def _driven(plate: Plate, grid: Array, commands: Array, k: int) -> Array:
    """Speed of side k over commands: straight from rest to the least, with the last slope beyond."""
    least, most = _reach(commands)
    inside = np.clip(grid, least, most)
    back = np.zeros(2)
    back[k] = 0.05
    slope = (plate(inside) - plate(inside - back)) / back[k]
    beyond = slope * np.maximum(grid[..., k] - most[k], 0.0)
    return np.maximum(plate(inside) * np.minimum(grid[..., k] / least[k], 1.0) + beyond, 0.0)
