"""`coaxlink table`: a mixing law as an autopilot's own files, and what that firmware will make of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink import files
from coaxlink.cli import _explain, _tables
from coaxlink.cli._effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    load_seen,
    say_effects,
)
from coaxlink.cli._shell import JsonOption, console, say
from coaxlink.cli._tables import write_px4
from coaxlink.errors import InputError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.mixer import Seen


def table(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    firmware: Annotated[str, typer.Option(help="px4 or ardupilot.")],
    law: Annotated[str, typer.Option(help="fitted, reduced or standard.")] = "fitted",
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the files here.")] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Also what was asked, what is done, gains and authority.")
    ] = False,
    connect: Annotated[
        str, typer.Option(metavar="URL", help="With --explain: hold it against the table on this board.")
    ] = "",
    frame_class: Annotated[int, typer.Option(help="ArduPilot: 15 scripting, 17 dynamic matrix.")] = 15,
    spin_min: Annotated[float, typer.Option(help="ArduPilot: MOT_SPIN_MIN.")] = 0.05,
    csv: Annotated[
        bool, typer.Option("--csv", help="PX4: also mixer.csv, for the research fork that reads one.")
    ] = False,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Write a mixer table and say what mix the firmware will make of it."""
    if firmware not in ("px4", "ardupilot"):
        raise InputError("--firmware", firmware, "expected px4 or ardupilot")
    files.refuse_unwritable(json_file)
    seen, path = load_seen(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(seen)
    with _naming(path):
        if firmware == "px4":
            _px4(seen, path, law, out, json_file, explain, connect, csv)
        else:
            _ardupilot(seen, path, law, out, json_file, explain, connect, frame_class, spin_min)


@contextlib.contextmanager
def _naming(model_path: Path) -> Iterator[None]:
    """Errors that a rotor model's numbers cause name its file, wherever it came from."""
    from coaxlink.link.tables import ROTOR_MODEL

    try:
        yield
    except InputError as error:
        if error.source != ROTOR_MODEL:
            raise
        raise InputError(model_path, error.where, error.problem) from error


def _px4(
    seen: Seen,
    model_path: Path,
    law: str,
    out: Path | None,
    json_file: Path | None,
    explain: bool,
    connect: str,
    csv: bool,
) -> None:
    from coaxlink.link import tables
    from coaxlink.link.explain import explain_px4, present_px4

    frame, model = seen.airframe, seen.model
    report = tables.report_px4(frame, model, law)
    written = write_px4(out, frame, model_path, report) if out and not report.blocking else []
    if csv and out and not report.blocking:
        written.append(_tables.write_csv(out, report))
    document = _tables.px4_json(frame, report, written) | seen.to_json()
    _tables.show_px4(frame, report)
    if explain:
        board = present_px4(connect) if connect else None
        explained = explain_px4(frame, model, report, board)
        document["explain"] = explained.to_json()
        _explain.show(console(), frame, explained, "PX4", _tables.PX4_GAINS)
    if json_file:
        files.write_json(json_file, document)
    for path in written:
        say(f"wrote {path}")
    if report.blocking:
        raise SafetyRefusal(str(report.blocking[0]))


def _ardupilot(
    seen: Seen,
    model_path: Path,
    law: str,
    out: Path | None,
    json_file: Path | None,
    explain: bool,
    connect: str,
    frame_class: int,
    spin_min: float,
) -> None:
    from coaxlink.link.ap_tables import report_ap
    from coaxlink.link.explain import explain_ap, present_ap

    frame, model = seen.airframe, seen.model
    report = report_ap(frame, model, law, frame_class=frame_class, spin_min=spin_min)
    written = _tables.write_ap(out, frame, model_path, report) if out and not report.blocking else []
    document = _tables.ap_json(frame, report, written) | seen.to_json()
    _tables.show_ap(frame, report)
    if explain:
        explained = explain_ap(frame, model, report, present_ap(connect) if connect else None)
        document["explain"] = explained.to_json()
        _explain.show(console(), frame, explained, "ArduPilot", _tables.AP_GAINS)
    if json_file:
        files.write_json(json_file, document)
    for path in written:
        say(f"wrote {path}")
    if report.blocking:
        raise SafetyRefusal(str(report.blocking[0]))


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("table")(table)
