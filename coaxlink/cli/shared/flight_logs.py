"""Flight logs as the verbs take them: every flight of every file, of one vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from coaxlink.data import Samples

# its range is the library's to check: it knows the recording, and says what is in it
SystemOfLogOption = Annotated[
    int | None, typer.Option("--system", metavar="ID", help="The vehicle, where a recording holds several.")
]


def read_flights_of(
    logs: Sequence[Path], system: int | None, progress: Callable[[str], None]
) -> list[Samples]:
    """The flights of these logs in their order; one log may hold several. Raises InputError."""
    from coaxlink.data import read_flights

    found: list[Samples] = []
    for path in logs:
        progress(f"reading {path.name}")
        refuse_stand_log(path)
        found += read_flights(path, system)
    return found


def named_vehicle(airframe: Path | None, log: Path, system: int | None) -> Path:
    """The vehicle's file. Raises InputError where nobody names it: a flight of one is judged by no other."""
    from coaxlink.data import read_flights
    from coaxlink.errors import InputError

    if airframe is None:
        read_flights(log, system)  # what is wrong with the log comes first
        problem = (
            "whose flight is it? --airframe AIRFRAME.toml (coaxlink init makes one; examples has the paper's)"
        )
        raise InputError(log, "", problem)
    return airframe


def refuse_stand_log(path: Path) -> None:
    """Raises InputError where a flight log is expected and this is a stand's, or neither."""
    from coaxlink.data import RotorsUnclear, is_flight_log, read_stand_log
    from coaxlink.errors import InputError

    if is_flight_log(path):
        return
    stand = "a flight log is expected, found a stand's: coaxlink identify takes it"
    try:
        read_stand_log(path)
    except RotorsUnclear:
        pass
    except InputError as error:
        where = f"{error.where}: " if error.where else ""
        problem = f"a flight log is expected (columns time_s, motor1, ...), and it is no stand's: {where}"
        raise InputError(path, "", f"{problem}{error.problem}") from error
    raise InputError(path, "", stand)
