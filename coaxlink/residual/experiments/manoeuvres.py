"""The flight that would tell rival explanations apart: manoeuvres about a hover, scored like a stand run.

A plan's log is worked out from its path alone: accelerations make the attitude and the thrust (differential
flatness, Mellinger and Kumar 2011), the nuisance's mixer the motor commands. That is near enough to compare
what rivals would add on it. Manoeuvres end where they begin, so they can be joined in any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from coaxlink.channels.flight import flight_frame, reduce_columns
from coaxlink.channels.flight_corrections import flight_corrections
from coaxlink.data.samples import Samples
from coaxlink.effects import NotShown
from coaxlink.errors import CoaxlinkError
from coaxlink.frames import FLIGHT_CHANNELS, GRAVITY_NED, Array, FlightFrame
from coaxlink.residual.experiments.stand_run import Experiment, Rival, View, joined, separated, view

if TYPE_CHECKING:
    from coaxlink.mixer import Law

RATE_HZ = 25.0
LOW_M = 0.8
SETTLE_S = 2.0  # before the first piece


@dataclass(frozen=True)
class Manoeuvre:
    """To a place and heading (None: stays) within `seconds`; with `cycles`, there and back so often."""

    what: str
    seconds: float
    height_m: float | None = None
    north_m: float | None = None
    east_m: float | None = None
    yaw_deg: float | None = None
    cycles: int = 0

    def table(self) -> dict[str, Any]:
        """As a table of a plan file."""
        out: dict[str, Any] = {"what": self.what, "seconds": self.seconds}
        for name in ("height_m", "north_m", "east_m", "yaw_deg"):
            value = getattr(self, name)
            if value is not None:
                out[name] = round(float(value), 3)
        return out | ({"cycles": self.cycles} if self.cycles else {})


def flight_experiment(frame: FlightFrame, sigma: Array, rivals: Sequence[Rival]) -> Experiment | None:
    """The manoeuvres that separate rivals best; None where no flight within reach does.

    `sigma` (6,) is the noise of one judged row.
    """
    high = float(np.median(frame.height[frame.keep])) if frame.height is not None else 3.0
    high = max(high, 2.5)

    known: dict[Any, View | None] = {}

    def look_at(piece: Any) -> View | None:
        try:
            planned = flight_frame([flown(frame, [piece], high)], frame.airframe, frame.model)
        except (CoaxlinkError, NotShown):
            return None  # the model cannot fly it
        nuisance = list(flight_corrections(planned))
        columns = np.stack([reduce_columns(planned, c.columns) for c in nuisance], axis=-1)
        bounds = np.array([c.bound for c in nuisance])
        try:
            return view(planned, rivals, columns, bounds, lambda values: reduce_columns(planned, values))
        except NotShown:
            return None  # a hover shows no inflow of a climb

    def look(pieces: Sequence[Any]) -> View | None:
        # a manoeuvre is the same wherever it comes in a flight, but for the battery: that is left out
        for piece in pieces:
            if piece not in known:
                known[piece] = look_at(piece)
        views = [v for p in pieces if (v := known[p]) is not None]
        return joined(views) if len(views) == len(pieces) else None

    moves = _moves(high, frame.height is not None)
    found = separated(rivals, moves, look, sigma, FLIGHT_CHANNELS, kind="flight")
    return None if found is None else replace(found, height_m=high)


def _moves(high: float, low_too: bool) -> list[tuple[Any, ...]]:
    out: list[tuple[Any, ...]] = [
        (Manoeuvre(f"hover at {high:.1f} m", 14.0),),
        (Manoeuvre("fast to and fro, north", 12.0, north_m=3.0, cycles=3),),
        (Manoeuvre("fast to and fro, east", 12.0, east_m=3.0, cycles=3),),
        (Manoeuvre("climb and sink", 12.0, height_m=high + 2.5, cycles=3),),
        (Manoeuvre("short jolts, north", 10.0, north_m=0.4, cycles=7),),
        (Manoeuvre("short jolts, east", 10.0, east_m=0.4, cycles=7),),
        (Manoeuvre("turn to and fro", 12.0, yaw_deg=150.0, cycles=2),),
    ]
    if low_too:
        out.append((Manoeuvre(f"low passes, {LOW_M} m", 24.0, height_m=LOW_M, cycles=3),))
    return out


def path(pieces: Sequence[Manoeuvre], high: float) -> tuple[Array, Array]:
    """(rows,) times and (rows, 4) north, east, height, heading in radians."""
    place = np.array([0.0, 0.0, high, 0.0])
    rows = [np.repeat(place[None], round(SETTLE_S * RATE_HZ), axis=0)]
    for piece in pieces:
        wanted = [piece.north_m, piece.east_m, piece.height_m]
        wanted += [None if piece.yaw_deg is None else float(np.radians(piece.yaw_deg))]
        there = np.array([p if w is None else w for p, w in zip(place, wanted, strict=True)])
        share = np.arange(1, round(piece.seconds * RATE_HZ) + 1) / round(piece.seconds * RATE_HZ)
        if piece.cycles:
            eased = 0.5 * (1.0 - np.cos(2.0 * np.pi * piece.cycles * share))
            rows.append(place + (there - place) * eased[:, None])
        else:
            eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            rows.append(place + (there - place) * eased[:, None])
            place = there
    whole = np.concatenate(rows)
    return np.arange(len(whole)) / RATE_HZ, whole


def flown(frame: FlightFrame, pieces: Sequence[Manoeuvre], high: float, law: Law | None = None) -> Samples:
    """The log that a plan would give on the nuisance, without noise; by default flown with Algorithm 1."""
    from coaxlink.mixer import make_law
    from coaxlink.vehicle import Vehicle

    t, whole = path(pieces, high)
    north, east, height, yaw = whole.T
    spot = np.stack([north, east, -height], axis=1)
    velocity = np.gradient(spot, t, axis=0)
    force = np.gradient(velocity, t, axis=0) - GRAVITY_NED  # specific, NED
    size = np.linalg.norm(force, axis=1)
    up = force / size[:, None]
    # heading first, then the tilt that points the thrust: z of the body is -up
    cy, sy = np.cos(yaw), np.sin(yaw)
    ahead, right = -(up[:, 0] * cy + up[:, 1] * sy), -(up[:, 1] * cy - up[:, 0] * sy)
    roll, pitch = -np.arcsin(np.clip(right, -1.0, 1.0)), np.arctan2(ahead, -up[:, 2])
    rates = _rates(roll, pitch, yaw, t)
    turning = np.gradient(rates, t, axis=0)
    inertia = np.asarray(frame.airframe.inertia_kg_m2)
    moment = inertia * turning + np.cross(rates, inertia * rates)
    wrench = np.concatenate([(frame.airframe.mass_kg * size)[:, None], moment], axis=1)
    if law is None:
        law = make_law("coaxial", Vehicle(frame.airframe, replace(frame.model, effects=())))
    speeds = np.array([law.speeds(w) for w in wrench])
    commands = np.clip(frame.airframe.commanded(frame.model, speeds), 0.0, 1.0)
    columns = {"time_s": t, "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}
    zero = np.zeros_like(t)
    for k, axis in enumerate("xyz"):
        columns[f"accel_{axis}_m_s2"] = -size if axis == "z" else zero
        columns[f"gyro_{axis}_rad_s"] = rates[:, k]
        columns[f"vel_{'ned'[k]}_m_s"] = velocity[:, k]
    for k, rotor in enumerate(frame.airframe.rotors):
        columns[f"motor{rotor.number}"] = commands[:, k]
    if frame.height is not None:
        columns["height_m"] = height
    if frame.voltage is not None:
        columns["voltage_V"] = _sagging(frame, t)
    return Samples(columns, "planned")


def _rates(roll: Array, pitch: Array, yaw: Array, t: Array) -> Array:
    """(rows, 3) body rates of angles."""
    dr, dp, dy = (np.gradient(a, t) for a in (roll, pitch, np.unwrap(yaw)))
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    return np.stack([dr - dy * sp, dp * cr + dy * sr * cp, -dp * sr + dy * cr * cp], axis=1)


def _sagging(frame: FlightFrame, t: Array) -> Array:
    """(rows,) voltage that falls as it fell in the log."""
    assert frame.voltage is not None
    volts, time = frame.voltage[frame.keep], frame.time_s[frame.keep]
    slope = float(np.polyfit(time - time[0], volts, 1)[0]) if np.ptp(time) > 1.0 else 0.0
    return np.asarray(float(np.quantile(volts, 0.9)) + min(slope, 0.0) * t)
