"""What a foreign stand log loses before it is used: dead sensors, rows at rest, the signs of its stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coaxlink.data.samples import Samples

APART = 0.03  # of a squared speed that the other does not explain: less, and they are one


def cleaned(samples: Samples) -> Samples:
    """Without dead speed sensors and rows at rest, thrusts and torques positive."""
    return positive(turning(without_dead_sensors(samples)))


def without_dead_sensors(samples: Samples) -> Samples:
    """Without a speed column that reads zero while its rotor is driven: no sensor was connected."""
    for side in ("upper", "lower"):
        rpm, throttle = f"{side}_rpm", f"{side}_throttle"
        if samples.has(rpm, throttle) and not np.any(samples[rpm]) and np.any(samples[throttle] > 0):
            left = {name: column for name, column in samples.columns.items() if name != rpm}
            note = f"{rpm} left out: zero throughout while the motor is driven, no speed sensor"
            samples = replace(samples, columns=left).with_notes(note)
    return samples


def turning(samples: Samples) -> Samples:
    """Without the rows in which no commanded rotor turns; the load cells' mean there goes into the notes."""
    on_the_move = np.zeros(samples.rows, bool)
    known = False
    for side in ("upper", "lower"):
        on = np.ones(samples.rows, bool)
        for name in (f"{side}_rpm", f"{side}_throttle"):
            if samples.has(name):
                known = True
                on &= samples[name] > 0
        if samples.has(f"{side}_rpm") or samples.has(f"{side}_throttle"):
            on_the_move |= on
    if not known or on_the_move.all():
        return samples
    idle = samples.take(~on_the_move)
    idle_rows = [idle.place(i) for i in range(idle.rows)]
    shown = ", ".join(idle_rows[:6]) + (f" and {len(idle_rows) - 6} more" if len(idle_rows) > 6 else "")
    read = ", ".join(
        f"{name} {np.median(idle[name]):.3g}"
        for name in idle.columns
        if name.endswith(("thrust_N", "torque_Nm"))
    )
    note = f"{idle.rows} of {samples.rows} rows dropped, motors off ({shown}); they read {read}"
    return samples.take(on_the_move).with_notes(note)


def positive(samples: Samples) -> Samples:
    """Thrusts and torques positive while their rotor works: stands differ in the sign they give."""
    for side in ("upper", "lower"):
        effort = next((f"{side}_{w}" for w in ("rpm", "throttle") if samples.has(f"{side}_{w}")), None)
        for name in (f"{side}_thrust_N", f"{side}_torque_Nm"):
            if effort is None or not samples.has(name) or own_sign(samples, name, effort) >= 0:
                continue
            samples = samples.with_columns(**{name: -samples[name]}).with_notes(f"sign of {name} turned")
    return samples


def own_sign(samples: Samples, load: str, effort: str) -> float:
    """Sign with which a load goes with its own rotor's speed, the share of the other's wake taken off."""
    own = samples[effort] ** 2
    y = samples[load]
    turned = {"upper": "lower", "lower": "upper"}
    side, _, what = effort.partition("_")
    other = f"{turned[side]}_{what}"
    if samples.has(other):
        v = samples[other] ** 2
        free = own - v * (own @ v) / max(float(v @ v), 1e-300)
        if free @ free > APART * (own @ own):
            return float(np.sign(free @ y))
    return float(np.sign(own @ y))
