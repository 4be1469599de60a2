"""What the commands of a log tell of one another, and of the speeds: a mixer has four demands.

Of N commands N - 4 follow from the rest, and a speed from its own command. Where a column stands still to its
last digit and what the others make of it moves away, it is no reading there; a command that fits the others
only at another time is late. At a limit that commands reach in the air, and none goes beyond, a command may
well stand still.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
SHIFTS_S = np.linspace(-0.3, 0.3, 61)  # that are tried
LATE_S = 0.015  # three periods of an autopilot's outputs (200 Hz): its clocks and queues are apart by less
LIMITS = ("MOT_SPIN_MIN", "MOT_SPIN_MAX")  # of ArduPilot; PX4's outputs end where a command is 0 or 1
QUIET = 5.0  # usual pauses: a longer one is silence, as `data.logs.streams` has it of a gap
OUTLIER = 3.0  # standard deviations: less is noise
SLIGHT = (
    0.01  # of a command: the thrust of two propellers of one mould differs by twice that (Brandt and Selig)
)
USUAL = 0.2  # of the usual command, judgement
HALF = 0.5  # of what the others do not explain: so much has to be gone, judgement
MOMENTS, PARTS = 40, 8  # effort
# times the steps of the others, and of full command: 2 us of PWM's 1000, as autopilots round; judgement
COARSER, COARSE_STEP = 4.0, 2e-3
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
    if free_rows := _Free.of(log, names, commands, usable):
        yield from (
            list(_coarse(log, names, commands, usable))
            or [*_late_somewhere(log, free_rows), *_changed(log, free_rows)][:1]
        )
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
    """Where a speed that is logged elsewhere is not: from QUIET of its usual pauses on."""
    known, rows = np.flatnonzero(np.isfinite(log[name])), np.flatnonzero(flying)
    if not len(known):
        return
    usual = float(np.median(np.diff(log["time_s"][known]))) if len(known) > 1 else 0.0
    longest = max(QUIET * usual, STUCK_S)
    ends = np.concatenate([[rows[0] - 1], known[flying[known]], [rows[-1] + 1]])
    inside = np.clip(ends, 0, log.rows - 1)
    out = np.zeros(log.rows, bool)
    for k in np.flatnonzero(np.diff(log["time_s"][inside]) > longest):
        out[ends[k] + 1 : ends[k + 1]] = True
    out &= flying
    if out.any():
        yield name, out, "no speed is logged while its motor is commanded: the ESC is silent"


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


@dataclass(frozen=True)
class _Free:
    """Commands (rows, N) at rows free of limits and held columns, and each one's regressors (rows, K)."""

    names: Sequence[str]
    time: Array
    commands: Array
    rows: NDArray[np.intp]
    designs: list[Array]

    @classmethod
    def of(cls, log: Samples, names: Sequence[str], commands: Array, usable: Mask) -> _Free | None:
        rows, reach = np.flatnonzero(usable), SHIFTS_S[-1]
        if commands.shape[1] <= DEMANDS or not len(rows):
            return None
        time = log["time_s"]
        rows = rows[(time[rows] > time[rows[0]] + reach) & (time[rows] < time[rows[-1]] - reach)]
        rows = rows[:: max(1, len(rows) // FIT_ROWS)]
        if len(rows) < LEAST_ROWS:
            return None
        designs = [_design(np.delete(commands, k, axis=1), usable)[rows] for k in range(len(names))]
        return cls(names, time, commands, rows, designs)

    def likeliest(self, ways: Callable[[int], tuple[Array, Array]]) -> tuple[str, int] | None:
        """The column and the way that leave least unexplained by the others, if that is sure: `ways`
        give of a column what it leaves as it is (rows,), and (ways,) the mean squares that each leaves."""
        best, most = None, 0.0
        for k, name in enumerate(self.names):
            rest, left = ways(k)
            usual = float(np.mean(rest**2)) + FEWEST**2
            at = int(np.argmin(left))
            now = float(left[at]) + FEWEST**2
            nats = 0.5 * len(rest) * _independent(rest) * float(np.log(usual / now)) - np.log(len(left))
            # what one column is off by, fits to the others have in part
            if nats > SURE and now < HALF * usual and usual - now > most:
                best, most = (name, at), usual - now
        return best


def _rest(values: Array, design: Array) -> Array:
    """(rows, M) what a fit leaves of columns."""
    return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])


