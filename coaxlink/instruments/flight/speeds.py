"""An ESC's speed against its own command, as the others go with theirs: silent, held, late, rounded, or
another rotor's.

A speed is a function of its command behind the motors' lag, and of what all have in common (a pack that sags,
the air). One that is another function of it from a moment on may be a motor that fails, and no instrument's
fault: `changed_speed` tells it, and whoever needs speeds asks.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from coaxlink.frames import Array
from coaxlink.instruments.findings import Finding, Mask
from coaxlink.instruments.flight.apart import HALF, LATE_S, SHIFTS_S, Columns, left, rounded
from coaxlink.instruments.flight.commands import Commands
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.still import (
    LEAST_ROWS,
    STUCK_S,
    away,
    held_in_flight,
    is_no_reading,
    rows_of,
)

# priors: name = value  # unit, source
FEWEST = 3  # speeds, of which one is determined by the others
OFTEN = 0.5  # of the rows have to have a speed, judgement
CORNERS = 1e-9  # of the most speed: a straight line between two messages bends by less
QUIET = 5.0  # usual pauses: a longer one is silence, as `data.logs.streams` has it of a gap


def speed_faults(log: FlownLog, commands: Commands, off: Collection[str]) -> Iterator[Finding]:
    """Speeds that are none of their rotors', by these commands, some of which are `off`."""
    for k, n in enumerate(log.rotors):
        if log.has(name := f"rpm{n}"):
            yield from _silent(log, name, commands.flying)
            yield from _speed_held(log, name, commands.values[:, k], commands.flying & ~commands.held[:, k])
    sound = [k for k, name in enumerate(log.motors) if name not in off]
    usable = commands.flying & ~commands.held.any(axis=1)
    yield from _apart(log, [log.rotors[k] for k in sound], commands.values[:, sound], usable)


def _silent(log: FlownLog, name: str, flying: Mask) -> Iterator[Finding]:
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


def _speed_held(log: FlownLog, name: str, command: Array, usable: Mask) -> Iterator[Finding]:
    """Where a speed stands still and its command moves."""
    speed = log[name]
    runs = held_in_flight(speed, usable)
    held = rows_of(runs, log.rows)
    design = np.stack([np.ones_like(command), command, command**2], axis=1)
    rows = np.zeros(log.rows, bool)
    most, step = float(np.nanmax(np.abs(speed), initial=1.0)), log.steps[name]
    for run in runs:
        a, b, _ = run
        known = usable & ~held
        if np.sum(known & np.isfinite(speed)) < LEAST_ROWS:  # it never moves
            rows[a:b] |= np.ptp(command[a:b]) > 0.0
        elif is_no_reading(away(speed / most, design, known, np.arange(a, b), step / most), run):
            rows[a:b] = True
    if rows.any():
        why = "one speed repeats exactly while its command moves: the ESC is silent"
        yield name, rows, why


def _apart(log: FlownLog, rotors: Sequence[int], commands: Array, usable: Mask) -> Iterator[Finding]:
    """The speed that goes apart, of rotors with these commands (rows, N) at usable rows."""
    if (speeds := _speeds(log, rotors, commands, usable)) is None:
        return
    every = np.ones(log.rows, bool)
    if coarse := rounded(speeds.names, speeds.values, usable):
        name, step, others = coarse
        why = f"it moves in steps of {step:.1g} of the most speed, the other speeds in {others:.1g}: rounded"
        yield name, every, why
        return
    if pair := _exchanged(speeds):
        why = "exchanged, they go with their commands: labels or wires are swapped"
        yield ", ".join(pair), every, why
        return
    first = np.cumsum(usable) <= usable.sum() // 2
    for part in (every, first, ~first):  # motors of one type may become slower together
        speeds = _speeds(log, rotors, commands, usable & part)
        if late := _late(speeds) if speeds else None:
            ms, way = 1000.0 * abs(late[1]), "later" if late[1] > 0.0 else "earlier"
            why = f"it follows its command {ms:.0f} ms {way} than the other speeds do: its stamps are off"
            yield late[0], every, why
            return


def changed_speed(log: FlownLog) -> tuple[str, float] | None:
    """The speed whose zero or scale against its command is another from a moment on, and when, s."""
    commands = log.commands
    speeds = _speeds(log, log.rotors, commands, log.flying & np.isfinite(commands).all(axis=1))
    return speeds.changed() if speeds else None


