"""`coaxlink identify`: stand data to a rotor model."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink.cli.shared.from_flights import AirframeOption, PriorOption, identify_from_flights
from coaxlink.cli.shared.next import after_identify
from coaxlink.cli.shared.shell import JsonOption, console, say, talk
from coaxlink.cli.shared.single import (
    BladesOption,
    PitchOption,
    SingleOption,
    Sizes,
    SpacingOption,
    prior_of_single,
)
from coaxlink.cli.shared.stand import (
    ColumnsOption,
    DiameterOption,
    PolesOption,
    Reading,
    SheetOption,
    TrustOption,
    UpperOption,
    doubts,
    read_stand,
)

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
    SURFACE = "surface"
    MUTUAL = "mutual"
    AUTO = "auto"


def identify(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG...", help="Stand logs; 'example' for the shipped one."),
    ] = None,
    form: Annotated[
        Form, typer.Option(help="Rotor model; auto keeps what held-out data supports.")
    ] = Form.AUTO,
    out: Annotated[Path | None, typer.Option(metavar="ROTOR.toml", help="Write the rotor model.")] = None,
    json: JsonOption = None,
    columns: ColumnsOption = None,
    upper: UpperOption = None,
    poles: PolesOption = None,
    diameter: DiameterOption = None,
    sheet: SheetOption = None,
    trust_units: TrustOption = False,
    speed_max_rpm: Annotated[
        float | None, typer.Option(metavar="RPM", help="The speed that u = 1 means (default: from the log).")
    ] = None,
    max_order: Annotated[int, typer.Option(min=1, max=6, help="Highest power of a speed crm may use.")] = 4,
    raw: Annotated[bool, typer.Option("--raw", help="Do not standardise the terms before LASSO.")] = False,
    physical: Annotated[
        bool, typer.Option("--physical", help="Loads do what rotors' do: docs/stand.md.")
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
    next_runs: Annotated[
        Path | None,
        typer.Option(
            "--next", metavar="PLAN.toml", help="Write the stand run, or the flight, that would tell most."
        ),
    ] = None,
    single: SingleOption = None,
    pitch: PitchOption = None,
    spacing: SpacingOption = None,
    blades: BladesOption = 2,
    airframe: AirframeOption = None,
    rotor: PriorOption = None,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Write pictures (PNG, SVG, PDF).")] = None,
    report: Annotated[Path | None, typer.Option(metavar="R.html", help="Write one page of it all.")] = None,
) -> None:
    """Identify a rotor model from stand logs: terms, intervals and held-out errors.

    Without a stand, --single makes a first model of a pair from a table of one rotor, and flight logs with
    --airframe and --rotor update it (docs/no_stand.md).
    """
    if single is not None:
        sizes = Sizes(diameter, pitch, spacing, blades)
        how = Reading(columns, upper, poles, diameter, sheet, trust_units)
        prior_of_single(single, logs or [], how, sizes, speed_max_rpm, out, json, plot)
        return
    if logs and (airframe is not None or rotor is not None):
        identify_from_flights(logs, airframe, rotor, out, json, next_runs)
        return
    from coaxlink import files
    from coaxlink.errors import InputError
    from coaxlink.report.identify import remarks, tables
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.identification import identify as run
    from coaxlink.rotor.lasso import InfeasibleTolerance
    from coaxlink.rotor.model import save_rotor_model

    if not logs:
        raise InputError("identify", "LOG...", "a stand log is expected, or --single TABLE of one rotor")
    thrust_N, torque_Nm = _tolerances(tolerance)
    if tolerance is not None and form is Form.AUTO:
        form = Form.CRM  # the one form that eq. 4 is about
    options = Options(
        max_order, standardised=not raw, tolerance_N=thrust_N, tolerance_Nm=torque_Nm, physical=physical
    )
    how = Reading(columns, upper, poles, diameter, sheet, trust_units)
    try:
        read = _read(logs, how, join)
        for samples in read:
            for doubt in doubts(samples, upper):
                say(f"- {doubt}")
        results = [run(samples, form.value, speed_max_rpm=speed_max_rpm, options=options) for samples in read]
    except InfeasibleTolerance as error:
        raise InputError("--tolerance", "", str(error)) from error
    screen = console()
    checked = [_checks(result, diameter) for result in results]
    for result, checks in zip(results, checked, strict=True):
        say(f"{result.data.samples.source}: {result.data.samples.rows} rows")
        for line in checks["odd"]:
            say(f"! {line}")
        for line in checks["data"]:
            say(f"- {line}")
        for table in tables(result):
            screen.print(table)
        for remark in remarks(result):
            say(f"- {remark}")
    over = _over_spacing(results, spacings) if spacings else None
    if out and over:
        save_rotor_model(out, over.at(over.middle if at_spacing is None else at_spacing))
        say(f"wrote {out}")
    elif out:
        for result, path in zip(results, _output_files(out, len(results)), strict=True):
            save_rotor_model(path, result.model)
            say(f"wrote {path}")
    runs = _plan(results, next_runs) if next_runs else []
    curves = _learn(results, options) if learning else []
    if json:
        models = [{"file": r.data.samples.source, **r.as_json()} for r in results]
        for model, curve in zip(models, curves, strict=False):
            model["learning_curve"] = curve
        for model, checks, plan in zip(models, checked, runs or [{}] * len(models), strict=True):
            model |= {"oddities": checks["odd"], "coverage": checks["coverage"]}
            model |= {"next": plan} if plan else {}
        document = models[0] if len(models) == 1 else {**models[0], "models": models}
        files.write_json(json, {**document, "spacing": over.as_json()} if over else document)
    if plot or report:
        _draw(results, plot, report)
    say(after_identify(out, results[0].form))


def _checks(result: Identification, diameter_m: float | None) -> dict[str, Any]:
    """What is odd in the log, what it covers, and which propellers its units mean."""
    from coaxlink.data.unit_check import electrical_turns, other_units, sizes
    from coaxlink.rotor.coverage import coverage
    from coaxlink.rotor.plausible import oddities, poor_errors

    covered = coverage(result)
    samples = result.data.samples
    meant = sizes(samples, diameter_m)
    turns, units = electrical_turns(samples, diameter_m), other_units(samples, diameter_m)
    open_units = (
        f"with {units} these readings are propellers' as well: --diameter M decides, a map states it"
        if units
        else ""
    )
    return {
        "odd": [line for line in (turns, open_units) if line]
        + [*oddities(result.data, result.form), *poor_errors(result)],
        "data": [*([meant] if meant else []), *covered.lines()],
        "coverage": covered.as_json(),
    }


def _plan(results: list[Identification], path: Path) -> list[dict[str, Any]]:
    """Write each log's next run; the same as plain numbers."""
    import tomli_w

    from coaxlink import files
    from coaxlink.rotor.next_runs import next_runs

    found = []
    for result, file in zip(results, _output_files(path, len(results)), strict=True):
        runs = next_runs(result)
        head = "".join(f"# {line}\n" for line in runs.lines())
        files.write_atomic(file, head + tomli_w.dumps(runs.document()))
        for line in runs.lines():
            say(f"{file}: {line}")
        found.append(
            {"before": runs.before, "after": runs.after, "seconds": runs.seconds, "share": runs.share}
        )
    return found


