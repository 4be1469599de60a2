"""A flight log as charts: rotors, pairs, wrench, vibration, battery, and what happened."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.flight import flight_frame, reduce_columns
from coaxlink.data import Samples, read_flights
from coaxlink.data.samples import DAMAGED, PREMISES
from coaxlink.errors import InputError
from coaxlink.mixer.exact import ExactLaw
from coaxlink.premises.same_vehicle import other_vehicle
from coaxlink.tables.px4 import not_in_newtons
from coaxlink.vehicle import Vehicle
from firmware_params import px4
from firmware_params.errors import TableError

Array = NDArray[np.float64]
POINTS = 3000  # of a line on the page, the least and the largest of each stretch: what a screen can show
IDEAL_ROWS = 400  # at which the exact law is asked for its split
TAKE_OFF, AT_REST = "takes off", 0.05  # of full command: below it a motor stands or idles
MEASURE = "measure the rotors on a stand (coaxlink identify), then upload a table of theirs"
WORST = 4  # severity: warnings and worse (MAVLink, syslog)


@dataclass(frozen=True)
class Line:
    """One line of a chart."""

    name: str
    x: Array  # (rows,) s since the log's first row, or Hz
    y: Array  # (rows,) NaN where nothing is known
    rotor: int = 0  # index that picks the colour
    dashed: bool = False

    def to_json(self) -> dict[str, Any]:
        """As the page's script takes it."""
        x, y = _thinned(self.x, self.y)
        return {"name": self.name, "look": self.rotor, "dashed": self.dashed, "x": _short(x), "y": _short(y)}


@dataclass(frozen=True)
class Chart:
    """Lines over time, or over frequency."""

    title: str
    unit: str
    lines: tuple[Line, ...]
    over: str = "time, s"
    note: str = ""
    span: tuple[float, float] | None = None  # of the axis; None: as the lines need


@dataclass(frozen=True)
class FlightCharts:
    """A log as the flight page shows it."""

    source: str
    seconds: float
    answer: str
    charts: tuple[Chart, ...]
    events: tuple[tuple[float, str], ...]  # s since the first row, in words
    premises: tuple[str, ...] = field(default=())
    provenance: tuple[str, ...] = ()  # of those what must be reported with the answer


def flight_charts(path: Path, vehicle: Vehicle | None, system: int | None = None) -> list[FlightCharts]:
    """Read a log and draw up the charts of its flights; without a `vehicle` what the log alone tells.

    Of several vehicles that of `system`. Raises InputError.
    """
    return [_charts(samples, vehicle) for samples in read_flights(path, system)]


def _charts(samples: Samples, vehicle: Vehicle | None) -> FlightCharts:
    start = float(samples["time_s"][0])
    motors = sorted(int(n[5:]) for n in samples.columns if n.startswith("motor") and n[5:].isdigit())
    charts = list(_logged(samples, motors, start))
    rests = [*samples.provenance, *(PREMISES[p] for p in samples.premises), *samples.notes]
    if vehicle is None:
        answer = "Thrust, the split of the pairs and the wrench need the file of the airframe."
    else:
        try:
            modelled, answer = _modelled(samples, vehicle, start)
            charts[1:1] = modelled
        except InputError as error:
            answer = f"No thrust, split or wrench: {error}."
    seconds = float(samples["time_s"][-1]) - start
    return FlightCharts(
        Path(samples.source).name,
        seconds,
        answer,
        tuple(charts),
        tuple(_events(samples, start)),
        tuple(rests),
        (*samples.provenance, *(PREMISES[p] for p in samples.premises if p == DAMAGED)),
    )


def _logged(samples: Samples, motors: Sequence[int], start: float) -> Iterator[Chart]:
    """What needs no model of the rotors."""
    time = samples["time_s"] - start

    def of_rotors(name: str) -> tuple[Line, ...]:
        there = [n for n in motors if name.format(n) in samples.columns]
        return tuple(Line(f"rotor {n}", time, samples[name.format(n)], n - 1) for n in there)

    yield Chart("Command of every rotor", "of full", of_rotors("motor{}"))
    for title, unit, name in (
        ("Speed of every rotor, measured", "rpm", "rpm{}"),
        ("Current of every rotor", "A", "current{}_A"),
        ("Temperature of every ESC", "degrees C", "temperature{}_C"),
    ):
        lines = of_rotors(name)
        if lines or unit != "degrees C":
            yield Chart(title, unit, lines, note="" if lines else "not in this log")
    yield _vibration(samples, motors)
    if samples.has("voltage_V"):
        yield Chart("Battery", "V", (Line("voltage", time, samples["voltage_V"]),))
    turns = [Line(a, time, np.degrees(samples[f"{a}_rad"]), k) for k, a in enumerate(("roll", "pitch"))]
    yield Chart("Attitude", "degrees", tuple(turns))
    if samples.has("height_m"):
        yield Chart("Height above ground", "m", (Line("height", time, samples["height_m"]),))


