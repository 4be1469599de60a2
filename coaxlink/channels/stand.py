"""From stand samples to measured and predicted loads of both rotors.

With a rotor model given, the nuisance may be off by the few per cent that another day on the stand costs.
Without one, the polynomials of the coaxial rotor model (Berra, Trujillo and Heredia 2024, eq. 1-3) are fitted
to the log itself, all their terms free beside every candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coaxlink.channels.judged_rows import (
    FEW_ROWS,
    IDLE,
    LEAST_ROWS,
    idle,
    set_points,
    turned_by_throttle,
    where_measured,
)
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError
from coaxlink.evidence.held_out import folds_of
from coaxlink.frames import STAND_CHANNELS, STAND_LOADS, Array, StandFrame
from coaxlink.load import Load
from coaxlink.rotor import RotorModel
from coaxlink.rotor.model import LOADS
from coaxlink.rotor.polynomial import design_matrix
from coaxlink.rotor.stand_data import normalised_speeds

COLUMN_OF = {load.channel: load.column for load in Load}
Orders = tuple[tuple[int, ...], tuple[int, ...]]  # that may be tried of a fitted nuisance model: upper, lower
ORDERS = (2, 3, 4)
ANY: Orders = (ORDERS, ORDERS)
RICHER = 0.8  # a higher order must leave less than this share of the held-out squares
LEVEL, TILT, WAKE, OFFSET = 0.04, 0.03, 0.03, 0.01
ROWS_A_TERM = 4  # judgement: of a polynomial; with fewer it is no nuisance model to judge anything by
APART = 0.02  # of normalised speed: less is one speed
UNFOLLOWED = 3.0  # times the error elsewhere: rows with an idle lower rotor
# of normalised speed with next to no throttle (more is a dead band), of the other's throttle with none
JUMP, WINDMILL = 0.01, 0.1
# of load cells behind tachometers (filters, clocks); rows slower than that are settled
DELAY_S, FAST_S = 0.06, 0.3
Nuisance = list[tuple[str, float, Array]]  # name, bound, (rows, 6)


def joined(logs: Sequence[Samples]) -> Samples:
    """Logs one after the other; a column stays if all have it. Times run on."""
    if len(logs) == 1:
        return logs[0]
    names = [n for n in logs[0].columns if all(log.has(n) for log in logs)]
    columns = {n: np.concatenate([log[n] for log in logs]) for n in names}
    if "time_s" in columns:
        parts, end = [], 0.0
        for log in logs:
            own = log["time_s"] - log["time_s"][0]
            parts.append(end + own)
            end += float(own[-1]) + 60.0
        columns["time_s"] = np.concatenate(parts)
    columns["log"] = np.concatenate([np.full(log.rows, float(i)) for i, log in enumerate(logs)])
    notes = tuple(note for log in logs for note in log.notes)
    premises = tuple(dict.fromkeys(p for log in logs for p in log.premises))
    return Samples(columns, "; ".join(log.source for log in logs), notes, premises=premises)


def stand_frame(
    samples: Samples,
    model: RotorModel | None,
    orders: Orders = ANY,
    trusted: NDArray[np.intp] | None = None,
    *,
    extrapolated: bool = False,
) -> StandFrame:
    """Both sides of a stand log; without a model, one of these orders, as the log supports.

    `trusted` rows alone are asked for the nuisance model, and judged; without `extrapolated` none where the
    model's own stand did not run the rotors, or where a throttle does not turn its rotor.
    Raises InputError: nothing measured, no speeds, too few rows.
    """
    names = [c for c in STAND_LOADS if samples.has(COLUMN_OF[c])]
    if not names:
        samples.require(*COLUMN_OF.values())
    if samples.rows < (LEAST_ROWS if model is None else FEW_ROWS):
        need = f"{LEAST_ROWS} are needed to find an effect, {FEW_ROWS} to hold a given rotor model against"
        raise InputError(samples.source, "", f"{samples.rows} rows; {need}{samples.rows_lost()}")
    speeds = normalised_speeds(samples, model.speed_max_rpm if model else None)
    u = np.stack([speeds.upper, speeds.lower], axis=1)
    if model is not None and speeds.from_throttle:
        u = _turned(model, samples, u)
    measured = np.zeros((samples.rows, 6))
    for c, name in enumerate(STAND_LOADS):
        if name in names:
            measured[:, c] = samples[COLUMN_OF[name]]
    present = [c for c, name in enumerate(STAND_LOADS) if name in names]
    throttles = None
    turning = [side for side, column in enumerate(u.T) if np.ptp(column) > 0.0]
    names_of = {0: "upper_throttle", 1: "lower_throttle"}
    if not speeds.from_throttle and turning and all(samples.has(names_of[s]) for s in turning):
        throttles = np.zeros((samples.rows, 2))
        for side in turning:
            throttles[:, side] = samples[names_of[side]]
            if np.ptp(throttles[:, side]) > 0.05:
                present.append(4 + side)
                measured[:, 4 + side] = u[:, side]
        if model is not None:
            throttles = _turned(model, samples, throttles)
    time = samples["time_s"] if samples.has("time_s") else np.arange(float(samples.rows))
    back = np.diff(time) < 0
    if back.any():
        time = np.arange(float(samples.rows))
    free = model is None
    keep = np.arange(samples.rows) if trusted is None else trusted
    notes = [f"speeds: {speeds.source}"]
    if back.any():
        place = samples.place(int(np.argmax(back)) + 1)
        notes.append(f"time_s goes back at {place}: rows are counted instead, one a second")
    if model is None:
        present = _followed(samples, u[keep], present, orders, notes)
        nuisance, keep = _fitted_nuisance(u, measured, keep, present, speeds.speed_max_rpm, orders, notes)
    else:
        nuisance = model
        if not extrapolated:
            present, keep = where_measured(model, samples, u, present, keep, notes)
        if throttles is not None and model.drive is not None and {3, 5} <= set(present) and not extrapolated:
            keep = turned_by_throttle(u, throttles[:, 1], measured[:, 3], keep, notes)
    commanded = not speeds.from_throttle and throttles is None and set_points(u)
    if commanded:
        notes.append("rpm repeat to the last digit: they are taken for set-points, not for what was measured")
    if model is not None and not speeds.from_throttle and not commanded:
        awake = keep[~idle(u)[keep]]
        if LEAST_ROWS < len(awake) < len(keep):
            asleep = len(keep) - len(awake)
            notes.append(f"{asleep} rows, lower rotor below {100 * IDLE:.0f} % of full speed: not judged")
            keep = awake
    frame = StandFrame(
        model=nuisance,
        time_s=time,
        speeds=u,
        throttles=throttles,
        driven=speeds.from_throttle or commanded,
        predicted=np.zeros((samples.rows, 6)),
        measured=measured,
        present=tuple(present),
        slope=np.zeros((samples.rows, 4, 2)),
        reference=np.ones(6),
        free_nuisance=free,
        columns=samples.columns,
        block=_blocks(u if throttles is None else throttles, time),
        keep=keep,
        notes=tuple(notes),
    )
    return predict(frame)


def _turned(model: RotorModel, samples: Samples, throttles: Array) -> Array:
    """(rows, 2) speeds that throttles give by the model's drive, at the log's supply where it has one."""
    volts = [
        next((samples[n] for n in (f"{side}_voltage_V", "voltage_V") if samples.has(n)), None)
        for side in ("upper", "lower")
    ]
    if model.drive is None:
        return throttles
    supply = [model.drive.supply(v) for v in volts]
    return np.stack(model.turned(throttles[:, 0] * supply[0], throttles[:, 1] * supply[1]), axis=1)


def _followed(
    samples: Samples, u: Array, present: Sequence[int], orders: Orders, notes: list[str]
) -> list[int]:
    """Channels without loads that `u` (rows, 2) are too few rows to fit; InputError if no load is left."""
    short = [c for c in present if c < 4 and not _first_terms(LOADS[c], u, min(orders[c // 2]))]
    if not short:
        return list(present)
    names = ", ".join(STAND_CHANNELS[c] for c in short)
    why = f"{len(u)} rows, {ROWS_A_TERM} for each term of a load over both speeds are needed"
    left = [c for c in present if c not in short]
    if not [c for c in left if c < 4]:
        raise InputError(samples.source, "", f"{names}: {why}; give a rotor model (`rotor`)")
    notes.append(f"{names}: not judged ({why})")
    return left


def _first_terms(load: str, u: Array, order: int) -> list[str]:
    """The least polynomial of a load that these rows (rows, 2) support; [] where they support none."""
    for names in (dictionary_of(load, order), plainest_of(load, u)):
        if len(names) <= len(u) // ROWS_A_TERM:
            return names
    return []


def _fitted_nuisance(
    u: Array,
    measured: Array,
    keep: NDArray[np.intp],
    present: Sequence[int],
    speed_max_rpm: float,
    orders: Orders,
    notes: list[str],
) -> tuple[RotorModel, NDArray[np.intp]]:
    """The polynomials of these rows, and the rows: none with an idle lower rotor if they are not followed."""
    nuisance = fitted_model(u[keep], measured[keep], present, speed_max_rpm, orders)
    windmilling = idle(u[keep])
    lower = [c for c in present if c in (2, 3)]
    if not lower or not windmilling.any() or np.sum(~windmilling) <= LEAST_ROWS:
        return nuisance, keep
    pair = nuisance.loads(*u[keep].T)
    own = np.stack([pair.lower_thrust, pair.lower_torque], axis=1)[:, [c - 2 for c in lower]]
    left = measured[keep][:, lower] - own
    among, rest = (np.sqrt(np.mean(left[rows] ** 2, axis=0)) for rows in (windmilling, ~windmilling))
    if np.all(among < UNFOLLOWED * rest):
        return nuisance, keep
    notes.append(f"{windmilling.sum()} rows, lower rotor below {100 * IDLE:.0f} % of full speed: not judged")
    awake = keep[~windmilling]
    turning = fitted_model(u[awake], measured[awake], lower, speed_max_rpm, orders).terms()
    terms = {**nuisance.terms(), **{LOADS[c]: turning[LOADS[c]] for c in lower}}
    return RotorModel.from_terms(nuisance.form, speed_max_rpm, terms), awake


def predict(frame: StandFrame) -> StandFrame:
    """The frame with loads, slopes and references of its model at its speeds."""
    u, step = frame.speeds, 1e-4
    predicted = np.zeros((len(u), 6))
    predicted[:, :4] = frame.loads_at(u)
    if frame.throttles is not None:
        predicted[:, 4:] = frame.throttles
    ahead = [frame.loads_at(u + step * np.eye(2)[s]) for s in (0, 1)]
    behind = [frame.loads_at(u - step * np.eye(2)[s]) for s in (0, 1)]
    slope = np.stack([(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)], axis=-1)
    reference = np.ones(6)
    reference[:4] = np.maximum(np.quantile(np.abs(predicted[:, :4]), 0.95, axis=0), 1e-9)
    # thrust grows with the square: a per cent of speed is two of thrust
    reference[4:] = max(0.5 * float(np.quantile(u, 0.95)), 1e-9)
    return replace(frame, predicted=predicted, slope=slope, reference=reference)


def dictionary_of(load: str, order: int) -> list[str]:
    """Terms of one load's polynomial: the upper rotor's own speed, or both (eq. 1-3)."""
    from coaxlink.rotor.polynomial import term_name

    if load.startswith("upper"):
        return [term_name(a, 0) for a in range(order + 1)]
    return [term_name(a, b) for a in range(order + 1) for b in range(order + 1) if a + b <= max(order, 4)]


def plainest_of(load: str, u: Array) -> list[str]:
    """Terms of one load's square over what moves of both speeds (rows, 2): for logs of few rows."""
    from coaxlink.rotor.polynomial import term_name

    moves = np.ptp(u, axis=0) > APART
    if load.startswith("upper"):
        return [term_name(a, 0) for a in range(3)]
    most = 2 * moves
    return [term_name(a, b) for a in range(most[0] + 1) for b in range(most[1] + 1) if a + b <= 2]


