"""What a reader of a rotor model must know of its stand log: what is odd, what it covers, how well.

Nothing is changed by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.unit_check import electrical_turns, other_units, sizes
from coaxlink.load import Load
from coaxlink.rotor.drive_fit import BENT, drawn_watts
from coaxlink.rotor.fit import ROWS_A_TERM, Array, load_terms
from coaxlink.rotor.identification import CORRELATED, Identification
from coaxlink.rotor.stand_data import COAXIAL, StandData, unit_of

CELLS = 5  # a side: levels of each speed that a map wants (the paper has 11)
SAME = 0.01  # of the speed range: two rows at one condition
REACHES_FULL = 0.9  # of the top speed: a map that reaches so far needs no extrapolation
OVER = 1.02  # of the speed that u = 1 means: rpm sensors agree within 2 per cent
SHORT = 0.6  # of it: a table is used up to 1, and squares extrapolated from here are off by their square
DRAWS, IDLE = 0.2, 0.02  # of the greatest power, of the greatest thrust
DRIVEN_ALONE = 0.5  # of a rotor's own fastest: below, a wake may well push it down
# of the range that was measured: between the forms that the paper flies (CRM, R-CRM: 0.007 to 0.039) and the
# one that it finds unfit (SRM: 0.052 and 0.078; Berra, Trujillo and Heredia 2024, Table 2, NRMSE)
POOR = 0.05
SHOWN = 4  # rows named
MOST_EFFICIENT, LEAST_EFFICIENT = 1.0, 0.5  # shaft over battery watts of a drive: physics; a motor near stall


@dataclass(frozen=True)
class Coverage:
    """Where the rows of a log were measured, and how far its model is known."""

    upper: tuple[float, float]  # least and greatest normalised speed
    lower: tuple[float, float]
    cells: float  # share of a 5 x 5 map of both speeds in which a row lies; of 5 levels for a rotor alone
    correlation: float  # of both speeds, where both turn
    repeats: int  # conditions measured more than once
    repeatability: Mapping[str, float]  # channel: N or N m between rows at one condition; absent without
    noise: Mapping[str, float]  # channel: N or N m
    known_to: Mapping[str, float]  # channel: standard error of the model over the measured rows, the greatest

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)

    def lines(self) -> Iterator[str]:
        """In words."""
        pair = self.lower[1] > 0
        where = f"upper {self.upper[0]:.2f} to {self.upper[1]:.2f}"
        where += f", lower {self.lower[0]:.2f} to {self.lower[1]:.2f}" if pair else ""
        of = f"a {CELLS} x {CELLS} map" if pair else f"{CELLS} levels"
        yield f"speeds: {where} of the top speed, {100 * self.cells:.0f} % of {of}"
        if self.repeats:
            scatter = ", ".join(f"{n} {v:.3g} {unit_of(n)}" for n, v in self.repeatability.items())
            yield f"repeats: {self.repeats} conditions measured again, within {scatter}"
        else:
            yield "repeats: none; what one condition scatters by is not in the log"


@dataclass(frozen=True)
class LogChecks:
    """What is reported of a log beside its model."""

    odd: tuple[str, ...]  # what a person should look at first, a line each
    covers: tuple[str, ...]  # which propellers its units mean, and its coverage, in words
    coverage: Coverage


def check_log(result: Identification, diameter_m: float | None = None) -> LogChecks:
    """All checks of the log behind an identification; `diameter_m` of the propellers, where it is known."""
    samples, covered = result.data.samples, coverage(result)
    turns, units = electrical_turns(samples, diameter_m), other_units(samples, diameter_m)
    if units:
        units = f"with {units} these readings are propellers' as well: `diameter_m` decides, a map states it"
    meant = sizes(samples, diameter_m)
    odd = (turns, units, *unusual(result.data, result.form), *poor_errors(result))
    return LogChecks(
        tuple(line for line in odd if line), tuple(filter(None, (meant, *covered.lines()))), covered
    )


def coverage(result: Identification) -> Coverage:
    """The coverage of the log behind an identification."""
    data = result.data
    u, v = data.speeds.upper, data.speeds.lower
    channels = {load: Load.of(load).channel for load in data.measured}
    first, again = _repeats(u, v)
    repeatability = {}
    for load, channel in channels.items():
        difference = (data.loads[load][first] - data.loads[load][again]) / np.sqrt(2)
        difference = difference[np.isfinite(difference)]
        if len(difference):
            repeatability[channel] = float(np.sqrt(np.mean(difference**2)))
    return Coverage(
        _range(u),
        _range(v),
        _cells(u, v),
        data.speeds.correlation(),
        len(set(first.tolist())),
        repeatability,
        {channel: result.noise_floor[channel] for channel in channels.values()},
        {channels[load]: _known_to(result, load) for load in result.fits},
    )


def for_the_table(result: Identification, load: str) -> str:
    """What terms that cannot be told apart mean for a mixer table made of the model."""
    speeds = result.data.speeds
    u, v = speeds.upper, speeds.lower
    if speeds.correlation() > CORRELATED:
        both = (u > 0) & (v > 0)
        ratio = v[both] / u[both]
        return (
            f"for a table: fly it only with both rotors between {_range(u)[0]:.2f} and {_range(u)[1]:.2f} of "
            f"the top speed and the lower one at {ratio.min():.2f} to {ratio.max():.2f} of the upper one's"
        )
    error = f"{_known_to(result, load):.2g} {unit_of(load)}"
    sure = f"their sum is known to {error} where it was measured"
    top = min(_range(s)[1] for s in (u, v) if np.any(s > 0))
    if top < REACHES_FULL:
        return f"for a table: {sure}; fly it only below {top:.2f} of the top speed"
    return f"for a table it does not matter: {sure}"


def _known_to(result: Identification, load: str) -> float:
    """Greatest standard error of a load's model at the rows that it was fitted on, N or N m."""
    rows, fit = result.data.rows(load), result.fits[load]
    X = rows.design(fit.terms)
    left = np.linalg.qr(X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300))[0]
    degrees = max(len(rows.y) - X.shape[1], 1)
    scatter = np.sqrt(np.sum((rows.y - X @ fit.coefficients) ** 2) / degrees)
    return float((scatter * np.sqrt(np.minimum(np.sum(left**2, axis=1), 1.0))).max())


