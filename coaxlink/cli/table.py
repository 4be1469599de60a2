"""`coaxlink table`: a mixing law as an autopilot's own files, and what that firmware will make of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink import files
from coaxlink.cli.shared import explanation, table_views
from coaxlink.cli.shared.effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    say_effects,
    vehicle_of,
)
from coaxlink.cli.shared.rate_loops import forget_vehicle, keep_vehicle
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.errors import InputError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.mixer.constrained import ConstrainedTable
    from coaxlink.mixer.fitted import FittedTable
    from coaxlink.tables.ardupilot import ApReport
    from coaxlink.tables.px4 import TableReport
    from coaxlink.uploading.explain import Explanation
    from coaxlink.vehicle import Vehicle

TITLES = {"px4": "PX4", "ardupilot": "ArduPilot"}


def table(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    firmware: Annotated[str, typer.Option(help="px4 or ardupilot.")],
    law: Annotated[
        str, typer.Option(help="fitted, reduced, standard or curved (docs/mixers.md).")
    ] = "fitted",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the files here.")] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Also what is demanded, what is done, gains and authority.")
    ] = False,
    connect: Annotated[
        str, typer.Option(metavar="URL", help="Hold it against the table on this board.")
    ] = "",
    frame_class: Annotated[int, typer.Option(help="ArduPilot: 15 scripting, 17 dynamic matrix.")] = 15,
    spin_min: Annotated[float, typer.Option(help="ArduPilot: MOT_SPIN_MIN.")] = 0.05,
    keep_gains: Annotated[
        bool,
        typer.Option(
            "--keep-gains",
            help="With --connect: also write the rate gains that keep the loops as they are on board.",
        ),
    ] = False,
    constrain: Annotated[
        Path | None,
        typer.Option("--constrain", metavar="LIMITS.toml", help="With --law fitted: limits it shall keep."),
    ] = None,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Write a mixer table and say what mix the firmware will make of it."""
    from coaxlink.tables.rate_gains import preserved_gains

    if firmware not in TITLES:
        raise InputError("--firmware", firmware, "expected px4 or ardupilot")
    if keep_gains and not connect:
        raise InputError("--keep-gains", "", "--connect URL is expected: the gains to keep are on the board")
    files.refuse_unwritable(json_file)
    vehicle, path = vehicle_of(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(vehicle)
    report: TableReport | ApReport
    with _naming(path):
        limited = _limited(vehicle, constrain, law, 0.0 if firmware == "px4" else spin_min)
        fit = limited.table if limited else None
        if firmware == "px4":
            report, explained, board = _px4(vehicle, law, fit, connect)
        else:
            report, explained, board = _ardupilot(vehicle, law, fit, connect, frame_class, spin_min)
    against = explanation.under(explained.reference_name)
    gains = preserved_gains(firmware, explained.flown, explained.reference, board, against, write=keep_gains)
    if gains.problem:
        say(f"not all rate gains are written: {gains.problem}")
    report = replace(report, params={**report.params, **gains.written})
    written = [] if out is None or report.blocking else _write(out, vehicle, path, report)
    if json_file:  # before anything is printed: a closed pipe must not lose it
        document: dict[str, Any] = table_views.as_json(vehicle.airframe, report, written)
        document |= vehicle.to_json() | gains.to_json()
        document |= {"limits": limited.to_json()} if limited else {}
        document |= {"explain": explained.to_json()} if explain else {}
        files.write_json(json_file, document)
    table_views.show(vehicle.airframe, report, gains.line)
    if limited:
        table_views.show_limits(limited, vehicle.model.speed_max_rpm)
    if explain:
        explanation.show(console(), vehicle.airframe, explained, TITLES[firmware], gains.axes)
    for name in written:
        say(f"wrote {name}")
    if report.blocking:
        raise SafetyRefusal(str(report.blocking[0]))
    if out:
        say(f"next: coaxlink upload {out} --connect URL --dry-run")
    else:
        say("next: --out DIR writes the files that coaxlink upload takes")


@contextlib.contextmanager
def _naming(model_path: Path) -> Iterator[None]:
    """Errors that a rotor model's numbers cause name its file, wherever it came from."""
    from coaxlink.tables.px4 import ROTOR_MODEL

    try:
        yield
    except InputError as error:
        if error.source != ROTOR_MODEL:
            raise
        raise InputError(model_path, error.where, error.problem) from error


def _limited(vehicle: Vehicle, limits: Path | None, law: str, spin_min: float) -> ConstrainedTable | None:
    """The table under the limits of a file. Raises InputError, and CheckFailed when none keeps them."""
    if limits is None:
        return None
    if law != "fitted":
        raise InputError("--constrain", "", f"--law fitted is expected, found {law}: only that one is chosen")
    from coaxlink.mixer.constrained import constrained_table
    from coaxlink.mixer.limits import load_limits

    return constrained_table(vehicle, load_limits(limits, vehicle.airframe), spin_min=spin_min)


def _px4(
    vehicle: Vehicle, law: str, fit: FittedTable | None, connect: str
) -> tuple[TableReport, Explanation, Mapping[str, float | int]]:
    """The table, explained against the board's (else the standard law's), and the board's parameters."""
    from coaxlink.tables.px4 import report_px4
    from coaxlink.uploading.explain import explain_px4, present_px4

    report = report_px4(vehicle, law, fit=fit)
    board = present_px4(connect) if connect else None
    return report, explain_px4(vehicle, report, board), board or {}


def _ardupilot(
    vehicle: Vehicle, law: str, fit: FittedTable | None, connect: str, frame_class: int, spin_min: float
) -> tuple[ApReport, Explanation, Mapping[str, float | int]]:
    """As `_px4`."""
    from coaxlink.tables.ardupilot import report_ap
    from coaxlink.uploading.explain import explain_ap, present_ap

    report = report_ap(vehicle, law, frame_class=frame_class, spin_min=spin_min, fit=fit)
    board = present_ap(connect) if connect else None
    return report, explain_ap(vehicle, report, board), board[0] if board else {}


def _write(out: Path, vehicle: Vehicle, rotors: Path, report: TableReport | ApReport) -> list[str]:
    """The files of the table, and a copy of the vehicle that it was made from."""
    from coaxlink.tables.files import write_table

    forget_vehicle(out)
    written = write_table(out, vehicle.airframe, rotors, report)
    keep_vehicle(out, vehicle, rotors)
    return written


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("table", short_help="Write a mixer table and say what the firmware makes of it.")(table)
