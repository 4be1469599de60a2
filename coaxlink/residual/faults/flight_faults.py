"""Flight data that cannot be what their labels say: stuck or reversed sensors, repeats, swapped motors.

Found before anything is fitted; the rows are left out, or, where every row is concerned, nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from coaxlink.data.logs.flight import impossible_commands
from coaxlink.data.samples import Samples
from coaxlink.frames import Array, FlightFrame
from coaxlink.residual.channels.flight import EDGE_S, reduce_columns
from coaxlink.residual.faults.contradictions import contradicted, motors_too_many
from coaxlink.residual.faults.repeated_readings import DEAD, copied, stuck
from coaxlink.residual.faults.stand_faults import rows_text
from coaxlink.residual.faults.states import Mask, runs_of
from coaxlink.residual.result import Suspect
from coaxlink.signals import derivative, low_pass

SWAP = 0.1  # of the torque's squares left with two motors exchanged
# times what the exchange leaves: one failing rotor, or a centre of mass, that leaves less explains as much
FAILS = 3.0
REVERSED = -0.7  # correlation of a gyro with the attitude's own rate
# a sound gyro's scale is off by less; what a filter or slow rows do falls with frequency, a scale does not
SCALE, SCALE_HZ, PIECES = 0.05, (1.2, 0.6), 8
# what moves the vehicle before its command (judgement: twice what clocks of one autopilot are apart); shifts
# that are tried, band of the torques that tell, and how like the two must be where one is shifted
LEADS_S, SHIFTS_S, BAND_HZ, ALIKE = 0.02, np.linspace(-0.15, 0.15, 31), 0.5, 0.7
SPARED = {"height_m", "voltage_V"}  # columns a flight can be judged without


def flight_suspects(frame: FlightFrame, logs: Sequence[Samples]) -> tuple[list[Suspect], Mask, bool]:
    """Suspects, (frame rows,) mask of rows to leave out, and whether the log as a whole is wrong.

    It is where a label is, a gyro's sign or scale, or where a sensor was dead for most of the flight.
    """
    out: list[Suspect] = []
    bad, dead = np.zeros(len(frame.time_s), bool), False
    for number, log in enumerate(logs):
        for column, rows, why in [*stuck(log), *copied(log)]:
            out.append(Suspect(column, rows_text(rows), why))
            mine = frame.log == number
            bad |= mine & _around(frame.time_s, log["time_s"], rows)
            dead |= rows.mean() > DEAD
        rotors = {r.number for r in frame.airframe.rotors}
        out += _impossible(log, rotors)
        for column, rows, why in [*motors_too_many(log, rotors), *contradicted(log)]:
            out.append(Suspect(column, rows_text(rows), why))
            dead |= column not in SPARED
    wrong = [*_reversed(frame), *_swapped(frame), *_early(frame)]
    return [*out, *wrong], bad, bool(wrong) or dead


def _impossible(log: Samples, rotors: set[int]) -> list[Suspect]:
    """Motors commanded outside 0..1; the frame has a gap there."""
    outside = {f"motor{n}": impossible_commands(log[f"motor{n}"]) for n in sorted(rotors)}
    why = "commands outside 0..1, as of damaged packets: what follows from them is left out"
    return [Suspect(name, rows_text(rows), why) for name, rows in outside.items() if rows.any()]


def without_flagged(frame: FlightFrame, suspects: Sequence[Suspect]) -> FlightFrame:
    """The frame without the columns that a flight can be judged without, where they are flagged."""
    flagged = {s.column for s in suspects}
    return replace(
        frame,
        height=None if "height_m" in flagged else frame.height,
        voltage=None if "voltage_V" in flagged else frame.voltage,
    )


def _around(frame_time: Array, time: Array, rows: Mask) -> Mask:
    """(frame rows,) whether a frame's row lies in a run of the log's rows, or so near that it is felt."""
    out = np.zeros(len(frame_time), bool)
    for a, b in runs_of(rows):
        first, last = float(np.nanmin(time[a:b])), float(np.nanmax(time[a:b]))
        out |= (frame_time >= first - EDGE_S) & (frame_time <= last + EDGE_S)
    return out


def _reversed(frame: FlightFrame) -> list[Suspect]:
    """A gyro that turns against the attitude that the same log tells, or by another factor than one."""
    out = []
    slow, slower = (_turning(frame, hz) for hz in SCALE_HZ)
    for k, axis in enumerate("xyz"):
        gyro, attitude_rate = (x[frame.keep, k] for x in _turning(frame, frame.cutoff_hz))
        if np.std(attitude_rate) < 0.02 or np.std(gyro) < 0.02:
            continue
        agreement = float(np.corrcoef(gyro, attitude_rate)[0, 1])
        if agreement < REVERSED:
            why = f"its sign is reversed: against the attitude's own rate the correlation is {agreement:.2f}"
            out.append(Suspect(f"gyro_{axis}_rad_s", "all", why))
            continue
        scales = [_scale(frame, gyro[:, k], attitude_rate[:, k]) for gyro, attitude_rate in (slow, slower)]
        if all(low > 1.0 + SCALE for low, _ in scales) or all(high < 1.0 - SCALE for _, high in scales):
            why = f"it reads {np.mean(scales[-1]):.2f} times the attitude's own rate: its scale is wrong"
            out.append(Suspect(f"gyro_{axis}_rad_s", "all", why))
    return out


def _early(frame: FlightFrame) -> list[Suspect]:
    """Torques that come before their commands, as if motors had a lag less than none: a clock is off."""
    due = frame.airframe.body_loads(*frame.airframe.loads(frame.model, np.clip(frame.commands, 0.0, None)))
    sides = [_band(frame, x[:, 3:5]) for x in (frame.measured, due)]
    measured = sides[0][frame.keep]
    shifted = [_shifted(frame, sides[1], shift)[frame.keep] for shift in SHIFTS_S]
    pieces = np.array_split(np.arange(len(frame.keep)), PIECES)
    power = np.stack([np.sum(measured[p] ** 2, axis=0) for p in pieces])
    cross = np.stack([[np.sum(measured[p] * x[p], axis=0) for x in shifted] for p in pieces])
    own = np.stack([[np.sum(x[p] ** 2, axis=0) for x in shifted] for p in pieces])

    def lead(use: NDArray[np.intp]) -> tuple[float, float]:
        """Seconds by which the torques come first, and how like the two then are."""
        scale = np.sqrt(np.maximum(power[use].sum(axis=0) * own[use].sum(axis=0), 1e-300))
        alike = np.mean(cross[use].sum(axis=0) / scale, axis=1)
        return -float(SHIFTS_S[int(np.argmax(alike))]), float(np.max(alike))

    every = np.arange(PIECES)
    first, alike = lead(every)
    parts = np.array([lead(np.delete(every, k))[0] for k in every])
    reach = 4.0 * float(np.sqrt((PIECES - 1) / PIECES * np.sum((parts - parts.mean()) ** 2)))
    if alike < ALIKE or first - reach < LEADS_S:
        return []
    why = (
        f"torques come {1000.0 * first:.0f} ms before their commands: stamps of motors or of sensors are off"
    )
    return [Suspect("time_s", "all", why)]


def _stretches(frame: FlightFrame, made: Callable[[NDArray[np.intp]], Array]) -> Array:
    """(rows, K) what is made of the rows of every stretch without a gap."""
    parts = [np.flatnonzero(frame.stretch == number) for number in np.unique(frame.stretch)]
    values = [made(rows) for rows in parts]
    out = np.zeros((len(frame.time_s), *values[0].shape[1:]))
    for rows, value in zip(parts, values, strict=True):
        out[rows] = value
    return out


def _band(frame: FlightFrame, loads: Array) -> Array:
    """(rows, K) between BAND_HZ and what is judged."""

    def between(rows: NDArray[np.intp]) -> Array:
        smooth = low_pass(loads[rows], frame.rate_hz, frame.cutoff_hz)
        return smooth - low_pass(loads[rows], frame.rate_hz, BAND_HZ)

    return _stretches(frame, between)


def _shifted(frame: FlightFrame, loads: Array, later_s: float) -> Array:
    """(rows, K) as they were so much earlier, within stretches."""

    def earlier(rows: NDArray[np.intp]) -> Array:
        time = frame.time_s[rows]
        return np.stack([np.interp(time - later_s, time, x) for x in loads[rows].T], axis=1)

    return _stretches(frame, earlier)


def _turning(frame: FlightFrame, cutoff_hz: float) -> tuple[Array, Array]:
    """(rows, 3) body rates below a frequency, as the gyro tells them and as the logged attitude turns."""
    attitude = frame.extra.get("logged_attitude", frame.attitude)  # as logged: nothing of the gyro in it

    def turned(rows: NDArray[np.intp]) -> Array:
        smooth = low_pass(np.unwrap(attitude[rows], axis=0), frame.rate_hz, frame.cutoff_hz)
        return derivative(smooth, frame.rate_hz)

    rate, gyro = _stretches(frame, turned), frame.rates
    roll, pitch = attitude[:, 0], attitude[:, 1]
    body = np.stack(
        [
            rate[:, 0] - rate[:, 2] * np.sin(pitch),
            rate[:, 1] * np.cos(roll) + rate[:, 2] * np.sin(roll) * np.cos(pitch),
            -rate[:, 1] * np.sin(roll) + rate[:, 2] * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )
    if cutoff_hz < frame.cutoff_hz:
        gyro, body = (
            _stretches(frame, lambda rows, x=x: low_pass(x[rows], frame.rate_hz, cutoff_hz))  # type: ignore[misc]
            for x in (gyro, body)
        )
    return gyro, body


def _scale(frame: FlightFrame, gyro: Array, attitude_rate: Array) -> tuple[float, float]:
    """Between what gyro over attitude's rate (rows,) lies: four sigma, pieces of the flight left out in turn.

    A delay between the two is fitted beside. With the gyro on the right side its noise makes the factor seem
    larger, with the attitude's rate there that one's noise makes it seem smaller: it lies between the two.
    """
    late = _stretches(frame, lambda rows: derivative(gyro[rows], frame.rate_hz))
    columns = np.stack([gyro, late, np.ones(len(gyro))], axis=1)[frame.keep]
    pieces = np.array_split(np.arange(len(frame.keep)), PIECES)
    grams = np.stack([columns[p].T @ columns[p] for p in pieces])
    moments = np.stack([columns[p].T @ attitude_rate[frame.keep][p] for p in pieces])
    whole, ridge = grams.sum(axis=0), 1e-12 * np.trace(grams.sum(axis=0)) * np.eye(3)

    def factor(gram: Array, moment: Array) -> float:
        return 1.0 / max(float(np.linalg.solve(gram + ridge, moment)[0]), 1e-3)

    parts = np.array(
        [factor(whole - g, moments.sum(axis=0) - m) for g, m in zip(grams, moments, strict=True)]
    )
    reach = 4.0 * float(np.sqrt((PIECES - 1) / PIECES * np.sum((parts - parts.mean()) ** 2)))
    high = factor(whole, moments.sum(axis=0))
    fit = columns @ np.linalg.solve(whole + ridge, moments.sum(axis=0))
    like = float(np.var(fit) / max(float(np.var(attitude_rate[frame.keep])), 1e-12))
    return (high * like - reach, high + reach) if like > 0.5 else (-np.inf, np.inf)


def _one_fails(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, if one rotor lost some of its loads."""
    at = replace(frame, keep=np.arange(len(measured))).turning_at(
        np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    )
    misfit = measured - at.predicted[:, 3:] / scale
    least = np.inf
    for k in range(at.thrust.shape[1]):
        only = np.eye(at.thrust.shape[1])[k]
        none = np.zeros_like(at.thrust)
        lost = [
            at.airframe.body_loads(at.thrust * only, none),
            at.airframe.body_loads(none, at.torque * only),
        ]
        columns = np.stack([(x[:, 3:] / scale).ravel() for x in lost], axis=1)
        fit = np.linalg.lstsq(columns, misfit.ravel(), rcond=None)[0]
        least = min(least, float(np.mean((misfit.ravel() - columns @ fit) ** 2)))
    return least