def _draw(results: list[Identification], plot: Path | None, report: Path | None) -> None:
    """Pictures into a folder (one a log when there are several), and pages."""
    from coaxlink import files
    from coaxlink.report.identify_page import identify_page
    from coaxlink.report.made import Made
    from coaxlink.report.pictures.figures import write_figures
    from coaxlink.report.pictures.identify_plots import figures

    pages = _output_files(report, len(results)) if report else [None] * len(results)
    for result, page in zip(results, pages, strict=True):
        made = Made.now([result.data.samples.source])
        if plot:
            drawn = figures(result, made.line())
            folder = plot if len(results) == 1 else plot / Path(result.data.samples.source).stem
            write_figures(folder, drawn)
            say(f"wrote {', '.join(drawn)} (.png, .svg, .pdf) to {folder}")
        if page:
            files.write_atomic(page, identify_page(result, made))
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


def _read(logs: list[Path], how: Reading, joined: bool) -> list[Samples]:
    from coaxlink import files
    from coaxlink.data.join import join

    paths = [files.example("stand_eq17.csv") if str(p) == "example" else p for p in logs]
    with talk().status("reading") as status:
        read = read_stand(paths, how, status.update, one_rotor=joined)
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
    from coaxlink.report.pictures.identify_curve import curve_table
    from coaxlink.rotor.learning import learning_curve

    curves = [learning_curve(result.form, result.data, options) for result in results]
    for curve in curves:
        console().print(curve_table(curve))
    return [[asdict(lesson) for lesson in curve] for curve in curves]


def _output_files(out: Path, count: int) -> list[Path]:
    """Where each model goes: the name asked for, numbered when one call makes several."""
    if count == 1:
        return [out]
    return [out.with_name(f"{out.stem}_{i}{out.suffix}") for i in range(1, count + 1)]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("identify", short_help="Identify a rotor model from stand logs, or from flights.")(identify)