def _speeds(log: FlownLog, rotors: Sequence[int], commands: Array, usable: Mask) -> Columns | None:
    """Speeds over the most of them, each by its command so much earlier as motors usually lag, and by what
    the others' speeds have more than their commands ask.

    None where fewer than FEWEST have speeds, or the usual one does not go with its command.
    """
    rpm = np.stack([log[f"rpm{n}"] if log.has(f"rpm{n}") else np.full(log.rows, np.nan) for n in rotors])
    often = np.isfinite(rpm[:, usable]).mean(axis=1) > OFTEN if usable.any() else np.zeros(len(rpm), bool)
    if often.sum() < FEWEST:
        return None
    names = [f"rpm{n}" for n, there in zip(rotors, often, strict=True) if there]
    values = (rpm[often] / np.nanmax(np.abs(rpm[often]))).T
    asked, supply = commands[:, often], _supply(log)
    speeds = Columns.at(names, log["time_s"], values, usable & np.isfinite(values).all(axis=1))
    if speeds is None:
        return None
    own = [_by_command(asked[speeds.rows, k], supply[speeds.rows]) for k in range(len(names))]
    best = [int(np.argmin(np.sum(left(speeds.shifted(k), own[k]) ** 2, axis=0))) for k in range(len(names))]
    lag = float(SHIFTS_S[int(np.median(best))])
    known = np.flatnonzero(np.isfinite(asked).all(axis=1))
    own = [
        _by_command(
            np.interp(speeds.time[speeds.rows] - lag, speeds.time[known], asked[known, k]),
            supply[speeds.rows],
        )
        for k in range(len(names))
    ]
    more = np.stack([left(values[speeds.rows, k], own[k]) for k in range(len(names))], axis=1)
    moves = np.std(values[speeds.rows], axis=0)
    if not np.median(np.mean(more**2, axis=0) / np.maximum(moves, 1e-150) ** 2) < HALF:
        return None
    common = [np.median(np.delete(more, k, axis=1), axis=1) for k in range(len(names))]
    return replace(speeds, designs=[np.column_stack([a, b]) for a, b in zip(own, common, strict=True)])


def _supply(log: FlownLog) -> Array:
    """(rows,) of the usual supply."""
    volts = log["voltage_V"] if log.has("voltage_V") else np.ones(log.rows)
    known = np.isfinite(volts) & (volts > 0.0)
    if not known.any():
        return np.ones(log.rows)
    return np.asarray(
        np.interp(np.arange(log.rows), np.flatnonzero(known), volts[known]) / np.median(volts[known])
    )


def _by_command(command: Array, supply: Array) -> Array:
    """(rows, 4) regressors of a speed: a motor turns by command times volts (`rotor.drive`), and by its
    command alone where the ESC governs its speed."""
    return np.stack([np.ones_like(command), command, command**2, command * supply], axis=1)


def _late(speeds: Columns) -> tuple[str, float] | None:
    """A speed that follows its command at another time than the others, and by how much later, s.

    Less than one of its messages is apart is no lateness: those of two ESCs come in turn.
    """
    late = speeds.late()
    return late if late and abs(late[1]) > max(LATE_S, _between_messages_s(speeds, late[0])) else None


def _between_messages_s(speeds: Columns, name: str) -> float:
    """How far apart a column's readings are, which is straight between them."""
    values = speeds.values[:, speeds.names.index(name)]
    known = np.flatnonzero(np.isfinite(values))
    time = speeds.time[known]
    bends = np.abs(np.diff(np.diff(values[known]) / np.diff(time)) * np.diff(time)[1:]) > CORNERS
    return float(time[-1] - time[0]) / max(int(bends.sum()), 1)


def _exchanged(speeds: Columns) -> tuple[str, str] | None:
    """Two speeds each of which goes with the other's command, and neither with its own."""
    values = speeds.values[speeds.rows]

    def others(k: int) -> list[int]:
        return [j for j in range(len(speeds.names)) if j != k]

    def ways(k: int) -> tuple[Array, Array]:
        return left(values[:, k], speeds.designs[k]), left(values[:, others(k)], speeds.designs[k])

    best = speeds.likeliest(ways)
    if best is None:
        return None
    k = speeds.names.index(best[0])
    j = others(k)[best[1]]
    own, other = (float(np.sum(left(values[:, i], speeds.designs[j]) ** 2)) for i in (j, k))
    return (speeds.names[k], speeds.names[j]) if other < HALF * own else None
