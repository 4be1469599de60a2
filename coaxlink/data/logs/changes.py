"""Parameters that changed while a log ran: its commands are read piece by piece, each by what held then."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.data.logs.outputs import Parameters
from coaxlink.data.logs.streams import Message, TimeSeries, rows_of

# what the readers turn logged numbers into commands by: thrust curve, outputs and their ranges
READ_BY = re.compile(
    r"THR_MDL_FAC|CA_ROTOR_COUNT|\w+_(FUNC|MIN|MAX|TIM)\d+|(PWM|DSHOT|MOT_PWM)_\w+|SERVO\d+_(FUNCTION|MIN|MAX)"
)
Change = tuple[float, str, float]  # time_s, name, value


@dataclass(frozen=True)
class Period:
    """What held from one moment on until the next."""

    since_s: float
    until_s: float
    parameters: Parameters
    why: str = ""  # in words, what began it

    def of(self, message: Message | None) -> Message | None:
        """The rows of a message in it."""
        if message is None:
            return None
        return rows_of(message, (message["time_s"] >= self.since_s) & (message["time_s"] < self.until_s))


def periods(first: Parameters, changes: Iterable[Change]) -> list[Period]:
    """One where nothing that matters changed; what changes at one moment begins one period."""
    now, found = dict(first), [Period(-np.inf, np.inf, dict(first))]
    for time, name, value in sorted(changes, key=lambda change: change[0]):
        if now.get(name) == value:
            continue
        before, now[name] = now.get(name), value
        if not READ_BY.fullmatch(name):
            continue
        last = found[-1]
        word = f"{name} {value:g}" if before is None else f"{name} {before:g} to {value:g}"
        if last.since_s == time:
            found[-1] = Period(time, np.inf, dict(now), f"{last.why}, {word}")
        else:
            found[-1] = Period(last.since_s, time, last.parameters, last.why)
            found.append(Period(time, np.inf, dict(now), word))
    return found


def read_in_periods(
    parts: Sequence[Period],
    read: Callable[[Period, list[str], list[str]], TimeSeries | None],
    notes: list[str],
    premises: list[str],
) -> TimeSeries | None:
    """The commands of all periods, each read by its own parameters; `read` adds its notes and premises.

    Only those that give the same motors are one flight: of others the longest is kept.
    """
    found = []
    for part in parts:
        reported: list[str] = []
        taken: list[str] = []
        commands = read(part, reported, taken)
        if commands is not None:
            found.append((part, commands, reported, taken))
    if not found:
        return None
    longest = max(found, key=lambda one: len(one[1].time_s))[1]
    kept = [one for one in found if one[1].columns.keys() == longest.columns.keys()]
    for part, _, reported, taken in kept:
        start = f"from {part.since_s:.1f} s on ({part.why}): " if part.why else ""
        notes += [start + word for word in reported]
        premises += taken
    time = np.concatenate([commands.time_s for _, commands, *_ in kept])
    columns = {name: np.concatenate([c.columns[name] for _, c, *_ in kept]) for name in longest.columns}
    return TimeSeries.of(time, columns)
