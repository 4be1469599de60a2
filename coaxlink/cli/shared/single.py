"""`coaxlink identify --single`: a first model of a pair from a table of one rotor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.next import after_prior
from coaxlink.cli.shared.shell import console, say
from coaxlink.cli.shared.stand import StandOptions

SingleOption = Annotated[
    Path | None,
    typer.Option(metavar="TABLE", help="No stand: a table of one rotor (T-Motor, APC, UIUC, RCbenchmark)."),
]
PitchOption = Annotated[
    float | None, typer.Option(metavar="M", help="Pitch of the propellers, with --single (5.3 in is 0.135).")
]
SpacingOption = Annotated[
    float | None, typer.Option(metavar="M", help="From disc to disc of the pair, with --single.")
]
SupplyOption = Annotated[
    float | None, typer.Option("--voltage", metavar="V", help="Of --single, where its rows have several.")
]
BladesOption = Annotated[int, typer.Option(min=1, max=8, help="Blades of a propeller, with --single.")]


def prior_of_single(
    table: Path,
    how: StandOptions,
    *,
    spacing_m: float | None,
    pitch_m: float | None,
    blades: int,
    voltage_V: float | None,
    speed_max_rpm: float | None,
    out: Path | None,
    json: Path | None,
    plot: Path | None,
) -> None:
    """Print the prior with its intervals and all that was guessed; write it. Raises InputError."""
    from coaxlink import files
    from coaxlink.data.single import read_single_table
    from coaxlink.errors import InputError
    from coaxlink.report.prior import picture, prior_table, what_it_says
    from coaxlink.rotor.model import save_rotor_model
    from coaxlink.rotor.prior import Propeller, pair_prior

    for option, value in (("--diameter", how.diameter_m), ("--spacing", spacing_m)):
        if value is None:
            raise InputError("--single", option, "needed with it, in metres")
    assert how.diameter_m is not None and spacing_m is not None
    propeller = Propeller(how.diameter_m, spacing_m, pitch_m, blades)
    read = read_single_table(
        table,
        propeller.diameter_m,
        columns_map=how.columns,
        poles=how.poles,
        sheet=how.sheet,
        trust_units=how.trust_units,
        voltage_V=voltage_V,
    )
    prior = pair_prior(read, propeller, speed_max_rpm=speed_max_rpm)
    say(f"{read.source}: {len(read.rpm)} rows, {read.origin.words}; no coaxial measurement enters")
    console().print(prior_table(prior))
    for line in what_it_says(prior):
        console().print(line)
    for line in (*read.notes, *prior.guessed):
        say(f"- {line}")
    if out:
        save_rotor_model(out, prior.model)
        say(f"wrote {out}")
    if json:
        files.write_json(json, prior.as_json())
    if plot:
        files.write_atomic(plot / "prior.png", picture(prior))
        say(f"wrote prior.png to {plot}")
    say(after_prior(out))