def _late_somewhere(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that is late in all of a log, or in its first or second half."""
    count = len(free.rows)
    for part in (slice(None), slice(0, count // 2), slice(count // 2, count)):
        if count // 2 < LEAST_ROWS and part != slice(None):
            return
        some = replace(free, rows=free.rows[part], designs=[d[part] for d in free.designs])
        if found := list(_late(log, some)):
            yield found[0]
            return


def _late(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that fits the others at another time."""
    known = np.flatnonzero(np.isfinite(free.commands).all(axis=1))
    none = int(np.argmin(np.abs(SHIFTS_S)))
    early = free.time[free.rows][:, None] + SHIFTS_S

    def ways(k: int) -> tuple[Array, Array]:
        moved = np.interp(early, free.time[known], free.commands[known, k])
        rest = _rest(moved, free.designs[k])
        return rest[:, none], np.mean(rest**2, axis=0)

    best = free.likeliest(ways)
    if best and abs(SHIFTS_S[best[1]]) > LATE_S:
        late = float(SHIFTS_S[best[1]])
        way = "late" if late > 0.0 else "early"
        why = f"it fits the other commands {1000.0 * abs(late):.0f} ms {way}: this column's stamps are off"
        yield best[0], np.ones(log.rows, bool), why


def _changed(log: Samples, free: _Free) -> Iterator[Finding]:
    """A command that from some moment on has another zero or scale against the others."""
    total = free.commands[free.rows].sum(axis=1)
    usual = (
        np.abs(total / np.median(total) - 1.0) < USUAL
    )  # a mixer's curve is another near the ground's idle
    free = replace(free, rows=free.rows[usual], designs=[d[usual] for d in free.designs])
    time = free.time[free.rows]
    if len(time) < LEAST_ROWS:
        return
    moments = np.quantile(time, np.linspace(0.1, 0.9, MOMENTS))
    after = (time[:, None] >= moments).astype(float)

    def ways(k: int) -> tuple[Array, Array]:
        own = free.commands[free.rows, k]
        both = np.concatenate([own[:, None], after, after * (own - own.mean())[:, None]], axis=1)
        rest, x, z = np.split(_rest(both, free.designs[k]), [1, 1 + MOMENTS], axis=1)
        # least squares on two columns each, in closed form
        xx, zz, xz = (np.sum(a * b, axis=0) for a, b in ((x, x), (z, z), (x, z)))
        xy, zy = rest[:, 0] @ x, rest[:, 0] @ z
        gain = (xy**2 * zz - 2.0 * xy * zy * xz + zy**2 * xx) / np.maximum(xx * zz - xz**2, 1e-30)
        fewer = np.minimum(after.sum(axis=0), len(time) - after.sum(axis=0))
        gain[(gain < fewer * (SLIGHT * own.mean()) ** 2) | ~_sharp(rest[:, 0], time, moments)] = 0.0
        return rest[:, 0], np.maximum(np.mean(rest**2) - gain / len(time), 0.0)

    if best := free.likeliest(ways):
        why = f"at {moments[best[1]]:.1f} s its zero or scale changes against the other commands"
        yield best[0], np.ones(log.rows, bool), why


def _sharp(rest: Array, time: Array, moments: Array) -> Mask:
    """(moments,) near which a remainder (rows,) jumps within a second, and stays for three, by more than it
    is usually off by: a take-off, a hard turn, a pack that empties change it slowly or for a moment."""
    total, at = np.concatenate([[0.0], np.cumsum(rest)]), np.arange(len(time))
    jump = np.full(len(time), np.inf)
    for seconds in (1.0, 3.0):
        first, last = (np.searchsorted(time, time + d) for d in (-seconds, seconds))
        after = (total[last] - total[at]) / np.maximum(last - at, 1)
        before = (total[at] - total[first]) / np.maximum(at - first, 1)
        jump = np.minimum(jump, np.abs(after - before))
    near = 0.75 * float(np.max(np.diff(moments), initial=1.0))
    most = [jump[np.abs(time - m) <= near].max(initial=0.0) for m in moments]
    return np.asarray(np.array(most) > np.std(rest))


def _coarse(log: Samples, names: Sequence[str], commands: Array, flying: Mask) -> Iterator[Finding]:
    """A command that moves in far larger steps than the others, in some part of the flight."""
    for rows in np.array_split(np.flatnonzero(flying), PARTS):
        steps = np.array([resolution_of(commands[rows, k]) for k in range(len(names))])
        if len(rows) < LEAST_ROWS or not np.isfinite(steps).all():
            continue
        k = int(np.argmax(steps))
        others = float(np.max(np.delete(steps, k)))
        if steps[k] > max(COARSER * others, COARSE_STEP):
            why = f"it moves in steps of {steps[k]:.2g}, the other commands in {others:.1g}: rounded"
            yield names[k], np.ones(log.rows, bool), why
            return