def fitted_model(
    u: Array, measured: Array, present: Sequence[int], speed_max_rpm: float, orders: Orders = ANY
) -> RotorModel:
    """The polynomials that this log itself asks for, of the lowest order that held-out rows support."""
    terms: dict[str, dict[str, float]] = {load: {"u_u" if "upper" in load else "u_l": 0.0} for load in LOADS}
    fold = folds_of(20, 5)[np.arange(len(u)) * 20 // len(u)]
    for c in present:
        if c > 3:
            continue
        load, best = LOADS[c], np.inf
        for order in orders[c // 2]:
            first = order == min(orders[c // 2])
            names = _first_terms(load, u, order) if first else dictionary_of(load, order)
            if not 0 < len(names) <= len(u) // ROWS_A_TERM:
                break
            x, y, left = design_matrix(names, u[:, 0], u[:, 1]), measured[:, c], 0.0
            if not (np.isfinite(x).all() and np.isfinite(y).all()):
                break  # damaged readings, whose powers are beyond numbers: LAPACK would say so on the screen
            for f in range(5):
                fit = np.linalg.lstsq(x[fold != f], y[fold != f], rcond=1e-10)[0]
                left += float(np.sum((y[fold == f] - x[fold == f] @ fit) ** 2))
            if left < RICHER * best:
                best = left
                fit = np.linalg.lstsq(x, y, rcond=1e-10)[0]
                terms[load] = dict(zip(names, map(float, fit), strict=True))
    return RotorModel.from_terms("crm", speed_max_rpm, terms)


def base_corrections(frame: StandFrame) -> Nuisance:
    """What the nuisance model may be off by: its own terms, free or bounded, and the throttles' curves."""
    out: Nuisance = []
    rows = len(frame.time_s)

    def column(name: str, bound: float, channel: int, values: Array) -> None:
        if channel in frame.present:
            full = np.zeros((rows, 6))
            full[:, channel] = values
            out.append((name, bound, full))

    terms = frame.model.terms()
    for c, load in enumerate(LOADS):
        if frame.free_nuisance:
            for term in terms[load]:
                values = design_matrix([term], frame.speeds[:, 0], frame.speeds[:, 1])[:, 0]
                column(f"{load} {term}", np.inf, c, values)
            continue
        own, other = (0, 1) if c < 2 else (1, 0)
        nuisance = frame.predicted[:, c]
        column(f"{STAND_CHANNELS[c]}_level", LEVEL, c, nuisance)
        column(f"{STAND_CHANNELS[c]}_tilt", TILT, c, nuisance * (2.0 * frame.speeds[:, own] - 1.0))
        column(f"{STAND_CHANNELS[c]}_offset", OFFSET * frame.reference[c], c, np.ones(rows))
        if c > 1:
            column(f"{STAND_CHANNELS[c]}_wake", WAKE, c, nuisance * (2.0 * frame.speeds[:, other] - 1.0))
    step = float(np.median(np.diff(frame.time_s))) if rows > 2 else np.inf
    if not frame.driven and 0.0 < step < FAST_S:
        rate = np.gradient(frame.speeds, step, axis=0)
        late = -np.einsum("rcs,rs->rc", frame.slope, rate)
        for c in range(4):
            column(f"{STAND_CHANNELS[c]}_delay_s", DELAY_S, c, late[:, c])
    if frame.throttles is not None:
        for side in (0, 1):
            mine, rival = frame.throttles[:, side], frame.throttles[:, 1 - side]
            # a motor's speed bends with its load, and the load of a pair with both rotors
            curves = {
                "1": mine**0,
                "t": mine,
                "t^2": mine**2,
                "t^3": mine**3,
                "t o": mine * rival,
                "o": rival,
            }
            turns = np.where(mine > 0.0, 1.0, 0.0)
            rest = 1.0 - turns  # it stands, or the other's wake turns it
            resting = bool(rest[frame.keep].any())
            for name, values in curves.items():
                # a log that shows a rotor at rest shows where its curve ends
                bound = JUMP if resting and name == "1" else np.inf
                column(f"{STAND_CHANNELS[4 + side]}_throttle {name}", bound, 4 + side, turns * values)
            if resting:
                for name, bound, values in (("1", JUMP, rest), ("o", WINDMILL, rest * rival)):
                    column(f"{STAND_CHANNELS[4 + side]}_at_rest {name}", bound, 4 + side, values)
    return out


def _blocks(u: Array, time: Array) -> np.ndarray:
    """(rows,) held-out blocks: sweeps of a slow axis, cut to about two dozen contiguous pieces."""
    rows = len(u)
    jumps = np.zeros(rows, bool)
    for side in (0, 1):
        step = np.abs(np.diff(u[:, side], prepend=u[0, side]))
        jumps |= step > 0.3  # a new sweep starts where a speed jumps back
    sweep = np.cumsum(jumps)
    if not 6 <= sweep[-1] + 1 <= rows // 5:
        return np.asarray(np.arange(rows) * min(24, max(6, rows // 8)) // rows, np.intp)
    if sweep[-1] + 1 > 40:
        sweep = sweep * 24 // (sweep[-1] + 1)
    return np.asarray(sweep, np.intp)


def reducing(frame: StandFrame) -> Callable[[Array], Array]:
    """From (frame rows, 6) to (judged rows, C)."""
    keep, present = frame.keep, list(frame.present)
    return lambda columns: np.asarray(columns[keep][:, present])


def stand_variables(frame: StandFrame) -> dict[str, Array]:
    """(kept,) recorded variables that a residual may still depend on."""
    out = {"time_s": frame.time_s, "upper_speed": frame.speeds[:, 0], "lower_speed": frame.speeds[:, 1]}
    out |= {
        name: values
        for name, values in frame.columns.items()
        if not name.endswith(("_rpm", "_throttle", "_thrust_N", "_torque_Nm")) and name != "time_s"
    }
    return {name: values[frame.keep] for name, values in out.items() if np.all(np.isfinite(values))}