def off_centre(frame: FlightFrame, measured: Array, scale: Array) -> float:
    """What is left of the torques (kept, 3), over `scale`, with the centre of mass at its best."""
    loads = reduce_columns(frame, frame.predicted)
    none = np.zeros(len(loads))
    along = np.stack([none, -loads[:, 2], loads[:, 1]], axis=1)  # e_x x F
    aside = np.stack([loads[:, 2], none, -loads[:, 0]], axis=1)  # e_y x F
    columns = np.stack([(x / scale).ravel() for x in (along, aside)], axis=1)
    misfit = (measured - loads[:, 3:] / scale).ravel()
    fit = np.linalg.lstsq(columns, misfit, rcond=None)[0]
    return float(np.mean((misfit - columns @ fit) ** 2))


def _swapped(frame: FlightFrame) -> list[Suspect]:
    """Two motors whose commands explain the torques only when exchanged."""
    speeds = np.clip(reduce_columns(frame, frame.speeds), 0.0, None)
    measured = reduce_columns(frame, frame.measured)[:, 3:]
    scale = np.std(measured, axis=0) + 1e-9

    def left(order: list[int]) -> Array:
        loads = frame.airframe.body_loads(*frame.airframe.loads(frame.model, speeds[:, order]))
        return np.asarray(np.mean(((measured - loads[:, 3:]) / scale) ** 2, axis=1))

    count = speeds.shape[1]
    labelled = left(list(range(count)))
    exchanged, pair = labelled, (0, 0)
    for i, j in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        now = left(order)
        if now.mean() < exchanged.mean():
            exchanged, pair = now, (i, j)
    as_labelled, best = float(labelled.mean()), float(exchanged.mean())
    if best > SWAP * as_labelled or as_labelled < 0.05:
        return []
    # cables are exchanged from the first row on; what fits as it is labelled for a while began in mid-flight
    pieces = zip(np.array_split(labelled, PIECES), np.array_split(exchanged, PIECES), strict=True)
    if any(FAILS * a.mean() < b.mean() for a, b in pieces):
        return []
    if min(rival(frame, measured / scale, scale) for rival in (_one_fails, off_centre)) < FAILS * best:
        return []
    closer = np.sqrt(as_labelled / best)
    why = f"with the two exchanged the torques fit {closer:.0f} times closer: they are swapped"
    return [Suspect(f"motor{pair[0] + 1}, motor{pair[1] + 1}", "all", why)]
