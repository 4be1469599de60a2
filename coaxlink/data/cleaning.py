"""What a foreign stand log loses before it is used: dead sensors, rows at rest, the signs of its stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.data.aliases import SIDES
from coaxlink.data.samples import Samples
from coaxlink.data.tare import without_tares
from coaxlink.data.wake import APART


def drive_of(samples: Samples, side: str) -> str | None:
    """The column that says how fast a rotor turns: its rpm, else its throttle."""
    return next((f"{side}_{w}" for w in ("rpm", "throttle") if samples.has(f"{side}_{w}")), None)


def cleaned(samples: Samples) -> Samples:
    """Without dead speed sensors, tares and rows at rest, thrusts and torques positive."""
    return positive(_turning(without_tares(_without_dead_sensors(samples))))


def _without_dead_sensors(samples: Samples) -> Samples:
    """Without a speed column that reads zero while its rotor is driven: no sensor was connected."""
    for side in SIDES:
        rpm, throttle = f"{side}_rpm", f"{side}_throttle"
        if samples.has(rpm, throttle) and not np.any(samples[rpm]) and np.any(samples[throttle] > 0):
            note = f"{rpm} left out: zero throughout while the motor is driven, no speed sensor"
            samples = samples.without(rpm).with_notes(note)
    return samples


def _turning(samples: Samples) -> Samples:
    """Without the rows in which no commanded rotor turns; the load cells' mean there goes into the notes."""
    on_the_move = np.zeros(samples.rows, bool)
    known = False
    for side in SIDES:
        driven = [samples[n] > 0 for n in (f"{side}_rpm", f"{side}_throttle") if samples.has(n)]
        if driven:
            known = True
            on_the_move |= np.logical_and.reduce(driven)
    if not known or on_the_move.all():
        return samples
    idle = samples.take(~on_the_move)
    shown = ", ".join(idle.place(i) for i in range(min(idle.rows, 6)))
    more = f" and {idle.rows - 6} more" if idle.rows > 6 else ""
    loads = [name for name in idle.columns if name.endswith(("thrust_N", "torque_Nm"))]
    read = ", ".join(f"{name} {np.median(idle[name]):.3g}" for name in loads)
    note = f"{idle.rows} of {samples.rows} rows dropped, motors off ({shown}{more}); they read {read}"
    return samples.take(on_the_move).with_notes(note)


def positive(samples: Samples, loads: Sequence[str] = ("thrust_N", "torque_Nm")) -> Samples:
    """Thrusts and torques positive while their rotor works: stands differ in the sign they give."""
    for side in SIDES:
        effort = drive_of(samples, side)
        for name in (f"{side}_{load}" for load in loads):
            if effort is not None and samples.has(name) and own_sign(samples, name, effort) < 0:
                samples = samples.with_columns(**{name: -samples[name]})
                samples = samples.with_notes(f"sign of {name} turned")
    return samples


def own_sign(samples: Samples, load: str, effort: str) -> float:
    """Sign with which a load goes with its own rotor's speed, the share of the other's wake taken off."""
    own, y = samples[effort] ** 2, samples[load]
    side, _, what = effort.partition("_")
    other = f"{'lower' if side == 'upper' else 'upper'}_{what}"
    if samples.has(other):
        v = samples[other] ** 2
        free = own - v * (own @ v) / max(float(v @ v), 1e-300)
        if free @ free > APART * (own @ own):
            return float(np.sign(free @ y))
    return float(np.sign(own @ y))


def without_repeats(samples: Samples) -> Samples:
    """Without rows that say again all that the row before reported, its stamp too: a logger that hung."""
    if samples.rows < 2 or not samples.has("time_s"):
        return samples
    again = np.zeros(samples.rows, bool)
    again[1:] = np.logical_and.reduce([column[1:] == column[:-1] for column in samples.columns.values()])
    if not again.any():
        return samples
    return samples.take(~again).with_notes(f"{int(again.sum())} rows that repeat the row before left out")
