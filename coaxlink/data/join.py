"""Several stand logs of one propeller as one table: single-rotor tests beside coaxial maps, repeated maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coaxlink.data.aliases import PAIR, SIDES
from coaxlink.data.samples import Samples
from coaxlink.errors import InputError

SPEEDS = ("rpm", "throttle")
LOADS = ("thrust_N", "torque_Nm")


def join(logs: Sequence[Samples]) -> Samples:
    """The rows of all logs, in order.

    A rotor that was not on a log's stand stands still there, its loads unknown (NaN). Other columns stay if
    every log has them; the rest are named in the notes. Raises InputError when the speeds are in rpm in one
    log and known only as throttle in another.
    """
    if len(logs) == 1:
        return logs[0]
    columns: dict[str, np.ndarray] = {}
    dropped = []
    for name in dict.fromkeys(name for log in logs for name in log.columns):
        known = [column for log in logs if (column := _filled(log, name)) is not None]
        if len(known) == len(logs):
            columns[name] = np.concatenate(known)
        else:
            dropped.append(name)
    for side in SIDES:
        speeds = [f"{side}_{what}" for what in SPEEDS]
        if any(log.has(name) for log in logs for name in speeds) and not columns.keys() & set(speeds):
            lacking = next(log for log in logs if not log.has(f"{side}_rpm"))
            raise InputError(
                lacking.source, f"column {side}_rpm", "missing, and the logs joined with it have it"
            )
    notes = [f"{log.source}: {note}" for log in logs for note in log.notes]
    notes.append(f"joined: {', '.join(f'{log.source} ({log.rows} rows)' for log in logs)}")
    if dropped:
        notes.append(f"left out, not in every log: {', '.join(dropped)}")
    premises = tuple(dict.fromkeys(p for log in logs for p in log.premises))
    return Samples(columns, " + ".join(log.source for log in logs), tuple(notes), premises=premises)


def _filled(log: Samples, name: str) -> np.ndarray | None:
    """The column, or what it must be where this log's stand did not have that rotor; None if unknown."""
    if log.has(name):
        return log[name]
    if name.startswith(
        f"{PAIR}_"
    ):  # beside a cell under both, a log of one rotor is the pair's with the other still
        alone = [side for side in SIDES if any(log.has(f"{side}_{w}") for w in SPEEDS)]
        own = f"{alone[0]}_{name.removeprefix(f'{PAIR}_')}" if len(alone) == 1 else ""
        return log[own] if log.has(own) else np.full(log.rows, np.nan)
    side, _, what = name.partition("_")
    if side not in SIDES:
        return None
    if what in LOADS:
        return np.full(log.rows, np.nan)
    on_the_stand = any(log.has(f"{side}_{w}") for w in (*SPEEDS, *LOADS))
    return np.zeros(log.rows) if what in SPEEDS and not on_the_stand else None
