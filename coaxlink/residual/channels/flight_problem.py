"""The regression of a flight, its noise floor, and the variables that its residual may depend on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coaxlink.effects import NotShown, flight_effects
from coaxlink.frames import FLIGHT_CHANNELS, FLIGHT_UNITS, Array, FlightFrame
from coaxlink.residual.channels.flight import reduce_columns
from coaxlink.residual.nuisance.flight_corrections import flight_corrections
from coaxlink.residual.regression.blocks import solve
from coaxlink.residual.regression.joint_model import Joint, Part, columns_of
from coaxlink.residual.regression.problem import Index, Problem, build, contiguous_blocks
from coaxlink.signals import difference_gain, noise_floor, spectral_floor

JUDGED_HZ = 10.0


def known_parts(frame: FlightFrame) -> tuple[list[Part], list[str]]:
    """The effects that the model carries already, and notes on those that this log cannot evaluate."""
    by_name = {e.name: e for e in flight_effects()}
    parts: list[Part] = []
    notes = []
    logged = {"voltage_V": frame.voltage, "height_m": frame.height}
    for known in frame.model.effects:
        effect = by_name.get(known.name)
        if effect is None:
            notes.append(f"the model's effect {known.name} is none of a flight: left out")
            continue
        # what it needs must be there; whether it varies enough to be identified does not matter here
        absent = [n for n, values in logged.items() if n in effect.needs and values is None]
        if absent:
            notes.append(f"the model's effect {known.name} needs {absent[0]}, which the log lacks: left out")
            continue
        try:
            parts.append((effect, effect.completed(frame, known.parameters)))
        except NotShown as why:
            notes.append(f"the model's effect {known.name} is left out: {why}")
    return parts, notes


def flight_problem(frame: FlightFrame) -> Problem:
    """The regression of a flight: 4 Hz low-passed residual at the judged rows, whitened by its noise."""

    def reduce(columns: Array) -> Array:
        return reduce_columns(frame, columns)

    residual = reduce(frame.measured - frame.predicted)
    broken = runs_of(frame)
    floor = flight_floor(frame, frame.measured - frame.predicted, residual)
    return build(
        frame=frame,
        channels=FLIGHT_CHANNELS,
        units=FLIGHT_UNITS,
        reference=frame.reference,
        residual=residual,
        sigma=np.sqrt(floor**2 + (1e-3 * frame.reference) ** 2),
        corrections=[(c.name, c.bound, reduce(c.columns)) for c in flight_corrections(frame)],
        effects=flight_effects(),
        reduce=reduce,
        block=contiguous_blocks(frame.time_s[frame.keep], broken, least_s=2.0, count=40),
    )


def nuisance_columns(frame: FlightFrame, reduce: Callable[[Array], Array]) -> Array:
    """(kept, 6, B) of the nuisance model corrections of a frame."""
    return np.stack([reduce(c.columns) for c in flight_corrections(frame)], axis=-1)


def runs_of(frame: FlightFrame) -> Index:
    """(kept,) number of the run of neighbouring judged rows."""
    every = max(1, round(frame.rate_hz / JUDGED_HZ))
    return np.concatenate([[0], np.cumsum(np.diff(frame.keep) != every)]).astype(np.intp)


def flight_floor(frame: FlightFrame, residual: Array, reduced: Array, lag_s: float | None = None) -> Array:
    """(6,) noise after the low-pass: `residual` (frame rows, 6) is unfiltered, `reduced` (kept, 6) is not."""
    runs = runs_of(frame)
    first = np.flatnonzero(np.diff(runs, prepend=-1))
    last = np.append(first[1:], len(runs)) - 1
    pieces = [residual[frame.keep[a] : frame.keep[b] + 1] for a, b in zip(first, last, strict=True)]
    turned = [False] * 3 + [True] * 3
    floor = spectral_floor(
        pieces,
        frame.rate_hz,
        frame.cutoff_hz,
        lag_s=frame.airframe.motor_lag_s if lag_s is None else lag_s,
        raw_rate_hz=1.0 / frame.step_s,
        differentiated=turned,
        sampling=frame.sampling,
        declared_lag_s=frame.airframe.motor_lag_s,
        alike=np.array([frame.airframe.mass_kg] * 3 + list(frame.airframe.inertia_kg_m2)),
    )
    if floor is not None:
        return np.maximum(floor, frame.rounding)
    every = max(1, round(frame.rate_hz / JUDGED_HZ))
    gain = [difference_gain(frame.rate_hz, frame.cutoff_hz, every, differentiated=d) for d in turned]
    estimated = noise_floor(reduced, runs.astype(float), np.array(gain))
    # slow rows: nothing above the band tells what commands between them did, but the rows themselves do
    return np.maximum(np.hypot(estimated, frame.sampling), frame.rounding)


def floor_behind(frame: FlightFrame, joint: Joint) -> Array:
    """(6,) noise floor behind everything that was found, all of it acting in the frame."""
    q = joint.problem
    final = solve(q.blocks, columns_of(q), np.ones(q.blocks.count))
    left = frame.measured - frame.predicted - corrected(frame, final[q.nuisance], q.nuisance_names)
    lags = [m.shape["lag_s"] for m in joint.members if m.name == "rotor_lag"]
    return flight_floor(frame, left, reduce_columns(frame, left), *lags)


def corrected(frame: FlightFrame, values: Array, names: tuple[str, ...]) -> Array:
    """(frame rows, 6) that the nuisance corrections add with coefficients (B,) in the order of `names`."""
    total = np.zeros_like(frame.predicted)
    amount = dict(zip(names, values, strict=True))
    for correction in flight_corrections(frame):
        total += amount[correction.name] * correction.columns
    return total


def flight_variables(frame: FlightFrame) -> dict[str, Array]:
    """(kept,) recorded and derived variables that a residual may still depend on."""
    upper = [i for i, r in enumerate(frame.airframe.rotors) if r.level != "lower"]
    lower = [i for i, r in enumerate(frame.airframe.rotors) if r.level == "lower"]
    out = {
        "time_s": frame.time_s,
        "upper_speeds": frame.speeds[:, upper].mean(axis=1),
        "vel_x_body_m_s": frame.velocity[:, 0],
        "vel_y_body_m_s": frame.velocity[:, 1],
        "vel_z_body_m_s": frame.velocity[:, 2],
        "airspeed_m_s": np.linalg.norm(frame.velocity, axis=1),
        "roll_rad": frame.attitude[:, 0],
        "pitch_rad": frame.attitude[:, 1],
        "yaw_rad": frame.attitude[:, 2],
        "yaw_rate_rad_s": frame.rates[:, 2],
    }
    for k, rotor in enumerate(frame.airframe.rotors):
        out[f"motor{rotor.number}"] = frame.speeds[:, k]
    if lower:
        out["lower_speeds"] = frame.speeds[:, lower].mean(axis=1)
    if frame.height is not None:
        out["height_m"] = frame.height
    if frame.voltage is not None:
        out["voltage_V"] = frame.voltage
    return {name: values[frame.keep] for name, values in out.items()}
