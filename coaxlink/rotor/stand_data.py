"""What identification sees of a stand log: normalised speeds, the loads, and the blocks held out together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coaxlink.data import Samples
from coaxlink.data.averaging import conditions
from coaxlink.data.samples import FEWEST_ROWS
from coaxlink.data.tare import without_tares
from coaxlink.errors import InputError
from coaxlink.load import LOADS, Load, of_rotor
from coaxlink.rotor.drive_fit import DriveFit, WattsFit, at_full_throttle, drive_fits, watts_fits
from coaxlink.rotor.polynomial import design_matrix

Array = NDArray[np.float64]
Values = dict[str, Array]  # load: (rows,), NaN where not measured

COAXIAL = {
    "coaxial_thrust": (Load.UPPER_THRUST.key, Load.LOWER_THRUST.key),
    "coaxial_torque": (Load.UPPER_TORQUE.key, Load.LOWER_TORQUE.key),
}
PROPORTIONAL = 0.01  # rpm that follow the throttle this closely tell the speed at full throttle
STEP = 0.05  # of the speed range: a smaller change is not a new level
MOST_FOLDS = 12  # of the cross-validation: more blocks are dealt out to these
LEAST_SWEEP = 3  # rows
FASTEST = "fastest rpm in the log"
SLOWEST_RPM, FASTEST_RPM = 1.0, 1e6  # no rotor at full speed is beyond


def unit_of(channel: str) -> str:
    """N or N m, of a load's or a coaxial channel's name."""
    return "N m" if "torque" in channel else "N"


@dataclass(frozen=True)
class Speeds:
    """u of both rotors, 0..1, and what u = 1 means."""

    upper: Array  # (rows,)
    lower: Array  # (rows,), 0 for a rotor alone
    speed_max_rpm: float
    source: str  # in words
    from_throttle: bool = False
    drives: Mapping[str, DriveFit] = field(default_factory=dict)  # by side, where rpm bend with throttle

    def correlation(self) -> float:
        """Of the two speeds where both turn; 0 when a rotor also turns without the other."""
        upper, lower = self.upper > 0, self.lower > 0
        both = upper & lower
        if both.sum() < 3 or both.sum() < 0.9 * (upper | lower).sum():
            return 0.0
        u, v = self.upper[both], self.lower[both]
        return float(np.corrcoef(u, v)[0, 1]) if np.ptp(u) > 0 and np.ptp(v) > 0 else 0.0


@dataclass(frozen=True)
class LoadRows:
    """The rows in which one load was measured."""

    load: str
    upper: Array  # (n,) normalised speed
    lower: Array  # (n,)
    y: Array  # (n,) N or N m
    fold: NDArray[np.int64]  # (n,)

    def design(self, terms: Sequence[str]) -> Array:
        """(n, terms)."""
        return design_matrix(terms, self.upper, self.lower)

    def among(self, kept: NDArray[np.bool_]) -> LoadRows:
        """Those of a mask (n,)."""
        return LoadRows(self.load, self.upper[kept], self.lower[kept], self.y[kept], self.fold[kept])


@dataclass(frozen=True)
class StandData:
    """A stand log as speeds, loads and folds."""

    samples: Samples  # a row a condition
    speeds: Speeds
    loads: Values
    fold: NDArray[np.int64]  # (rows,)
    logged: int  # rows of the log

    @cached_property
    def watts(self) -> dict[str, WattsFit]:
        """By side, what the battery gave, where that was measured."""
        return watts_fits(self.samples)

    @property
    def measured(self) -> tuple[str, ...]:
        """The loads with enough rows to fit."""
        return tuple(load for load in LOADS if np.isfinite(self.loads[load]).sum() >= FEWEST_ROWS)

    def rows(self, load: str, among: NDArray[np.bool_] | None = None) -> LoadRows:
        """The rows of a load, all or those of a mask (rows,)."""
        y = self.loads[load]
        known = np.isfinite(y) if among is None else among & np.isfinite(y)
        return LoadRows(load, self.speeds.upper[known], self.speeds.lower[known], y[known], self.fold[known])


def stand_data(samples: Samples, speed_max_rpm: float | None = None) -> StandData:
    """Speeds, loads and folds of a stand log. Raises InputError when nothing can be identified from it."""
    logged, samples = samples.rows, conditions(without_tares(samples))
    speeds = normalised_speeds(samples, speed_max_rpm)
    # a rotor without its thrust makes no model; the lower one's is required only where it turned
    samples.require(*(load.column for load in of_rotor(0)))
    if np.ptp(speeds.lower) > 0:
        samples.require(*(load.column for load in of_rotor(1)))
    unknown = np.full(samples.rows, np.nan)
    loads = {load.key: samples[load.column] if samples.has(load.column) else unknown for load in Load}
    found = StandData(samples, speeds, loads, folds(blocks(samples, speeds)), logged)
    if not found.measured:
        raise InputError(
            samples.source,
            "",
            f"too few rows to identify anything: {samples.rows}, {FEWEST_ROWS} at least{samples.rows_lost()}",
        )
    return found


def refuse_full_speed(rpm: float) -> None:
    """Raises InputError for a full speed (rpm) that no rotor has."""
    if not SLOWEST_RPM <= rpm <= FASTEST_RPM:  # NaN too
        wanted = f"more than 0, {SLOWEST_RPM:g} to {FASTEST_RPM:g} rpm, is expected"
        raise InputError("`speed_max_rpm`", "", f"{wanted}, found {rpm:g}")


def normalised_speeds(samples: Samples, speed_max_rpm: float | None = None) -> Speeds:
    """u = rpm / speed_max_rpm; by default the rpm at full throttle where the log tells it, or the fastest.

    Raises InputError when neither rpm nor throttle of a rotor that is measured is there, and for a given full
    speed (rpm) that no rotor has.
    """
    if speed_max_rpm is not None:
        refuse_full_speed(speed_max_rpm)
    upper, lower = (_raw(samples, side, "rpm") for side in ("upper", "lower"))
    if upper is None or lower is None:
        upper, lower = (_raw(samples, side, "throttle") for side in ("upper", "lower"))
        if upper is None or lower is None:
            samples.require("upper_rpm", "lower_rpm")
            raise AssertionError("unreachable")
        source = "the throttle is taken for the normalised speed: no rpm in the log"
        return Speeds(upper, lower, speed_max_rpm or 1.0, source, True)
    fastest = float(max(upper.max(), lower.max()))
    if fastest <= 0:
        raise InputError(samples.source, "column upper_rpm", "no rotor ever turns")
    if speed_max_rpm is not None:
        drives = {} if _at_full_throttle(samples) else drive_fits(samples)
        return Speeds(upper / speed_max_rpm, lower / speed_max_rpm, speed_max_rpm, "given", drives=drives)
    if full := _at_full_throttle(samples):
        return Speeds(upper / full, lower / full, full, "rpm at full throttle, to which it is proportional")
    drives = drive_fits(samples)
    full, source = fastest, FASTEST
    if turned := at_full_throttle(drives):
        top = max(drive.top for drive in drives.values())
        full, source = turned, f"rpm at full throttle, by their drive over throttles up to {top:.2f}"
    return Speeds(upper / full, lower / full, full, source, drives=drives)


def _raw(samples: Samples, side: str, what: str) -> Array | None:
    name = f"{side}_{what}"
    if samples.has(name):
        return samples[name]
    measured = samples.has(f"{side}_thrust_N") or samples.has(f"{side}_torque_Nm")
    driven = any(samples.has(n) and np.any(samples[n] > 0) for n in (f"{side}_rpm", f"{side}_throttle"))
    if measured or driven:
        return None
    return np.zeros(samples.rows)  # a rotor that is not on the stand


def _at_full_throttle(samples: Samples) -> float | None:
    """rpm at throttle 1 when rpm are proportional to throttle (a governed or simulated motor), else None."""
    ratios = []
    for side in ("upper", "lower"):
        if not samples.has(f"{side}_rpm", f"{side}_throttle"):
            if samples.has(f"{side}_rpm") or samples.has(f"{side}_throttle"):
                return None
            continue
        on = samples[f"{side}_throttle"] > 0.05
        ratios.append(samples[f"{side}_rpm"][on] / samples[f"{side}_throttle"][on])
    ratio = np.concatenate(ratios)
    if len(ratio) < 3 or np.ptp(ratio) > PROPORTIONAL * np.median(ratio):
        return None
    # written logs round throttle and rpm: a ratio this close to a round number is that number
    rounded = round(float(np.median(ratio)), -1)
    return rounded if abs(rounded - np.median(ratio)) < 1e-3 * rounded else float(np.median(ratio))


def blocks(samples: Samples, speeds: Speeds) -> NDArray[np.int64]:
    """(rows,) block of each row: runs of a constant slow axis (sweeps), or ten stretches in log order.

    A block is held out whole: neighbouring rows share drift, temperature and rig, so the error on a row
    between fitted neighbours is too good. A row or two between jumps (rest, a rotor that spins up) are no
    sweep: they go with their neighbours.
    """
    candidates = []
    for side, u in (("upper", speeds.upper), ("lower", speeds.lower)):
        axis = samples[f"{side}_throttle"] if samples.has(f"{side}_throttle") else u
        span = np.ptp(axis)
        if span <= 0:
            continue
        jumps = np.flatnonzero(np.abs(np.diff(axis)) > STEP * span) + 1
        found = np.repeat(*_joined(np.diff([0, *jumps, samples.rows])))
        if 4 <= found[-1] + 1 <= samples.rows // 3 and 2 * np.bincount(found).max() <= samples.rows:
            candidates.append(found)
    if candidates:
        return np.asarray(min(candidates, key=lambda b: b[-1]), np.int64)
    count = max(2, min(10, samples.rows // 3))
    return np.asarray(np.arange(samples.rows) * count // max(samples.rows, 1), np.int64)


def _joined(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the sweep that each run of rows is or goes with, and the runs' sizes (runs,)."""
    sweep = np.cumsum(sizes >= LEAST_SWEEP) - 1
    return np.maximum(sweep, 0), sizes


def folds(block: NDArray[np.int64]) -> NDArray[np.int64]:
    """(rows,) fold number: a block each up to twelve, beyond that blocks are dealt out in turn."""
    return block if int(block.max()) < MOST_FOLDS else block % MOST_FOLDS