def _vibration(samples: Samples, motors: Sequence[int]) -> Chart:
    """Spectrum of the accelerometer while the motors turn, amplitude per root of bandwidth."""
    from scipy.signal import welch

    time = samples["time_s"]
    step = float(np.median(np.diff(time)))
    flying = np.mean([samples[f"motor{n}"] for n in motors], axis=0) > AT_REST
    runs = np.split(np.flatnonzero(flying), np.flatnonzero(np.diff(np.flatnonzero(flying)) != 1) + 1)
    rows = max(runs, key=len)  # the longest stretch in one piece
    lines = []
    if len(rows) >= 64:
        for k, axis in enumerate("xyz"):
            values = samples[f"accel_{axis}_m_s2"][rows]
            length = min(len(rows), 1024)
            f, power = welch(values, fs=1.0 / step, nperseg=length, detrend="linear")
            lines.append(Line(axis, f[1:], np.sqrt(power[1:]), k))
    limit = f"to {0.5 / step:.0f} Hz: what this log's {1.0 / step:.0f} rows a second can show"
    return Chart("Vibration, spectrum of the accelerometer", "m/s² per √Hz", tuple(lines), "Hz", limit)


def _modelled(samples: Samples, vehicle: Vehicle, start: float) -> tuple[list[Chart], str]:
    """Thrust, split against the ideal, wrench demanded and delivered; and the answer. Raises InputError."""
    airframe, model = vehicle.airframe, vehicle.model
    frame = flight_frame([samples], airframe, model)
    time = frame.time_s[frame.keep] - start
    thrust = reduce_columns(frame, frame.thrust)
    delivered, demanded, by, unknown = _wrenches(samples, vehicle, frame)
    rotors = tuple(
        Line(f"rotor {r.number} {r.level}", time, thrust[:, n], r.number - 1)
        for n, r in enumerate(airframe.rotors)
    )
    charts = [Chart("Thrust of every rotor", "N", rotors, note="by the rotor model at the commanded speeds")]
    flown, ideal = np.zeros(0), np.zeros(0)
    if airframe.pairs:
        rows = np.unique(np.linspace(0, len(time) - 1, IDEAL_ROWS).astype(int))
        best = airframe.loads(model, ExactLaw(vehicle).many(delivered[rows]))[0]
        lines = []
        for k, (u, low) in enumerate(airframe.pairs):
            name = f"pair {airframe.rotors[u].number}/{airframe.rotors[low].number}"
            lines.append(Line(name, time, _share(thrust, u, low), k))
            lines.append(Line(f"{name} ideal", time[rows], _share(best, u, low), k, dashed=True))
        flown = np.mean([line.y.mean() for line in lines[::2]])
        ideal = np.mean([line.y.mean() for line in lines[1::2]])
        note = "dashed: the split of least power for the wrench that was delivered (exact law)"
        charts.append(
            Chart(
                "Split: thrust of the lower rotor, of its pair",
                "%",
                tuple(lines),
                note=note,
                span=(0.0, 100.0),
            )
        )
    for k, (axis, unit) in enumerate((("Thrust", "N"), ("Roll", "N m"), ("Pitch", "N m"), ("Yaw", "N m"))):
        lines = [Line("delivered", time, delivered[:, k], 0), Line("demanded", time, demanded[:, k], 4, True)]
        note = f"demanded: {by}; delivered: mass and inertia times what was measured"
        charts.append(Chart(f"{axis}, demanded and delivered", unit, tuple(lines), note=note))
    gain = float((demanded[:, 0] * delivered[:, 0]).sum() / (demanded[:, 0] ** 2).sum())
    roll, pitch, yaw = np.mean(delivered - demanded, axis=0)[1:]
    lift, kg = float(np.mean(demanded[:, 0])), airframe.mass_kg
    ahead, aside = _aside(-pitch, lift, "forward", "back"), _aside(roll, lift, "right", "left")
    sentences = [
        f"Mass: thrust came out at {gain:.2f} of what {by} says, as if the vehicle had {kg / gain:.1f} kg "
        f"(file: {kg:g})",
        f"Centre of mass: the mean torque beyond that is of one {ahead} and {aside} of the file's "
        f"(roll {roll:+z.2f}, pitch {pitch:+z.2f} N m)",
        f"Mean yaw torque beyond it: {yaw:+z.2f} N m",
    ]
    if airframe.pairs:
        sentences.insert(
            0, f"The lower rotors carried {flown:.0f} % of the thrust, {ideal:.0f} % is least power"
        )
    sentences += [unknown] if unknown else []
    others = [f"This may be another vehicle's flight: {o.why}" for o in other_vehicle(frame, [samples])]
    return charts, ". ".join([*others, *sentences]) + "."


