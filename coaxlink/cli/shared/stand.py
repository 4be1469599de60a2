"""Stand logs for the verbs that take them: the options, the question which rotor is the upper, the checks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.shell import say

if TYPE_CHECKING:
    from coaxlink.data import RotorsUnclear, Samples

ColumnsOption = Annotated[
    Path | None,
    typer.Option(metavar="MAP.toml", help="Columns of a foreign log, by our names (docs/stand.md)."),
]
UpperOption = Annotated[
    str | None,
    typer.Option(metavar="LABEL", help="The upper rotor as the headings call it: A, left, 1."),
]
PolesOption = Annotated[
    int | None,
    typer.Option(min=2, max=100, help="Magnet poles of the motors, for speeds in electrical turns."),
]
DiameterOption = Annotated[
    float | None, typer.Option("--diameter", metavar="M", help="Of the propellers, to check the units by.")
]
SheetOption = Annotated[str | None, typer.Option(metavar="NAME", help="Sheet of a spreadsheet.")]
TrustOption = Annotated[
    bool, typer.Option("--trust-units", help="Take the headings' units and signs whatever the readings say.")
]


@dataclass(frozen=True)
class StandOptions:
    """How stand logs are to be read."""

    columns: Path | None = None
    upper: str | None = None
    poles: int | None = None
    diameter_m: float | None = None
    sheet: str | None = None
    trust_units: bool = False

    def read(self, path: Path, progress: Callable[[str], None]) -> Samples:
        """One log. Raises RotorsUnclear, InputError."""
        from coaxlink.data import read_stand_log

        return read_stand_log(
            path,
            self.columns,
            upper=self.upper,
            poles=self.poles,
            diameter_m=self.diameter_m,
            sheet=self.sheet,
            trust_units=self.trust_units,
            progress=lambda share: progress(f"reading {path.name}, {100 * share:.0f} %"),
        )


def read_stand(
    paths: Sequence[Path], how: StandOptions, progress: Callable[[str], None], *, one_rotor: bool = False
) -> list[Samples]:
    """Stand logs, each with its rotors known; the upper one's label in one log holds for the others.

    `one_rotor`: the logs are of one pair, whose labels must agree. `progress` takes the progress. Asks on a
    terminal which rotor is the upper; raises RotorsUnclear elsewhere, InputError.
    """
    from coaxlink.data import RotorsUnclear
    from coaxlink.errors import InputError

    read: list[Samples | RotorsUnclear] = []
    for path in paths:
        refuse_flight_log(path)
        try:
            read.append(how.read(path, progress))
        except RotorsUnclear as unclear:
            read.append(unclear)
    labels = {r.upper_label for r in read if not isinstance(r, RotorsUnclear) and r.upper_label}
    if one_rotor and len(labels) > 1:
        raise InputError("--upper", "", f"the logs call different rotors the upper one ({', '.join(labels)})")
    found = []
    for path, log in zip(paths, read, strict=True):
        if isinstance(log, RotorsUnclear):
            known = [label for label in labels if label in log.labels]
            upper = known[0] if len(known) == 1 else _ask(log)
            log = replace(how, upper=upper).read(path, progress)
        elif one_rotor and len(labels) == 1 and how.upper is None and not log.upper_label:
            log = _relabelled(path, log, replace(how, upper=next(iter(labels))), progress)
        found.append(log)
    return found


def refuse_flight_log(path: Path) -> None:
    """Raises InputError when a stand log is expected and this is a flight's, naming the verb for it."""
    from coaxlink.data import is_flight_log, read_flights
    from coaxlink.errors import InputError

    if is_flight_log(path):
        if path.suffix.lower() != ".csv":
            read_flights(path)  # a verb that would refuse it is not named; of a table refine names the column
        causes = f"coaxlink refine {path.name} --airframe AIRFRAME.toml"
        model = f"coaxlink identify {path.name} --airframe AIRFRAME.toml --rotor ROTOR.toml"
        raise InputError(path, "", f"a flight log: {causes} looks for causes, {model} updates a model by it")


def doubts(log: Samples, upper: str | None) -> list[str]:
    """What the data say against the sides that somebody stated and, asked at a terminal, stays with.

    Raises InputError where nobody did, or who is asked does not.
    """
    from coaxlink.data.sides import exchanged
    from coaxlink.errors import InputError

    evidence = exchanged(log)
    if evidence is None:
        return []
    if upper is None:
        raise InputError(
            log.source,
            "columns",
            f"upper and lower look exchanged, or the pair blows up: {'; '.join(evidence)}; --upper lower "
            "exchanges them, --upper upper takes them as they stand",
        )
    doubt = f"against --upper {upper}: {'; '.join(evidence)}; is it the other label, or does the pair blow "
    doubt += "upwards? Upper is the rotor that the air meets first"
    if at_a_terminal() and not typer.confirm(f"{doubt}. Take {upper} all the same?", err=True):
        raise InputError("--upper", "", f"not {upper}: the other label is expected")
    return [doubt]


def _relabelled(path: Path, log: Samples, how: StandOptions, progress: Callable[[str], None]) -> Samples:
    """A log of one rotor alone, on the side that its label has in the other logs."""
    from coaxlink.errors import InputError

    try:
        return how.read(path, progress)
    except InputError:
        return log  # no such label there: headings that say their rotors


def at_a_terminal() -> bool:
    """Whether somebody sits there to answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _ask(unclear: RotorsUnclear) -> str:
    """The upper rotor's label from whoever sits at the terminal. Raises RotorsUnclear when nobody does."""
    if not at_a_terminal():
        raise unclear
    for line in unclear.evidence:
        say(f"- {line}")
    names = {label.casefold(): label for label in unclear.labels}
    while True:
        question = f"{unclear.source}: which rotor is the upper one, {' or '.join(unclear.labels)}"
        answer = str(typer.prompt(question, err=True)).strip().casefold()
        if answer in names:
            return names[answer]
