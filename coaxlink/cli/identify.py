"""`coaxlink identify`: stand data to a rotor model."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli._shell import JsonOption, console, say

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.rotor import Identification
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.spacing import SpacingModel


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
    physical: Annotated[
        bool, typer.Option("--physical", help="Thrusts rise with their own speed, fall with the wake's.")
    ] = False,
    tolerance: Annotated[
        str | None,
        typer.Option(metavar="N,NM", help="The paper's form of eq. 4: least l1 norm within these errors."),
    ] = None,
    join: Annotated[
        bool, typer.Option("--join", help="One model of all logs: single-rotor tests with coaxial maps.")
    ] = False,
    spacings: Annotated[
        str | None,
        typer.Option(metavar="S1,S2,...", help="Rotor spacing of each log: one model over the spacing."),
    ] = None,
    at_spacing: Annotated[
        float | None, typer.Option(metavar="S", help="Write --out for this spacing (default: the middle).")
    ] = None,
    learning: Annotated[
        bool, typer.Option("--learning-curve", help="Error over how much of the log was fitted.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Write pictures (PNG).")] = None,
    report: Annotated[Path | None, typer.Option(metavar="R.html", help="Write one page of it all.")] = None,
) -> None:
    """Identify a rotor model from stand logs: terms, intervals and held-out errors."""
    from coaxlink import files
    from coaxlink.errors import InputError
    from coaxlink.report.identify import remarks, tables
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.identification import identify as run
    from coaxlink.rotor.lasso import InfeasibleTolerance
    from coaxlink.rotor.model import save_rotor_model

    thrust_N, torque_Nm = _tolerances(tolerance)
    options = Options(
        max_order, standardised=not raw, tolerance_N=thrust_N, tolerance_Nm=torque_Nm, physical=physical
    )
    try:
        results = [
            run(samples, form.value, speed_max_rpm=speed_max_rpm, options=options)
            for samples in _read(logs, columns, join)
        ]
    except InfeasibleTolerance as error:
        raise InputError("--tolerance", "", str(error)) from error
    screen = console()
    for result in results:
        say(f"{result.bench.samples.source}: {result.bench.samples.rows} rows")
        for table in tables(result):
            screen.print(table)
        for remark in remarks(result):
            say(f"- {remark}")
    over = _over_spacing(results, spacings) if spacings else None
    if out and over:
        save_rotor_model(out, over.at(over.middle if at_spacing is None else at_spacing))
        say(f"wrote {out}")
    elif out:
        for result, path in zip(results, _places(out, len(results)), strict=True):
            save_rotor_model(path, result.model)
            say(f"wrote {path}")
    curves = _learn(results, options) if learning else []
    if json:
        models = [{"file": r.bench.samples.source, **r.as_json()} for r in results]
        for model, curve in zip(models, curves, strict=False):
            model["learning_curve"] = curve
        document = models[0] if len(models) == 1 else {**models[0], "models": models}
        files.write_json(json, {**document, "spacing": over.as_json()} if over else document)
    if plot or report:
        _draw(results, plot, report)


def _draw(results: list[Identification], plot: Path | None, report: Path | None) -> None:
    """Pictures into a folder (one a log when there are several), and pages."""
    from coaxlink import files
    from coaxlink.report.identify_page import identify_page
    from coaxlink.report.identify_plots import pictures

    pages = _places(report, len(results)) if report else [None] * len(results)
    for result, page in zip(results, pages, strict=True):
        drawn = pictures(result)
        if plot:
            folder = plot if len(results) == 1 else plot / Path(result.bench.samples.source).stem
            for name, png in drawn.items():
                files.write_atomic(folder / name, png)
            say(f"wrote {', '.join(drawn)} to {folder}")
        if page:
            files.write_atomic(page, identify_page(result, drawn))
            say(f"wrote {page}")


def _tolerances(text: str | None) -> tuple[float | None, float | None]:
    """Thrust and torque tolerances of "N,NM"."""
    from coaxlink.errors import InputError

    if text is None:
        return None, None
    try:
        thrust_N, torque_Nm = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            "--tolerance", "", f"two numbers as in 2,0.05 are expected, found '{text}'"
        ) from None
    if not (thrust_N > 0 and torque_Nm > 0):
        raise InputError("--tolerance", "", f"more than 0 is expected, found '{text}'")
    return thrust_N, torque_Nm


def _read(logs: list[Path], columns: Path | None, joined: bool) -> list[Samples]:
    from coaxlink import files
    from coaxlink.data import read_stand_log
    from coaxlink.data.join import join

    read = [
        read_stand_log(files.example("stand_eq17.csv") if str(p) == "example" else p, columns) for p in logs
    ]
    return [join(read)] if joined else read


def _over_spacing(results: list[Identification], text: str) -> SpacingModel:
    """The model over the spacing; says load by load whether the spacing matters."""
    from coaxlink.errors import InputError
    from coaxlink.rotor.spacing import spacing_model

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != len(results) or not all(0 < v < 1e3 for v in values):
        raise InputError("--spacings", "", f"a spacing for each of the {len(results)} logs, found '{text}'")
    model = spacing_model(results, values)
    for load, alone in model.rmse_without.items():
        verdict = "goes with the spacing" if model.slope[load] else "no slope over the spacing is supported"
        errors = f"{alone:.4g} without, {model.rmse_with[load]:.4g} with slopes"
        say(f"- {load}: {verdict}; on a spacing left out {errors}")
    return model


def _learn(results: list[Identification], options: Options) -> list[list[dict[str, Any]]]:
    """Print each model's learning curve; the same as plain numbers."""
    from coaxlink.report.identify_curve import curve_table
    from coaxlink.rotor.learning import learning_curve

    curves = [learning_curve(result.form, result.bench, options) for result in results]
    for curve in curves:
        console().print(curve_table(curve))
    return [[asdict(lesson) for lesson in curve] for curve in curves]


def _places(out: Path, count: int) -> list[Path]:
    """Where each model goes: the name asked for, numbered when one call makes several."""
    if count == 1:
        return [out]
    return [out.with_name(f"{out.stem}_{i}{out.suffix}") for i in range(1, count + 1)]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("identify")(identify)
