"""`coaxlink table`: a mixing law as an autopilot's own files, and what that firmware will make of them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coaxlink import files
from coaxlink.cli.shared import constraints, explanation, table_views
from coaxlink.cli.shared.constraints import ConstrainOption
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
    from coaxlink.airframe import Airframe
    from coaxlink.mixer.fitted import FittedTable
    from coaxlink.tables.rate_gains import PreservedGains
    from coaxlink.uploading.explain import Explanation
    from coaxlink.vehicle import Vehicle
    from firmware_params.errors import Finding


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
    constrain: ConstrainOption = None,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Write a mixer table and say what mix the firmware will make of it."""
    if firmware not in ("px4", "ardupilot"):
        raise InputError("--firmware", firmware, "expected px4 or ardupilot")
    if keep_gains and not connect:
        raise InputError("--keep-gains", "", "--connect URL is expected: the gains to keep are on the board")
    files.refuse_unwritable(json_file)
    vehicle, path = vehicle_of(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(vehicle)
    wish = _Wish(law, out, explain, connect, frame_class, spin_min, keep_gains, constrain, json_file)
    with _naming(path):
        _make(firmware, _px4() if firmware == "px4" else _ardupilot(), vehicle, path, wish)


@dataclass(frozen=True)
class _Wish:
    """The options, as they go to either firmware."""

    law: str
    out: Path | None
    explain: bool
    connect: str
    frame_class: int
    spin_min: float
    keep_gains: bool
    constrain: Path | None
    json_file: Path | None

    def gains(
        self, firmware: str, explained: Explanation, board: Mapping[str, float | int] | None
    ) -> PreservedGains:
        """What becomes of the rate loops, and what is written about it."""
        from coaxlink.tables.rate_gains import preserved_gains

        against = explanation.under(explained.reference_name)
        gains = preserved_gains(
            firmware, explained.flown, explained.reference, board or {}, against, write=self.keep_gains
        )
        if gains.problem:
            say(f"not all rate gains are written: {gains.problem}")
        return gains


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


@dataclass(frozen=True)
class _Firmware:
    """What differs from one firmware to the other."""

    title: str
    spin_min: Callable[[_Wish], float]  # least motor command of a fitted table
    report: Callable[[Vehicle, _Wish, FittedTable | None], Any]
    on_board: Callable[[str], Any]  # what a board at an address has, as `explain` takes it
    parameters: Callable[[Any], Mapping[str, float | int]]  # of that
    explain: Callable[[Vehicle, Any, Any], Explanation]
    write: Callable[[Path, Airframe, Path, Any], list[str]]
    to_json: Callable[[Airframe, Any, list[str]], dict[str, Any]]
    show: Callable[[Airframe, Any, str], None]


def _px4() -> _Firmware:
    from coaxlink.tables import files as table_files
    from coaxlink.tables import px4
    from coaxlink.uploading.explain import explain_px4, present_px4

    return _Firmware(
        title="PX4",
        spin_min=lambda _: 0.0,
        report=lambda vehicle, wish, fit: px4.report_px4(vehicle, wish.law, fit=fit),
        on_board=present_px4,
        parameters=lambda board: board,
        explain=explain_px4,
        write=table_files.write_px4,
        to_json=table_views.px4_json,
        show=table_views.show_px4,
    )


def _ardupilot() -> _Firmware:
    from coaxlink.tables import files as table_files
    from coaxlink.tables.ardupilot import report_ap
    from coaxlink.uploading.explain import explain_ap, present_ap

    return _Firmware(
        title="ArduPilot",
        spin_min=lambda wish: wish.spin_min,
        report=lambda vehicle, wish, fit: report_ap(
            vehicle, wish.law, frame_class=wish.frame_class, spin_min=wish.spin_min, fit=fit
        ),
        on_board=present_ap,
        parameters=lambda board: board[0],
        explain=explain_ap,
        write=table_files.write_ap,
        to_json=table_views.ap_json,
        show=table_views.show_ap,
    )


def _make(name: str, of: _Firmware, vehicle: Vehicle, model_path: Path, wish: _Wish) -> None:
    """Fit the table, hold it against a board, write it, show it."""
    frame = vehicle.airframe
    limited = constraints.constrained(vehicle, wish.constrain, wish.law, of.spin_min(wish))
    report = of.report(vehicle, wish, limited.table if limited else None)
    board = of.on_board(wish.connect) if wish.connect else None
    explained = of.explain(vehicle, report, board)
    gains = wish.gains(name, explained, of.parameters(board) if board else None)
    report = replace(report, params={**report.params, **gains.written})
    written = []
    if wish.out and not report.blocking:
        forget_vehicle(wish.out)
        written = of.write(wish.out, frame, model_path, report)
        keep_vehicle(wish.out, vehicle, model_path)
    document = of.to_json(frame, report, written) | vehicle.to_json() | gains.to_json()
    document |= constraints.as_json(limited)
    _save(wish, document, explained)
    of.show(frame, report, gains.line)
    if limited:
        constraints.show(limited, vehicle.model.speed_max_rpm)
    if wish.explain:
        explanation.show(console(), frame, explained, of.title, gains.axes)
    _end(wish, written, report.blocking)


def _save(wish: _Wish, document: dict[str, Any], explained: Explanation) -> None:
    """The JSON, before anything is printed: a closed pipe must not lose it."""
    if wish.explain:
        document["explain"] = explained.to_json()
    if wish.json_file:
        files.write_json(wish.json_file, document)


def _end(wish: _Wish, written: list[str], blocking: Sequence[Finding]) -> None:
    """What both firmwares end with: the files' names, a refusal, or what to do next."""
    for path in written:
        say(f"wrote {path}")
    if blocking:
        raise SafetyRefusal(str(blocking[0]))
    if wish.out:
        say(f"next: coaxlink upload {wish.out} --connect URL --dry-run")
    else:
        say("next: --out DIR writes the files that coaxlink upload takes")


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("table", short_help="Write a mixer table and say what the firmware makes of it.")(table)
