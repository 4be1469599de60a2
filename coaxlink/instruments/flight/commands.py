"""What the commands of a log tell of one another: a mixer has four demands, which move all of them.

Of N commands N - 4 follow from the rest. Where a column stands still to its last digit and what the others
make of it moves away, it is no reading there; one that goes with the others only at another time, zero or
scale is off (`apart`). At a limit that commands reach in the air, and none goes beyond, a command may well
stand still. And motors that work as these do, of no rotor of the airframe, are another vehicle's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from coaxlink.data.logs.flight import MOTOR
from coaxlink.data.resolution import resolution_of
from coaxlink.frames import Array
from coaxlink.instruments.findings import Finding, Mask, runs_of
from coaxlink.instruments.flight.apart import COARSE_STEP, HALF, PERIOD_S, Columns, rounded
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.still import (
    FEWEST,
    FIT_ROWS,
    LEAST_ROWS,
    STUCK_S,
    Held,
    away,
    held_in_flight,
    is_no_reading,
    rows_of,
)
from coaxlink.instruments.repeats import is_fine

# priors: name = value  # unit, source
LIMITS = ("MOT_SPIN_MIN", "MOT_SPIN_MAX")  # of ArduPilot; PX4's outputs end where a command is 0 or 1
DEMANDS = 4  # thrust and three torques
USUAL = 0.2  # of the usual command, judgement
WORKS = 0.5  # of the least mean command of the rotors, and of their rise: judgement; unused outputs rest
LINEAR, STEP = 0.5, 1e-3  # of a command's variance: judgement; 1 us of PWM's 1000


@dataclass(frozen=True)
class Commands:
    """The commands of a log in the air, and where one of them stands still."""

    log: FlownLog
    values: Array  # (rows, N)
    flying: Mask  # (rows,) with every command
    limited: Mask  # (rows,) with a command at a limit: a mixer serves other demands there
    runs: Mapping[str, list[Held]]  # of each that stands still

    @classmethod
    def of(cls, log: FlownLog) -> Commands | None:
        """None where there is too little flight."""
        flying = log.flying & np.isfinite(log["time_s"])
        if flying.sum() < LEAST_ROWS:
            return None
        values = log.commands
        flying &= np.isfinite(values).all(axis=1)
        at_limit = np.isin(values, list(_limits(log, values, flying)))
        runs = {n: held_in_flight(log[n], flying & ~at_limit[:, k]) for k, n in enumerate(log.motors)}
        return cls(log, values, flying, np.asarray(at_limit.any(axis=1)), runs)

    @cached_property
    def held(self) -> Mask:
        """(rows, N) where each stands still."""
        return np.stack([rows_of(self.runs[n], self.log.rows) for n in self.log.motors], axis=1)

    def stuck(self) -> Iterator[Finding]:
        """Those that stand still where they cannot."""
        for k, name in enumerate(self.log.motors):
            found = np.zeros(self.log.rows, bool)
            for run in self.runs[name]:
                found[run[0] : run[1]] |= is_no_reading(self._against(k, run), run)
            if found.any():
                yield name, found, "one command repeats exactly while the others move: it is no reading there"

    def _against(self, k: int, run: Held) -> float:
        """Nats against a run of one command being what the others make of it."""
        log, (a, b, _), name = self.log, run, self.log.motors[k]
        beside = [j for j in range(len(log.motors)) if j != k and self.held[a:b, j].mean() < 0.5]
        usable = self.flying & ~self.limited & ~self.held[:, [k, *beside]].any(axis=1)
        if len(beside) < DEMANDS:  # all at once
            return np.inf if is_fine(log[name], log.steps[name]) and b - a > STUCK_S / log.step_s else 0.0
        if usable.sum() < LEAST_ROWS:  # it never moves
            return np.inf if np.ptp(self.values[a:b, beside], axis=0).min() > COARSE_STEP else 0.0
        at = a + np.flatnonzero(~self.limited[a:b])
        return away(log[name], design_of(self.values[:, beside], usable), usable, at, log.steps[name])

    def apart(self) -> Iterator[Finding]:
        """The one that goes apart from what the others make of it, at rows free of limits."""
        log, names = self.log, self.log.motors
        usable = self.flying & ~self.limited & ~self.held.any(axis=1)
        free = Columns.at(names, log["time_s"], self.values, usable)
        if free is None or len(names) <= DEMANDS:
            return
        every = np.ones(log.rows, bool)
        if coarse := rounded(names, self.values, usable):
            name, step, others = coarse
            why = f"it moves in steps of {step:.2g}, the other commands in {others:.1g}: rounded"
            yield name, every, why
            return
        for some in free.halves():
            if late := self._late(some, usable):
                ms, way = 1000.0 * abs(late[1]), "late" if late[1] > 0.0 else "early"
                why = f"it fits the other commands {ms:.0f} ms {way}: this column's stamps are off"
                yield late[0], every, why
                return
        free = self._beside(free, names, usable)
        total = self.values[free.rows].sum(axis=1)  # a mixer's curve is another near the ground's idle
        free = free.take(np.abs(total / np.median(total) - 1.0) < USUAL)
        changed = free.changed() if len(free.rows) >= LEAST_ROWS else None
        if changed and self._goes_with(changed[0], free, usable):
            why = f"at {changed[1]:.1f} s its zero or scale changes against the other commands"
            yield changed[0], every, why

    def _beside(self, free: Columns, names: Sequence[str], usable: Mask) -> Columns:
        """These columns of them, each with what the others of these make of it."""
        values = self.values[:, [self.log.motors.index(n) for n in names]]
        designs = [design_of(np.delete(values, k, axis=1), usable)[free.rows] for k in range(len(names))]
        return replace(free, names=names, values=values, designs=designs)

    def _goes_with(self, suspect: str, every: Columns, usable: Mask) -> bool:
        """Whether half of what this one is off by is more than any is off by without it.

        Else no column is off: a mixer that has more than its demands (a wake that is led), or is another one
        from some moment on (a table that is uploaded between two flights), moves them all.
        """
        rest = self._beside(every, [n for n in every.names if n != suspect], usable)
        return max(rest.off_by()) < HALF * every.off_by()[every.names.index(suspect)]

    def _late(self, free: Columns, usable: Mask) -> tuple[str, float] | None:
        """The one that fits the rest at another time, and by how much it comes later, s: by more than half
        a row, which is as near as rows tell.

        What they are off by goes with it; or it is the worst, and the rest fit one another at their own time,
        but for as few as can be distinguished from the others.
        """
        names = list(free.names)
        every = self._beside(free, names, usable)
        late = every.late()
        if late is None or abs(late[1]) <= PERIOD_S + 0.5 * self.log.step_s:
            return None
        if self._goes_with(late[0], every, usable):
            return late
        off_by, odd = every.off_by(), late
        if off_by[names.index(late[0])] < max(off_by):
            return None
        for _ in range((len(names) - DEMANDS) // 2):
            names.remove(odd[0])
            if (more := self._beside(free, names, usable).late(gone=0.0)) is None:
                return late
            odd = more
        return None


def _limits(log: FlownLog, commands: Array, flying: Mask) -> set[float]:
    """Commands (rows, N) beyond which none goes in the air, reached more than once, and what the autopilot is
    set to: of ArduPilot within a step of what is logged."""
    given = commands[flying]
    ends = {0.0, 1.0}
    for end in (float(given.min()), float(given.max())):
        reached = (commands == end) & flying[:, None]
        if sum(len(runs_of(column)) for column in reached.T) > 1:
            ends.add(end)
    set_to = [float(v) for n in LIMITS if (v := log.samples.parameters.get(n)) is not None]
    if set_to:
        step, values = resolution_of(given), np.unique(given)
        ends |= {float(x) for v in set_to for x in values[np.abs(values - v) <= step]}
    return ends


def design_of(others: Array, usable: Mask) -> Array:
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


def motors_too_many(log: FlownLog) -> list[Finding]:
    """Motors that work as the others do, of other numbers than the airframe's rotors."""
    numbers = sorted(int(found[1]) for n in log.samples.columns if (found := MOTOR.fullmatch(n)))
    commands = {n: np.clip(np.nan_to_num(log[f"motor{n}"][log.flying]), 0.0, 1.0) for n in numbers}
    known = [commands[n] for n in numbers if n in log.rotors]
    least = min((float(u.sum()) for u in known), default=0.0)
    more = [
        n
        for n in numbers
        if n not in log.rotors
        and float(commands[n].sum()) > WORKS * least > 0.0
        and _mixed(commands[n], known)
    ]
    if not more:
        return []
    names = ", ".join(f"motor{n}" for n in more)
    have = len(log.rotors)
    why = f"the airframe has {have} rotors, and these work as theirs do: it is another vehicle's file"
    return [(names, np.ones(log.rows, bool), why)]


def _mixed(command: Array, known: list[Array]) -> bool:
    """Whether a command (rows,) is of the same mixer: linear in the known motors', and rises where all do.

    Four demands move them all, and thrust moves all alike. A gripper or a landing gear rests where it was
    put; a gimbal goes along with tilt, and not with thrust.
    """
    free = len(command) - len(known) - 1
    spread = float(np.var(command))
    if free <= 0 or spread <= STEP**2:
        return False
    columns = np.stack([np.ones(len(command)), *known], axis=1)
    slopes = np.linalg.lstsq(columns, command, rcond=None)[0]
    left = command - columns @ slopes
    return float(left @ left) < (1.0 - LINEAR) * free * spread and float(slopes[1:].sum()) > WORKS
