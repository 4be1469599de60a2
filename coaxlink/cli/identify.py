"""`coaxlink identify`: stand data to a rotor model."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli._shell import JsonOption, console, say

if TYPE_CHECKING:
    from coaxlink.data import Samples


class Form(StrEnum):
    """What --form takes."""

    CRM = "crm"
    RCRM = "rcrm"
    SRM = "srm"
    CPCM = "cpcm"
    MUTUAL = "mutual"
    AUTO = "auto"


def identify(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Stand logs; 'example' for the shipped one.")
    ],
    form: Annotated[
        Form, typer.Option(help="Rotor model; auto keeps what held-out data supports.")
    ] = Form.CRM,
    out: Annotated[Path | None, typer.Option(metavar="ROTOR.toml", help="Write the rotor model.")] = None,
    json: JsonOption = None,
    columns: Annotated[
        Path | None, typer.Option(metavar="MAP.toml", help="Columns of a foreign log, by our names.")
    ] = None,
    speed_max_rpm: Annotated[
        float | None, typer.Option(metavar="RPM", help="The speed that u = 1 means (default: from the log).")
    ] = None,
    max_order: Annotated[int, typer.Option(min=1, max=6, help="Highest power of a speed crm may use.")] = 4,
    raw: Annotated[bool, typer.Option("--raw", help="Do not standardise the terms before LASSO.")] = False,
) -> None:
    """Identify a rotor model from stand logs: terms, intervals and held-out errors."""
    from coaxlink import files
    from coaxlink.report.identify import remarks, tables
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.identification import identify as run
    from coaxlink.rotor.model import save_rotor_model

    options = Options(max_order=max_order, standardised=not raw)
    results = [
        run(samples, form.value, speed_max_rpm=speed_max_rpm, options=options)
        for samples in _read(logs, columns)
    ]
    screen = console()
    for result in results:
        say(f"{result.bench.samples.source}: {result.bench.samples.rows} rows")
        for table in tables(result):
            screen.print(table)
        for remark in remarks(result):
            say(f"- {remark}")
    if out:
        for result, path in zip(results, _places(out, len(results)), strict=True):
            save_rotor_model(path, result.model)
            say(f"wrote {path}")
    if json:
        document = results[0].as_json()
        if len(results) > 1:
            document["models"] = [{"file": r.bench.samples.source, **r.as_json()} for r in results]
        files.write_json(json, document)


def _read(logs: list[Path], columns: Path | None) -> list[Samples]:
    from coaxlink import files
    from coaxlink.data import read_stand_log

    return [
        read_stand_log(files.example("stand_eq17.csv") if str(p) == "example" else p, columns) for p in logs
    ]


def _places(out: Path, count: int) -> list[Path]:
    """Where each model goes: the name asked for, numbered when one call makes several."""
    if count == 1:
        return [out]
    return [out.with_name(f"{out.stem}_{i}{out.suffix}") for i in range(1, count + 1)]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("identify")(identify)
