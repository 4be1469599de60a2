"""`coaxlink identify`: stand data to a rotor model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from coaxlink import files
from coaxlink.cli.shared.flight_logs import SystemOfLogOption
from coaxlink.cli.shared.from_flights import AirframeOption, PriorOption, identify_from_flights
from coaxlink.cli.shared.next import after_identify
from coaxlink.cli.shared.shell import JsonOption, console, say, talk
from coaxlink.cli.shared.single import (
    BladesOption,
    PitchOption,
    SingleOption,
    SpacingOption,
    SupplyOption,
    prior_of_single,
)
from coaxlink.cli.shared.stand import (
    ColumnsOption,
    DiameterOption,
    PolesOption,
    SheetOption,
    StandOptions,
    TrustOption,
    UpperOption,
    doubts,
    read_stand,
)
from coaxlink.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from coaxlink.data import Samples
    from coaxlink.rotor import Identification, RotorModel
    from coaxlink.rotor.log_checks import LogChecks
    from coaxlink.rotor.stand_data import Speeds


class ModelForm(StrEnum):
    """What --form takes."""

    CRM = "crm"
    RCRM = "rcrm"
    SRM = "srm"
    CPCM = "cpcm"
    AUTO = "auto"


def identify(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG...", help="Stand logs; 'example' for the shipped one."),
    ] = None,
    form: Annotated[
        ModelForm, typer.Option(help="Rotor model; auto keeps what held-out data supports.")
    ] = ModelForm.AUTO,
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
    join: Annotated[
        bool, typer.Option("--join", help="One model of all logs: single-rotor tests with coaxial maps.")
    ] = False,
    plan: Annotated[
        Path | None,
        typer.Option("--next", metavar="PLAN.toml", help="Of flights: write the most informative next one."),
    ] = None,
    co_rotating: Annotated[
        bool, typer.Option("--co-rotating", help="Both rotors of the pair on the stand turn the same way.")
    ] = False,
    single: SingleOption = None,
    pitch: PitchOption = None,
    spacing: SpacingOption = None,
    blades: BladesOption = 2,
    voltage: SupplyOption = None,
    airframe: AirframeOption = None,
    rotor: PriorOption = None,
    system: SystemOfLogOption = None,
    every: Annotated[
        bool, typer.Option("--all", help="Print terms, every form's errors and all remarks, too.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Write pictures (PNG, SVG, PDF).")] = None,
    report: Annotated[Path | None, typer.Option(metavar="R.html", help="Write one page of it all.")] = None,
) -> None:
    """Identify a rotor model from stand logs: loads, drive and battery watts, with held-out errors.

    Without a stand, --single makes a first model of a pair from a table of one rotor, and flight logs with
    --airframe and --rotor update it (docs/no_stand.md).
    """
    how = StandOptions(columns, upper, poles, diameter, sheet, trust_units)
    if single is not None:
        if logs:
            raise InputError("--single", "", f"a table in place of stand logs, found also {logs[0]}")
        prior_of_single(
            single,
            how,
            spacing_m=spacing,
            pitch_m=pitch,
            blades=blades,
            voltage_V=voltage,
            speed_max_rpm=speed_max_rpm,
            out=out,
            json=json,
            plot=plot,
        )
        return
    if voltage is not None:
        raise InputError("--voltage", "", "is for --single")
    if not logs:
        raise InputError("identify", "LOG...", "a stand log is expected, or --single TABLE of one rotor")
    if airframe is not None or rotor is not None:
        identify_from_flights(logs, airframe, rotor, system, out, json, plan)
        return
    from coaxlink.rotor.fit import Options
    from coaxlink.rotor.identification import identify as run
    from coaxlink.rotor.log_checks import check_log

    if plan is not None:
        raise InputError("--next", "", "is for flights: with --airframe and --rotor")
    if system is not None:
        raise InputError("--system", "", "is for flights: with --airframe and --rotor")
    options = Options(max_order)
    from coaxlink.rotor.pair_sum import is_pair, of_each_rotor

    read = _read(logs, how, join)
    if sums := [samples for samples in read if is_pair(of_each_rotor(samples))]:
        _answer_of_sums(sums, speed_max_rpm, out, json)
        return
    for samples in read:
        for doubt in doubts(samples, upper):
            say(f"! {doubt}")
    results = [run(samples, form.value, speed_max_rpm=speed_max_rpm, options=options) for samples in read]
    checks = [check_log(result, diameter) for result in results]
    for result, checked in zip(results, checks, strict=True):
        _print(result, checked, every)
    if out:
        _save([result.model for result in results], out, co_rotating)
    if json:
        _write_json(json, results, checks)
    if plot or report:
        _draw(results, plot, report)
    say(after_identify(out, results[0].form))


def _read(logs: list[Path], how: StandOptions, joined: bool) -> list[Samples]:
    from coaxlink.data.join import join

    paths = [files.example("stand_eq17.csv") if str(p) == "example" else p for p in logs]
    with talk().status("reading") as status:
        read = read_stand(paths, how, status.update, one_rotor=joined)
    return [join(read)] if joined else read


def _print(result: Identification, checks: LogChecks, every: bool) -> None:
    from coaxlink.data.tare import TAKEN
    from coaxlink.report.identify import answer, drive_lines, remarks, sentence, tables

    data = result.data
    found = f" of {data.samples.rows} conditions" if data.samples.rows < data.logged else ""
    say(f"{data.samples.source}: {data.logged} rows{found}")
    screen = console()
    screen.print(sentence(result))
    screen.print(answer(result))
    for line in drive_lines(result):
        screen.print(line)
    for line in (*result.warnings, *checks.odd):
        say(f"! {line}")
    if not every:
        for note in data.samples.notes:  # the user's own numbers, changed
            if note.startswith(TAKEN):
                say(f"- {note}")
        say("terms, forms and remarks: --all, --report or --json")
        return
    for line in checks.covers:
        say(f"- {line}")
    for table in tables(result):
        screen.print(table)
    for remark in remarks(result):
        if remark not in result.warnings:  # reported above
            say(f"- {remark}")


def _save(models: list[RotorModel], out: Path, co_rotating: bool) -> None:
    from coaxlink.rotor.model import CO_ROTATING, COUNTER_ROTATING, save_rotor_model

    rotation = CO_ROTATING if co_rotating else COUNTER_ROTATING

    for model, path in zip(models, _numbered(out, len(models)), strict=True):
        save_rotor_model(path, replace(model, rotation=rotation))
        say(f"wrote {path}")


def _write_json(path: Path, results: list[Identification], checks: list[LogChecks]) -> None:
    """The contract's object; of several logs the first one's, and all under `models`."""
    models = [
        {
            "file": result.data.samples.source,
            **result.as_json(),
            "oddities": list(checked.odd),
            "coverage": checked.coverage.as_json(),
        }
        for result, checked in zip(results, checks, strict=True)
    ]
    several = {"models": models} if len(models) > 1 else {}
    files.write_json(path, {**models[0], **several})


def _draw(results: list[Identification], plot: Path | None, report: Path | None) -> None:
    """Pictures into a folder (one a log when there are several), and pages."""
    from coaxlink.report.identify_page import identify_page
    from coaxlink.report.made import Made
    from coaxlink.report.pictures.figures import write_figures
    from coaxlink.report.pictures.identify_plots import figures

    pages = _numbered(report, len(results)) if report else [None] * len(results)
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


def _numbered(path: Path, count: int) -> list[Path]:
    """Where each of `count` goes: the requested name, numbered when one call makes several."""
    if count == 1:
        return [path]
    return [path.with_name(f"{path.stem}_{i}{path.suffix}") for i in range(1, count + 1)]


def _answer_of_sums(
    logs: Sequence[Samples], speed_max_rpm: float | None, out: Path | None, json: Path | None
) -> None:
    """Print the model of each sum, what it leaves open and the run that tells it.

    Raises CheckFailed where a rotor file is wanted of them.
    """
    from coaxlink import files
    from coaxlink.rotor.identification import CORRELATED
    from coaxlink.rotor.pair_sum import OPEN, pair_sum
    from coaxlink.rotor.stand_data import unit_of

    found = [pair_sum(log, speed_max_rpm) for log in logs]
    for one in found:
        say(f"{one.samples.source}: {one.samples.rows} rows, both rotors on one cell")
        table = Table("sum", "term", "value", "95 % interval", "held-out RMSE", title="both rotors together")
        for name, fit in one.fits.items():
            error = one.errors[name]
            held_out = f"{error.rmse:.3g} {unit_of(name)}, {100 * error.nrmse:.2g} % of the range"
            for term, value in fit.polynomial.terms().items():
                low, high = fit.intervals.bounds.get(term, (float("nan"),) * 2)
                table.add_row(name, term, f"{value:.4g}", f"{low:.4g} .. {high:.4g}", held_out)
                name = held_out = ""
        console().print(table)
        notes = [_full_speed(one.speeds), *one.samples.notes]
        if abs(one.speeds.correlation()) > CORRELATED:
            notes.insert(0, "both speeds go together: the sum is known along that line alone")
        for note in notes:
            say(f"- {note}")
    if json:
        answers = [one.as_json() for one in found]
        files.write_json(json, answers[0] if len(answers) == 1 else {"logs": answers})
    for line in OPEN:
        say(line)
    if out:
        raise CheckFailed(f"{out} is not written: a rotor file holds the loads of each rotor")


def _full_speed(speeds: Speeds) -> str:
    """What u = 1 is."""
    full = "full throttle" if speeds.from_throttle else f"{speeds.speed_max_rpm:.0f} rpm"
    return f"u = 1 is {full} ({speeds.source})"
