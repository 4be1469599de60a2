"""`coaxlink sim`: the world: a stand-in autopilot on a plant of its own, or a virtual thrust stand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from coaxlink import files
from coaxlink.cli._shell import say
from coaxlink.errors import InputError, LinkError


def sim(
    stand: Annotated[
        Path | None, typer.Option(metavar="OUT.csv", help="Run the virtual thrust stand and leave.")
    ] = None,
    rotor: Annotated[Path | None, typer.Option(help="Rotor file of the world.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all noise.")] = 0,
) -> None:
    """Fly a stand-in autopilot on a simulated vehicle, or measure a simulated rotor pair."""
    with world_errors():
        if stand is not None:
            from sim.rotors import read_pair
            from sim.stand import stand_rows, write_stand

            pair = read_pair(rotor or files.example("rotor_paper.toml"))
            rows = stand_rows(pair, seed=seed)
            write_stand(stand, rows)
            say(f"{stand}: {len(rows)} points")
            return
    raise InputError("sim", "", "the stand-in autopilot is not built yet")


@contextmanager
def world_errors() -> Iterator[None]:
    """The world's errors as coaxlink's."""
    from sim.errors import PortError, WorldError

    try:
        yield
    except WorldError as error:
        raise InputError(error.source, error.where, error.problem) from error
    except PortError as error:
        raise LinkError(error.address, error.problem) from error


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("sim")(sim)
