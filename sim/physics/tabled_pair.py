"""A pair as tables: of a raw stand map by interpolation of its rows, or of surfaces with a drive.

Eight tables over two axes, 0 .. REACH: thrust and torque of both rotors over both *speeds*, speeds of both
over both *commands* (at the reference supply), watts of both over both speeds. Between points the kernel goes
straight. Nothing here is fitted by a form: the rows are joined by thin plates, brought to rest below the
slowest.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.documents import read_number, refuse_unknown
from sim.errors import WorldError
from sim.physics.layout import REACH
from sim.physics.pair import Pair

Array = NDArray[np.float64]
Watts = Callable[[Array, Array], tuple[Array, Array]]
POINTS = 101  # of every axis
THRUST, TORQUE, LOW_THRUST, LOW_TORQUE, SPEED, LOW_SPEED, WATTS, LOW_WATTS = range(8)
GRAM_N, RPM_AT_REST, OFF = 9.80665e-3, 1.0, 0.02
CELL_V = 3.72  # of a lithium cell under load, half empty
LEAST_ROWS = 20
STIFF = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of the plates: as stiff as rows left out want it, for rows have noise
PARTS = 5  # left out in turn
EFFICIENCY = 0.80  # shaft over battery watts where no volts and amps were logged


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
        """The tables in the place of coefficients: the kernel knows them by their number."""
        return np.ascontiguousarray(self.tables), np.empty(0)

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


# raw maps

HEADINGS = {
    "throttle": (r"pwm {side}", 1e-3, -1.0), "rpm": (r"speed {side} \[rpm\]", 1.0, 0.0),
    "thrust_N": (r"thrust {side} \[g\]", GRAM_N, 0.0), "torque_Nm": (r"torque {side} \[nm\]", 1.0, 0.0),
    "voltage_V": (r"voltage {side} \[v\]", 1.0, 0.0), "current_A": (r"current {side} \[a\]", 1.0, 0.0),
}  # fmt: skip
NEEDED = ("throttle", "rpm", "thrust_N", "torque_Nm")


def map_pair(path: Path) -> TabledPair:
    """The pair of a stand map: a CSV of steady rows, each with both throttles and both rotors' readings.

    Columns as coaxlink's own (`upper_throttle`, `lower_thrust_N`, ...; `voltage_V` or one a side) or as the
    platform of Buzzatto and Liarokapis writes them, left for upper. Raises WorldError.
    """
    upper, lower = _sides(path)
    # at no throttle a rotor only runs down
    turning = [(side["rpm"] > RPM_AT_REST) & (side["throttle"] > OFF) for side in (upper, lower)]
    rows = turning[0] & turning[1]
    if rows.sum() < LEAST_ROWS:
        problem = f"{rows.sum()} rows in which both rotors turn; {LEAST_ROWS} at least make a map"
        raise WorldError(path, "", problem)
    sides = [{name: values[rows] for name, values in side.items()} for side in (upper, lower)]
    volts = [side.get("voltage_V") for side in sides]
    fast = [side["throttle"] >= np.quantile(side["throttle"], 0.9) for side in sides]
    known = [float(np.median(v[f])) for v, f in zip(volts, fast, strict=True) if v is not None]
    reference = float(np.mean(known)) if len(known) == 2 else None
    commands = [
        side["throttle"] * (1.0 if reference is None or v is None else v / reference)
        for side, v in zip(sides, volts, strict=True)
    ]
    over = np.stack(commands, axis=1)
    rpm = [_plate(over, side["rpm"]) for side in sides]
    top = max(float(turned(np.ones((1, 2)))[0]) for turned in rpm)
    speeds = np.stack([side["rpm"] / top for side in sides], axis=1)
    tables = np.zeros((8, POINTS, POINTS))
    axis = np.linspace(0.0, REACH, POINTS)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    slowest, least = speeds.min(axis=0), over.min(axis=0)
    fastest, most = speeds.max(axis=0) * 1.02, over.max(axis=0) * 1.02
    for k, side in enumerate(sides):
        for t, values in ((2 * k, side["thrust_N"]), (2 * k + 1, side["torque_Nm"])):
            tables[t] = _to_rest(_plate(speeds, values), grid, slowest, fastest)
        tables[SPEED + k] = _straight(rpm[k], grid, least, most, k) / top
        shaft = side["torque_Nm"] * side["rpm"] * math.pi / 30.0
        drawn = shaft / EFFICIENCY
        if "voltage_V" in side and "current_A" in side:
            drawn = side["voltage_V"] * side["current_A"]
        tables[WATTS + k] = np.maximum(_to_rest(_plate(speeds, drawn), grid, slowest, fastest), 0.0)
    return TabledPair(top, np.zeros((4, 1, 1)), tables, reference)


def _sides(path: Path) -> tuple[dict[str, Array], dict[str, Array]]:
    """Columns of the upper and the lower rotor. Raises WorldError naming what is missing."""
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise WorldError(path, "", f"cannot be read ({error.strerror})") from error
    head, *lines = list(csv.reader(text.splitlines())) or [[]]
    names = [name.strip().lower() for name in head]
    try:
        table = np.array([[float(x) for x in line] for line in lines if line], float).reshape(-1, len(names))
    except ValueError as error:
        raise WorldError(path, "", f"rows of {len(names)} numbers are expected ({error})") from error
    sides = []
    for ours, theirs in (("upper", "left"), ("lower", "right")):
        side: dict[str, Array] = {}
        for kind, (pattern, scale, offset) in HEADINGS.items():
            own = [
                i
                for i, n in enumerate(names)
                if n in (f"{ours}_{kind}".lower(), kind.lower() * ("_V" in kind))
            ]
            foreign = [i for i, n in enumerate(names) if re.fullmatch(pattern.format(side=theirs), n)]
            if own:
                side[kind] = table[:, own[0]]
            elif foreign:
                side[kind] = table[:, foreign[0]] * scale + offset
        missing = [kind for kind in NEEDED if kind not in side]
        if missing:
            raise WorldError(path, f"{ours}_{missing[0]}", "a stand map has this column of each rotor")
        torque = side["torque_Nm"]
        side["torque_Nm"] = torque * np.sign(np.median(torque[np.abs(torque) > 0.3 * np.abs(torque).max()]))
        sides.append(side)
    return sides[0], sides[1]


def _plate(x: Array, y: Array) -> Callable[[Array], Array]:
    """A thin plate through rows (n, 2)."""
    from scipy.interpolate import RBFInterpolator

    part = np.random.default_rng(0).permutation(len(y)) % PARTS

    def through(rows: NDArray[np.bool_], stiff: float) -> Any:
        return RBFInterpolator(x[rows], y[rows], smoothing=stiff, kernel="thin_plate_spline", degree=2)

    def missed(stiff: float) -> float:
        every = (part == k for k in range(PARTS))
        return sum(float(np.sum((through(~out, stiff)(x[out]) - y[out]) ** 2)) for out in every)

    found = through(part >= 0, min(STIFF, key=missed))
    return lambda at: np.asarray(found(at.reshape(-1, 2))).reshape(at.shape[:-1])


def _to_rest(plate: Callable[[Array], Array], grid: Array, slowest: Array, fastest: Array) -> Array:
    """A load over speeds: by the rows where they are; to rest and beyond them with the square."""
    inside = np.clip(grid, slowest, fastest)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(inside > 0, grid / inside, 0.0)
    return plate(inside) * (share**2).prod(axis=-1)


def _straight(plate: Callable[[Array], Array], grid: Array, least: Array, most: Array, side: int) -> Array:
    """A speed over commands: straight from rest to the least, and on beyond the last with its slope."""
    inside = np.clip(grid, least, most)
    found = plate(inside)
    below = np.where(grid[..., side] < least[side], grid[..., side] / max(least[side], 1e-9), 1.0)
    step = np.zeros(2)
    step[side] = 0.05
    slope = (plate(np.minimum(inside, most)) - plate(np.minimum(inside, most) - step)) / 0.05
    return np.maximum(found * below + slope * np.maximum(grid[..., side] - most[side], 0.0), 0.0)


# surfaces with a drive, from a rotor file

SIDE_KEYS = ("command", "torque_per_Nm", "torque_speed_per_Nm", "range", "error")
POWER_KEYS = ("constant", "per_rad_s", "per_rad_s2", "per_Nm2", "shaft", "error")


def driven_pair(path: Path, pair: Pair, document: dict[str, Any]) -> Pair:
    """The pair with the drive and the battery watts of its file (docs/stand.md), where it has them.

    Raises WorldError.
    """
    drive, power = document.get("drive"), document.get("battery_power")
    curves = (document.get("identified") or {}).get("rpm_over_throttle")
    if drive is None and power is None and curves is None:
        return pair
    axis = np.linspace(0.0, REACH, POINTS)
    u, v = np.meshgrid(axis, axis, indexing="ij")
    tables = np.zeros((8, POINTS, POINTS))
    tables[:4] = pair.loads(u, v)
    tables[SPEED], tables[LOW_SPEED] = u, v
    volts = None
    if drive is not None:
        refuse_unknown(path, "drive", drive, ("voltage_V", "upper", "lower"))
        if "voltage_V" in drive:
            volts = read_number(path, "drive.voltage_V", drive["voltage_V"])
        sides = [_side(path, drive, name) for name in ("upper", "lower")]
        for _ in range(3):
            for k in (0, 1):
                tables[SPEED + k] = _solved(sides[k], pair, k, u, v, tables)
    elif curves is not None:
        for k, name in enumerate(("upper", "lower")):
            b = curves.get(name) or next(iter(curves.values()))
            numbers = [read_number(path, f"identified.rpm_over_throttle.{name}", c) for c in b]
            t = (u, v)[k]
            bent = np.polynomial.Polynomial(numbers)(np.maximum(t, 0.05)) / pair.speed_max_rpm
            tables[SPEED + k] = np.where(t < 0.05, bent * t / 0.05, bent)
    rad_s = pair.speed_max_rpm * math.pi / 30.0
    for k, (name, speed) in enumerate((("upper", u), ("lower", v))):
        w, q = speed * rad_s, tables[2 * k + 1]
        drawn = q * w / EFFICIENCY
        if power is not None and (power.get(name) or power.get("upper") or power.get("lower")):
            numbers_of = power.get(name) or power.get("upper") or power["lower"]
            refuse_unknown(path, f"battery_power.{name}", numbers_of, POWER_KEYS)
            c = {key: read_number(path, f"battery_power.{name}.{key}", x) for key, x in numbers_of.items()}
            drawn = c.get("constant", 0.0) + c.get("per_rad_s", 0.0) * w + c.get("per_rad_s2", 0.0) * w**2
            drawn = drawn + c.get("per_Nm2", 0.0) * q**2 + c.get("shaft", 1.0) * q * w
        tables[WATTS + k] = np.where(speed > 0, np.maximum(drawn, 0.0), 0.0)
    return TabledPair(pair.speed_max_rpm, pair.coefficients, tables, volts, pair.radius_m)


@dataclass(frozen=True)
class _Side:
    command: tuple[float, ...]
    per_torque: tuple[float, float]
    low: float


def _side(path: Path, drive: dict[str, Any], name: str) -> _Side:
    given = drive.get(name) or drive.get("upper") or drive.get("lower")
    if not isinstance(given, dict):
        raise WorldError(path, "drive", "upper or lower is missing")
    refuse_unknown(path, f"drive.{name}", given, SIDE_KEYS)
    command = given.get("command")
    if not isinstance(command, list) or not 2 <= len(command) <= 6:
        raise WorldError(path, f"drive.{name}.command", "two to six numbers are expected")
    numbers = tuple(read_number(path, f"drive.{name}.command", c) for c in command)
    per = [read_number(path, f"drive.{name}.{k}", given.get(k, 0.0)) for k in SIDE_KEYS[1:3]]
    span = given.get("range", [0.0, 1.0])
    if not isinstance(span, list) or len(span) != 2:
        raise WorldError(path, f"drive.{name}.range", "two numbers are expected")
    return _Side(numbers, (per[0], per[1]), read_number(path, f"drive.{name}.range", span[0]))


def _solved(side: _Side, pair: Pair, k: int, a: Array, b: Array, tables: Array) -> Array:
    """Speeds (POINTS, POINTS) whose command is the one that is given, by halving."""
    wanted, other = (a, tables[LOW_SPEED]) if k == 0 else (b, tables[SPEED])
    low, high = np.zeros(wanted.shape), np.full(wanted.shape, REACH)
    floor = max(side.low, 1e-6)
    for _ in range(30):
        middle = 0.5 * (low + high)
        torque = pair.loads(middle, other)[1] if k == 0 else pair.loads(other, middle)[3]
        held = np.polynomial.Polynomial(side.command)(middle)
        held = held + (side.per_torque[0] + side.per_torque[1] * middle) * torque
        short = held < np.maximum(wanted, floor)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    found = 0.5 * (low + high)
    return np.where(wanted < floor, found * wanted / floor, found)
