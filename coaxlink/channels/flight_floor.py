"""The noise floor of a flight, and the variables that its residual may depend on."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coaxlink.channels.flight import JUDGED_RATE_HZ, reduce_columns
from coaxlink.channels.flight_corrections import flight_corrections
from coaxlink.evidence.held_out import Index
from coaxlink.frames import Array, FlightFrame
from coaxlink.signals import difference_gain, noise_floor, spectral_floor


def runs_of(frame: FlightFrame) -> Index:
    """(kept,) number of the run of neighbouring judged rows."""
    every = max(1, round(frame.rate_hz / JUDGED_RATE_HZ))
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
        return floor
    every = max(1, round(frame.rate_hz / JUDGED_RATE_HZ))
    gain = [difference_gain(frame.rate_hz, frame.cutoff_hz, every, differentiated=d) for d in turned]
    estimated = noise_floor(reduced, runs.astype(float), np.array(gain))
    # slow rows: nothing above the band tells what commands between them did, but the rows themselves do
    return np.asarray(np.hypot(estimated, frame.sampling))


def floor_behind(frame: FlightFrame, corrections: Mapping[str, float], lag_s: float | None = None) -> Array:
    """(6,) noise floor behind everything that was found, all of it acting in the frame."""
    left = frame.measured - frame.predicted
    for c in flight_corrections(frame):
        left = left - corrections[c.name] * c.columns
    return flight_floor(frame, left, reduce_columns(frame, left), lag_s)


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
    for axis, towards in (("north_m", frame.north), ("east_m", frame.east)):
        out[axis] = np.cumsum(np.sum(frame.velocity * towards, axis=1)) / frame.rate_hz
    return {name: values[frame.keep] for name, values in out.items()}