def _aside(torque_Nm: float, lift_N: float, one: str, other: str) -> str:
    """How far a centre of mass lies aside that makes this torque under a lift: M = -r x F."""
    way = 1e3 * torque_Nm / lift_N
    return f"{abs(way):.1f} mm {one if way >= 0 else other}"


def _wrenches(samples: Samples, vehicle: Vehicle, frame: Any) -> tuple[Array, Array, str, str]:
    """(kept, 4) delivered and demanded [thrust up, roll, pitch, yaw], by what it was demanded, and why not by
    the table, where that is worth saying."""
    unknown = ""

    def upward(loads: Array) -> Array:
        return np.concatenate([-loads[:, 2:3], loads[:, 3:6]], axis=1)

    try:
        believed = px4.realise(samples.parameters).wrench(frame.speeds)
        by = "the table on board"
        if believed.shape != (len(frame.speeds), 4):
            raise ValueError(believed.shape)
        lift = (float(np.mean(thrust[frame.keep, 0])) for thrust in (believed, upward(frame.measured)))
        if why := not_in_newtons(samples.parameters, *lift):
            believed, by = upward(frame.predicted), "the rotor model"
            unknown = f"What the table on board means cannot be judged: {why}; {MEASURE}"
    except (TableError, ValueError, KeyError, IndexError):
        believed, by = upward(frame.predicted), "the rotor model"
    return reduce_columns(frame, upward(frame.measured)), reduce_columns(frame, believed), by, unknown


def _share(thrust: Array, upper: int, lower: int) -> Array:
    """(rows,) % of the pair's thrust that the lower rotor carries; NaN where the pair carries none."""
    both = thrust[:, upper] + thrust[:, lower]
    return np.where(both > 1e-6, 100.0 * thrust[:, lower] / np.where(both > 1e-6, both, 1.0), np.nan)


def _events(samples: Samples, start: float) -> list[tuple[float, str]]:
    """What the log says in words, and when the vehicle armed and flew."""
    found: list[tuple[float, str]] = []
    words = {"armed": ("armed", "disarmed"), "landed": ("landed", TAKE_OFF)}
    for name, (on, off) in words.items():
        if name in samples.columns:
            state = samples[name] > 0.5
            at = np.flatnonzero(np.diff(state.astype(int))) + 1
            found += [(float(samples["time_s"][i]) - start, on if state[i] else off) for i in at]
    found += [
        (t - start, text) for t, severity, text in samples.texts if severity is None or severity <= WORST
    ]
    last = float(samples["time_s"][-1]) - start
    return sorted(row for row in found if -1.0 <= row[0] <= last + 1.0)


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """At most about POINTS rows: of each stretch the least and the largest, in their order."""
    if len(x) <= POINTS:
        return x, y
    edges = np.linspace(0, len(x), POINTS // 2 + 1).astype(int)
    filled = np.where(np.isfinite(y), y, np.nanmean(y) if np.isfinite(y).any() else 0.0)
    rows = []
    for a, b in itertools.pairwise(edges):
        piece = filled[a:b]
        rows += sorted({a + int(piece.argmin()), a + int(piece.argmax())})
    return x[rows], y[rows]


def _short(values: Array) -> list[float | None]:
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values.tolist()]


def as_json(flights: Sequence[FlightCharts]) -> Mapping[str, Any]:
    """What the page's script draws: a row a chart, a column a log."""
    titles = list(dict.fromkeys(c.title for f in flights for c in f.charts))
    rows = []
    for title in titles:
        cells = [next((c for c in f.charts if c.title == title), None) for f in flights]
        one = next(c for c in cells if c is not None)
        drawn = [
            {"note": "not in this log", "lines": []}
            if c is None
            else {"note": c.note, "lines": [line.to_json() for line in c.lines]}
            for c in cells
        ]
        rows.append({"title": title, "unit": one.unit, "over": one.over, "span": one.span, "cells": drawn})
    events = [[{"t": round(t, 3), "text": text} for t, text in f.events] for f in flights]
    return {"logs": [f.source for f in flights], "rows": rows, "events": events}