def _range(u: Array) -> tuple[float, float]:
    turning = u[u > 0]
    return (float(turning.min()), float(turning.max())) if len(turning) else (0.0, 0.0)


def _cells(u: Array, v: Array) -> float:
    top = max(float(u.max()), float(v.max()), 1e-300)
    cell = [np.minimum((s / top * CELLS).astype(int), CELLS - 1) for s in (u, v) if np.any(s > 0)]
    return len(set(zip(*cell, strict=True))) / CELLS ** len(cell)


def _repeats(u: Array, v: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of rows at one condition, neighbours in time not counted: they are one measurement."""
    from scipy.spatial import cKDTree

    points = np.column_stack([u, v])
    step = max(1, len(points) // 4000)
    index = np.arange(0, len(points), step)
    pairs = cKDTree(points[index]).query_pairs(SAME, output_type="ndarray")
    pairs = index[pairs[pairs[:, 1] - pairs[:, 0] > 1]] if len(pairs) else np.zeros((0, 2), np.int64)
    return pairs[:, 0], pairs[:, 1]


def poor_errors(result: Identification) -> Iterator[str]:
    """The channels whose held-out error says that the model does not hold on rows it has not seen."""
    for channel, error in result.channels.items():
        if channel in COAXIAL or error.nrmse <= POOR:  # a sum of two loads hides either
            continue
        unit = unit_of(channel)
        yield (
            f"{channel}: {result.form} misses held-out rows by {error.rmse:.3g} {unit}, "
            f"{100 * error.nrmse:.2g} % of the measured range (above {100 * POOR:.0f} % a table of it is off "
            f"by as much); rows at neighbouring speeds scatter by {result.noise_floor[channel]:.3g} {unit}"
        )


def unusual(data: StandData, form: str) -> tuple[str, ...]:
    """What a person should look at in the log before they believe a model of it, one line each."""
    looks = (_no_speed, _full_throttle, _beyond, _stalled, _idle_power, _efficiency, _wrong_way)
    return (*(line for look in looks for line in look(data)), *_few_rows(data, form))


def _sides(data: StandData) -> Iterator[tuple[str, Array, Array]]:
    """(side, its speed, the other rotor's speed) of each rotor that turns."""
    upper, lower = data.speeds.upper, data.speeds.lower
    for side, u, other in (("upper", upper, lower), ("lower", lower, upper)):
        if np.any(u > 0):
            yield side, u, other


def _no_speed(data: StandData) -> Iterator[str]:
    if data.speeds.from_throttle:
        yield (
            "no speed was measured: the units in the headings can hardly be held against the readings "
            "(`diameter_m` narrows it), and the model goes with the battery's voltage"
        )


def _full_throttle(data: StandData) -> Iterator[str]:
    """Where commands are not speeds."""
    for side, drive in data.speeds.drives.items():
        if data.speeds.source != "given" and not drive.reaches_full:
            yield (
                f"{side}: throttle goes to {drive.top:.2f}, and rpm do not tell what they are at 1: no table "
                "is made of that; measure there, or give `speed_max_rpm`"
            )
        elif drive.reaches_full and abs(np.subtract(*drive.bend())) > BENT:
            at, gives = drive.bend()
            yield (
                f"{side}: throttle {at:.2f} gives {gives:.2f} of full speed: the model keeps the drive, and "
                "tables and laws command by it; take [drive] out for ESCs that govern speed"
            )


def _beyond(data: StandData) -> Iterator[str]:
    if data.speeds.source != "given":
        return
    for side, u, _ in _sides(data):
        top = float(u.max())
        if top > OVER:
            rows = np.flatnonzero(u > OVER)
            yield (
                f"{side}: {len(rows)} rows run faster than `speed_max_rpm`, up to {top:.2f} of it "
                f"({_row_names(data, rows)}): is it the motor's highest speed under load?"
            )
        elif top < SHORT:
            yield (
                f"{side}: no row beyond {top:.2f} of `speed_max_rpm`: what a table does above is extrapolated"
            )


def _stalled(data: StandData) -> Iterator[str]:
    """Thrust that no longer grows in the fastest fifth, the other rotor's share taken off."""
    for side, u, other in _sides(data):
        load = data.loads[f"{side}.thrust_N"]
        top = np.isfinite(load) & (u > 0.8 * u.max())
        if top.sum() < 6 or np.ptp(u[top]) < 0.05 * u.max():
            continue
        X = np.stack([np.ones(top.sum()), u[top], other[top]], axis=1)
        apart = np.ptp(other[top]) > 0 and abs(np.corrcoef(u[top], other[top])[0, 1]) < CORRELATED
        X = X if apart else X[:, :2]
        b = np.linalg.lstsq(X, load[top], rcond=None)[0]
        left = load[top] - X @ b
        error = float(np.std(left)) / (float(np.std(u[top])) * np.sqrt(top.sum()))
        if b[1] < 0 and -b[1] > 3 * error:
            yield (
                f"{side}: thrust falls with speed above {0.8 * u.max():.2f}: a blade stalls, a cell is at "
                "its limit, or the battery was changed"
            )


def _idle_power(data: StandData) -> Iterator[str]:
    for side, _, _ in _sides(data):
        power = drawn_watts(data.samples, side)
        load = data.loads[f"{side}.thrust_N"]
        if power is None or not np.isfinite(load).any():
            continue
        rows = np.flatnonzero((power > DRAWS * power.max()) & (np.abs(load) < IDLE * np.nanmax(np.abs(load))))
        if len(rows):
            where = _row_names(data, rows)
            yield f"{side}: {len(rows)} rows draw power without thrust ({where}): cell or propeller?"


def _efficiency(data: StandData) -> Iterator[str]:
    """Shaft watts that no battery gave, or that a motor wastes most of; sensors that read one another."""
    for side, watts in data.watts.items():
        drawn = f"{side}: {100 * watts.efficiency:.0f} % of the battery's watts reach the shaft"
        if watts.efficiency > MOST_EFFICIENT:
            yield f"{drawn}: a torque cell, a current sensor or the rpm is wrong"
        elif watts.efficiency < LEAST_EFFICIENT:
            yield f"{drawn}, where drives give 80 to 95: a current sensor, a torque cell or the rpm is wrong"
        if watts.crosstalk:
            count, way = watts.less_than_shaft, "little" if watts.crosstalk > 0 else "much"
            yield (
                f"{side}: its current sensor reads {abs(watts.crosstalk):.3f} W too {way} for each watt of "
                "the other side's, at one speed and torque (sensors on one ground?)"
                + (f", and in {count} rows less than the shaft has" if count else "")
                + ": battery watts are put right for that"
            )


def _wrong_way(data: StandData) -> Iterator[str]:
    """Rows at speed in which a load has the wrong sign."""
    for side, u, other in _sides(data):
        for load in (name for name in data.measured if name.startswith(side)):
            values = data.loads[load]
            least = -IDLE * np.nanmax(np.abs(values))
            rows = np.flatnonzero((u > DRIVEN_ALONE * u.max()) & (u >= other) & (values < least))
            if len(rows):
                quantity = Load.of(load).quantity
                where = _row_names(data, rows)
                yield f"{side}: {quantity} against its rotor in {len(rows)} rows at speed ({where})"


def _few_rows(data: StandData, form: str) -> Iterator[str]:
    for load in data.measured:
        terms = len(load_terms(form, load))
        rows = int(np.isfinite(data.loads[load]).sum())
        if rows < ROWS_A_TERM * terms:
            yield (
                f"{load}: {rows} rows for the {terms} terms of {form}: {ROWS_A_TERM} a term are needed; "
                "`form` rcrm has at most 2"
            )


def _row_names(data: StandData, rows: NDArray[np.int64]) -> str:
    shown = ", ".join(data.samples.place(int(row)) for row in rows[:SHOWN])
    return shown + (f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else "")
