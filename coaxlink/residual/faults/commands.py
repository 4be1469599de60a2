"""What the commands of a log tell of one another, and of the speeds: a mixer has four demands.

Of N commands N - 4 are told by the rest, and a speed by its own command. Where a column stands still to its
last digit and what the others make of it moves away, it is no reading there; a command that fits the others
only at another time is late. At a limit that commands reach in the air, and none goes beyond, a command may
well stand still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coaxlink.constants import SIGMA_PER_MAD
from coaxlink.data.resolution import resolution_of
from coaxlink.data.samples import Samples
from coaxlink.frames import Array
from coaxlink.residual.faults.kinematics import flying_rows, step_of
from coaxlink.residual.faults.repeats import held_runs, is_fine
from coaxlink.residual.faults.states import Mask, runs_of
from coaxlink.residual.faults.yardstick import SURE, nats_of

Finding = tuple[str, Mask, str]  # column, rows, why
# priors: name = value  # unit, source
DEMANDS = 4  # thrust and three torques
LEAST_ROWS = 100  # for the fifteen numbers of a fit, judgement
FIT_ROWS = 4000  # effort
STUCK_S = 0.5  # all commands at once: less is a packet that was lost
SHIFTS_S = np.linspace(-0.2, 0.2, 41)  # that are tried
LATE_S = 0.015  # three periods of an autopilot's outputs (200 Hz): its clocks and queues are apart by less
LIMITS = ("MOT_SPIN_MIN", "MOT_SPIN_MAX")  # of ArduPilot; PX4's outputs end where a command is 0 or 1
QUIET = 5.0  # usual pauses: a longer one is silence, as `data.logs.streams` has it of a gap
OUTLIER = 3.0  # standard deviations: less is noise
FEWEST = 1e-4  # of full command: what a mixer's own arithmetic leaves


def command_faults(log: Samples, rotors: Sequence[int]) -> Iterator[Finding]:
    """Commands and speeds of these rotors that stand still where they cannot, and commands that are late."""
    flying = flying_rows(log) & np.isfinite(log["time_s"])
    if flying.sum() < LEAST_ROWS:
        return
    names = [f"motor{n}" for n in rotors]
    commands = np.stack([log[name] for name in names], axis=1)
    flying &= np.isfinite(commands).all(axis=1)
    at_limit = np.isin(commands, list(_limits(log, commands, flying)))
    free = flying & ~at_limit.any(axis=1)  # a mixer at a limit serves other demands
    held = {n: _held_in_flight(log[n], flying & ~at_limit[:, k]) for k, n in enumerate(names)}
    steps = {name: log.resolution.get(name, resolution_of(log[name])) for name in names}
    found = dict[str, Mask]()
    for k, name in enumerate(names):
        for a, b in runs_of(held[name]):
            beside = [j for j, other in enumerate(names) if j != k and held[other][a:b].mean() < 0.5]
            if len(beside) < DEMANDS:  # all at once
                fine = is_fine(log[name], steps[name]) and b - a > STUCK_S / step_of(log)
                away = np.inf if fine else 0.0
            else:
                usable = free & ~held[name] & ~np.any([held[names[j]] for j in beside], axis=0)
                design = _design(commands[:, beside], usable)
                away = _away(commands[:, k], design, usable, slice(a, b), steps[name])
            if away > SURE:
                found.setdefault(name, np.zeros(log.rows, bool))[a:b] = True
    for name, rows in found.items():
        yield name, rows, "one command repeats exactly while the others move: it is no reading there"
    usable = free & ~np.any(list(held.values()), axis=0)
    yield from _late(log, names, commands, usable)
    for k, n in enumerate(rotors):
        if log.has(f"rpm{n}"):
            yield from _silent(log, f"rpm{n}", flying)
            yield from _speed_held(log, f"rpm{n}", commands[:, k], flying & ~held[names[k]])


def _held_in_flight(values: Array, flying: Mask) -> Mask:
    """(rows,) runs of one value that are no accident, in the air; rows without a value are passed over."""
    out = np.zeros(len(values), bool)
    known = np.flatnonzero(np.isfinite(values) & flying)
    for a, b in held_runs(values[known]) if len(known) else ():
        out[known[a] : known[b - 1] + 1] = True
    return out


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


def _design(others: Array, usable: Mask) -> Array:
    """(rows, K) what the demands behind some commands (rows, M) may do to another: to second order, since
    a command is no linear function of a thrust."""
    rows = np.flatnonzero(usable)
    rows = rows[:: max(1, len(rows) // FIT_ROWS)]
    middle = others[rows].mean(axis=0)
    _, size, axes = np.linalg.svd(others[rows] - middle, full_matrices=False)
    keep = size[:DEMANDS] > FEWEST * np.sqrt(len(rows))
    z = (others - middle) @ axes[:DEMANDS][keep].T / (size[:DEMANDS][keep] / np.sqrt(len(rows)))
    z = np.nan_to_num(z)
    first, second = np.triu_indices(z.shape[1])
    return np.concatenate([np.ones((len(z), 1)), z, z[:, first] * z[:, second]], axis=1)


def _away(values: Array, design: Array, usable: Mask, run: slice, step: float) -> float:
    """Nats against a run of a column, of this resolution, being what a fit to the other rows makes of it.

    None where that moves no further than a reading that stands still for its resolution may be off.
    """
    rows = np.flatnonzero(usable & np.isfinite(values))
    if len(rows) < LEAST_ROWS:
        return 0.0
    every = max(1, len(rows) // FIT_ROWS)
    rows = rows[::every]
    fit = np.linalg.lstsq(design[rows], values[rows], rcond=None)[0]
    rest = values[rows] - design[rows] @ fit
    sigma = max(SIGMA_PER_MAD * float(np.median(np.abs(rest))), FEWEST)
    due = design[run] @ fit
    if np.ptp(due) < step + 2.0 * OUTLIER * sigma:
        return 0.0
    inside = values[run] - due
    inside = inside[np.isfinite(inside)]
    usual = float(np.mean(nats_of(rest / sigma)))
    against = float(np.sum(nats_of(inside / sigma) - usual))
    return against * _independent(rest, every)


def _independent(rest: Array, every: int = 1) -> float:
    """How many independent rows one row counts as, of which each of so many is given."""
    x = rest - rest.mean()
    memory = float(np.clip(np.sum(x[1:] * x[:-1]) / max(float(np.sum(x**2)), 1e-30), 0.0, 0.99))
    memory **= 1.0 / every
    return (1.0 - memory) / (1.0 + memory)


def _silent(log: Samples, name: str, flying: Mask) -> Iterator[Finding]:
    """Where a speed that is told elsewhere is not: from QUIET of its usual pauses on."""
    told, rows = np.flatnonzero(np.isfinite(log[name])), np.flatnonzero(flying)
    if not len(told):
        return
    usual = float(np.median(np.diff(log["time_s"][told]))) if len(told) > 1 else 0.0
    longest = max(QUIET * usual, STUCK_S)
    ends = np.concatenate([[rows[0] - 1], told[flying[told]], [rows[-1] + 1]])
    inside = np.clip(ends, 0, log.rows - 1)
    out = np.zeros(log.rows, bool)
    for k in np.flatnonzero(np.diff(log["time_s"][inside]) > longest):
        out[ends[k] + 1 : ends[k + 1]] = True
    out &= flying
    if out.any():
        yield name, out, "no speed is told while its motor is commanded: the ESC is silent"


def _speed_held(log: Samples, name: str, command: Array, usable: Mask) -> Iterator[Finding]:
    """Where a speed stands still and its command moves."""
    speed = log[name]
    held = _held_in_flight(speed, usable)
    design = np.stack([np.ones_like(command), command, command**2], axis=1)
    rows = np.zeros(log.rows, bool)
    most, step = float(np.nanmax(np.abs(speed), initial=1.0)), log.resolution.get(name, resolution_of(speed))
    for a, b in runs_of(held):
        known = usable & ~held
        if np.sum(known & np.isfinite(speed)) < LEAST_ROWS:  # it never moves
            rows[a:b] |= np.ptp(command[a:b]) > 0.0
        elif _away(speed / most, design, known, slice(a, b), step / most) > SURE:
            rows[a:b] = True
    if rows.any():
        why = "one speed repeats exactly while its command moves: the ESC is silent"
        yield name, rows, why


def _late(log: Samples, names: Sequence[str], commands: Array, usable: Mask) -> Iterator[Finding]:
    """A command that fits the others at another time: the one that then fits best, anew until none does."""
    if commands.shape[1] <= DEMANDS or usable.sum() < LEAST_ROWS:
        return
    time = log["time_s"]
    rows = np.flatnonzero(usable)
    rows = rows[(time[rows] > time[rows[0]] + SHIFTS_S[-1]) & (time[rows] < time[rows[-1]] + SHIFTS_S[0])]
    rows = rows[:: max(1, len(rows) // FIT_ROWS)]
    if len(rows) < LEAST_ROWS:
        return
    best, late, gain = "", 0.0, 0.0
    known = np.flatnonzero(np.isfinite(commands).all(axis=1))
    none = int(np.argmin(np.abs(SHIFTS_S)))
    for k, name in enumerate(names):
        design = _design(np.delete(commands, k, axis=1), usable)[rows]
        moved = np.stack(
            [np.interp(time[rows] + s, time[known], commands[known, k]) for s in SHIFTS_S], axis=1
        )
        rest = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
        left = np.mean(rest**2, axis=0) + FEWEST**2
        at = int(np.argmin(left))
        nats = 0.5 * len(rows) * _independent(rest[:, none]) * float(np.log(left[none] / left[at]))
        if abs(SHIFTS_S[at]) > LATE_S and nats > max(gain, SURE) and left[at] < 0.5 * left[none]:
            best, late, gain = name, float(SHIFTS_S[at]), nats
    if best:
        way = "late" if late > 0.0 else "early"
        why = f"it fits the other commands {1000.0 * abs(late):.0f} ms {way}: this column's stamps are off"
        yield best, np.ones(log.rows, bool), why
