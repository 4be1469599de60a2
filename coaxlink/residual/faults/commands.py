"""What the commands of a log tell of one another, and of the speeds: a mixer has four demands.

Of N commands N - 4 follow from the rest, and a speed from its own command. Where a column stands still to its
last digit and what the others make of it moves away, it is no reading there (here, and `silent_speeds`); a
command that goes with the others only at another time, zero or scale is off (`commands_apart`). At a limit
that commands reach in the air, and none goes beyond, a command may well stand still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.faults.apart import COARSE_STEP
from coaxlink.residual.faults.commands_apart import commands_apart
from coaxlink.residual.faults.kinematics import flying_rows, step_of
from coaxlink.residual.faults.mixer_demands import (
    DEMANDS,
    LEAST_ROWS,
    away,
    design_of,
    held_in_flight,
    is_no_reading,
    rows_of,
)
from coaxlink.residual.faults.repeats import is_fine
from coaxlink.residual.faults.silent_speeds import STUCK_S, speed_faults
from coaxlink.residual.faults.speeds_apart import speeds_apart
from coaxlink.residual.faults.states import Finding, Mask, runs_of

LIMITS = ("MOT_SPIN_MIN", "MOT_SPIN_MAX")  # of ArduPilot; PX4's outputs end where a command is 0 or 1


def command_faults(log: Samples, rotors: Sequence[int]) -> Iterator[Finding]:
    """Commands and speeds of these rotors that stand still where they cannot, and commands that are late."""
    flying = flying_rows(log) & np.isfinite(log["time_s"])
    if flying.sum() < LEAST_ROWS:
        return
    names = [f"motor{n}" for n in rotors]
    commands = np.stack([log[name] for name in names], axis=1)
    flying &= np.isfinite(commands).all(axis=1)
    at_limit = np.isin(commands, list(_limits(log, commands, flying)))
    limited = np.asarray(at_limit.any(axis=1))  # a mixer at a limit serves other demands
    free = flying & ~limited
    runs = {n: held_in_flight(log[n], flying & ~at_limit[:, k]) for k, n in enumerate(names)}
    held = {n: rows_of(of, log.rows) for n, of in runs.items()}
    steps = {name: log.resolution.get(name, resolution_of(log[name])) for name in names}
    found = dict[str, Mask]()
    for k, name in enumerate(names):
        for run in runs[name]:
            a, b, _ = run
            beside = [j for j, other in enumerate(names) if j != k and held[other][a:b].mean() < 0.5]
            usable = free & ~held[name] & ~np.any([held[names[j]] for j in beside], axis=0)
            if len(beside) < DEMANDS:  # all at once
                fine = is_fine(log[name], steps[name]) and b - a > STUCK_S / step_of(log)
                against = np.inf if fine else 0.0
            elif usable.sum() < LEAST_ROWS:  # it never moves
                against = np.inf if np.ptp(commands[a:b, beside], axis=0).min() > COARSE_STEP else 0.0
            else:
                design = design_of(commands[:, beside], usable)
                against = away(commands[:, k], design, usable, a + np.flatnonzero(~limited[a:b]), steps[name])
            if is_no_reading(against, run):
                found.setdefault(name, np.zeros(log.rows, bool))[a:b] = True
    for name, rows in found.items():
        yield name, rows, "one command repeats exactly while the others move: it is no reading there"
    usable = free & ~np.any(list(held.values()), axis=0)
    apart = list(commands_apart(log, names, commands, usable))
    yield from apart
    for k, n in enumerate(rotors):
        if log.has(f"rpm{n}"):
            yield from speed_faults(log, f"rpm{n}", commands[:, k], flying, flying & ~held[names[k]])
    sound = [k for k, name in enumerate(names) if name not in {column for column, *_ in apart}]
    usable = flying & ~np.any(list(held.values()), axis=0)
    yield from speeds_apart(log, [rotors[k] for k in sound], commands[:, sound], usable)


def _limits(log: Samples, commands: Array, flying: Mask) -> set[float]:
    """Commands (rows, N) beyond which none goes in the air, reached more than once, and what the autopilot is
    set to: of ArduPilot within a step of what is logged."""
    given = commands[flying]
    ends = {0.0, 1.0}
    for end in (float(given.min()), float(given.max())):
        reached = (commands == end) & flying[:, None]
        if sum(len(runs_of(column)) for column in reached.T) > 1:
            ends.add(end)
    set_to = [float(v) for n in LIMITS if (v := log.parameters.get(n)) is not None]
    if set_to:
        step, values = resolution_of(given), np.unique(given)
        ends |= {float(x) for v in set_to for x in values[np.abs(values - v) <= step]}
    return ends
