"""What of flight logs is no reading, before anything is inferred from them: the first step of every verb.

Columns are held against each other alone (`columns`, `commands`, `speeds`), whatever rotors and airframe do.
What is no reading for a part of a log is emptied there, and a flight has a gap; of a column that a flight can
be judged without, that column goes. A log whose labels, signs or scales are wrong, or that was blind for most
of its time, is of no use.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from coaxlink.airframe import Airframe
from coaxlink.channels.flight import NEEDED
from coaxlink.data.logs.flight import impossible_commands
from coaxlink.data.samples import Samples
from coaxlink.instruments.findings import Finding, Suspect, rows_text
from coaxlink.instruments.flight.columns import column_faults
from coaxlink.instruments.flight.commands import Commands, motors_too_many
from coaxlink.instruments.flight.flown_log import FlownLog
from coaxlink.instruments.flight.kinematics import HEIGHT
from coaxlink.instruments.flight.speeds import speed_faults

DROPPED = (HEIGHT, "voltage_V")  # a flight can be judged without them
BLIND = 0.5  # of the rows, judgement


@dataclass(frozen=True)
class Inputs:
    """Flight logs without what is no reading."""

    logs: tuple[Samples, ...]
    suspects: tuple[Suspect, ...] = ()
    blind: tuple[Suspect, ...] = ()  # of these, what makes a log as a whole useless


def checked(logs: Sequence[Samples], airframe: Airframe) -> Inputs:
    """These logs of one vehicle, and what of them is no reading; of a log that lacks columns, nothing."""
    rotors = sorted(r.number for r in airframe.rotors)
    kept, suspects, blind = [], list[Suspect](), list[Suspect]()
    for log in logs:
        for column, rows, why in _findings(log, rotors):
            suspect = Suspect(column, rows_text(rows), why)
            suspects.append(suspect)
            names = _names(column)
            if set(names) <= set(DROPPED):
                log = log.without(*names)
            elif set(names) <= {f"rpm{n}" for n in rotors} or rows.mean() <= BLIND:
                log = log.with_columns(**{n: np.where(rows, np.nan, log[n]) for n in names})
            else:
                blind.append(suspect)
        kept.append(log)
    return Inputs(tuple(kept), tuple(suspects), tuple(blind))


def _names(finding: str) -> list[str]:
    """The columns that a finding names: "accel_*, gyro_*" are six."""
    out: list[str] = []
    for name in finding.split(", "):
        stem = name.removesuffix("*")
        out += [name] if stem == name else [n for n in NEEDED if n.startswith(stem)]
    return out


def _findings(log: Samples, rotors: Sequence[int]) -> Iterator[Finding]:
    if not log.has(*NEEDED, *(f"motor{n}" for n in rotors)):
        return
    for n in rotors:
        outside = impossible_commands(log[f"motor{n}"])
        if outside.any():
            why = "commands outside 0..1, as of damaged packets: what follows from them is left out"
            yield f"motor{n}", outside, why
    flown = FlownLog.of(log, rotors)
    yield from column_faults(flown)
    if commands := Commands.of(flown):
        yield from commands.stuck()
        apart = list(commands.apart())
        yield from apart
        yield from speed_faults(flown, commands, {column for column, *_ in apart})
    yield from motors_too_many(flown)
