"""`coaxlink table`: a mixing law as an autopilot's own files, and what that firmware will make of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from coaxlink import files
from coaxlink.cli.shared import table_views
from coaxlink.cli.shared.completion import one_of
from coaxlink.cli.shared.effects import (
    ClimbOption,
    DensityOption,
    HeightOption,
    VoltageOption,
    say_effects,
    vehicle_of,
)
from coaxlink.cli.shared.line import vehicle_at
from coaxlink.cli.shared.next import WEAK
from coaxlink.cli.shared.rate_loops import forget_vehicle, vehicle_files
from coaxlink.cli.shared.shell import JsonOption, say
from coaxlink.cli.upload import SystemOption
from coaxlink.errors import InputError, SafetyRefusal
from coaxlink.tables import TABLE_LAWS
from firmware_params import FIRMWARES

if TYPE_CHECKING:
    from coaxlink.mixer.demands import Commands
    from coaxlink.mixer.fitted import FittedTable
    from coaxlink.tables.ardupilot import ApReport
    from coaxlink.tables.px4 import TableReport
    from coaxlink.vehicle import Vehicle
    from firmware_params.ardupilot.table import ApTable


def table(
    airframe: Annotated[Path, typer.Argument(help="Airframe file.")],
    firmware: Annotated[str, typer.Option(help="px4 or ardupilot.", autocompletion=one_of(*FIRMWARES))],
    law: Annotated[
        str | None,
        typer.Option(
            help="fitted, balanced, reduced, standard or curved; else by the margins (docs/mixers.md).",
            autocompletion=one_of(*TABLE_LAWS),
        ),
    ] = None,
    share: Annotated[
        float | None,
        typer.Option(
            min=0.05, max=0.95, help="Fitted, with this share of the hover thrust by the upper rotors."
        ),
    ] = None,
    rotor: Annotated[Path | None, typer.Option(help="Rotor model, if not the airframe's own.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the files here.")] = None,
    connect: Annotated[
        str, typer.Option(metavar="URL", help="Hold it against the table on this board.")
    ] = "",
    system: SystemOption = None,
    frame_class: Annotated[int, typer.Option(help="ArduPilot: 15 scripting, 17 dynamic matrix.")] = 15,
    spin_min: Annotated[
        float | None,
        typer.Option(help="ArduPilot: MOT_SPIN_MIN; else the board's with --connect, or 0.05."),
    ] = None,
    keep_gains: Annotated[
        bool,
        typer.Option(
            "--keep-gains",
            help="With --connect: also write the rate gains that keep the loops as they are on board.",
        ),
    ] = False,
    around_weak_rotor: Annotated[
        bool,
        typer.Option("--around-weak-rotor", help="Also for a rotor file that says that a rotor is weak."),
    ] = False,
    voltage: VoltageOption = None,
    height: HeightOption = None,
    climb: ClimbOption = None,
    density: DensityOption = None,
    json_file: JsonOption = None,
) -> None:
    """Write a mixer table and say what mix the firmware will make of it."""
    from coaxlink.mixer.split import table_of
    from coaxlink.report.worth import price
    from coaxlink.tables.ardupilot import ap_commands, report_ap
    from coaxlink.tables.default_law import choose_law
    from coaxlink.tables.px4 import TableReport, px4_commands, report_px4
    from coaxlink.tables.rate_gains import preserved_gains
    from coaxlink.uploading.beside import beside_ap, beside_px4

    if firmware not in FIRMWARES:
        raise InputError("--firmware", firmware, "expected px4 or ardupilot")
    if share is not None and law not in (None, "fitted"):
        raise InputError("--share", law, "only the fitted law has a share of its own")
    if keep_gains and not connect:
        raise InputError("--keep-gains", "", "--connect URL is expected: the gains to keep are on the board")
    files.refuse_unwritable(json_file)
    vehicle, path = vehicle_of(airframe, rotor, voltage=voltage, height=height, climb=climb, density=density)
    say_effects(vehicle)
    if "degraded_rotor" in vehicle.compensated and not around_weak_rotor:
        raise SafetyRefusal(f"{path.name}: a rotor is weak: {WEAK} (--around-weak-rotor: a table around it)")
    with _naming(path):
        board, matrix = _present(firmware, connect, system)
        spin = _spin(firmware, spin_min, board)

        def reported(law: str, fit: FittedTable | None) -> TableReport | ApReport:
            if firmware == "px4":
                return report_px4(vehicle, law, fit=fit)
            low, high, arm = spin
            return report_ap(
                vehicle, law, frame_class=frame_class, spin_min=low, spin_max=high, spin_arm=arm, fit=fit
            )

        def speeds_of(law: str, fit: FittedTable | None) -> Commands:
            made = reported(law, fit)
            return px4_commands(made.mix) if isinstance(made, TableReport) else ap_commands(made.mix)

        chosen = None
        split = table_of(vehicle, share, spin.low, spin.high) if share is not None else None
        if law is None and split is None:
            chosen = choose_law(vehicle, speeds_of, spin_min=spin.low, spin_max=spin.high)
        report = reported(chosen.law, chosen.fit) if chosen else reported(law or "fitted", split)
        if isinstance(report, TableReport):
            held = beside_px4(vehicle, report, board if connect else None)
        else:
            held = beside_ap(vehicle, report, (board, matrix) if connect else None)
    gains = preserved_gains(firmware, held.flown, held.reference, board, held.against, write=keep_gains)
    if gains.problem:
        say(f"not all rate gains are written: {gains.problem}")
    report = replace(report, params={**report.params, **gains.written})
    cost = price(held.worth, held.reference_worth, held.against)
    written = [] if out is None or report.blocking else _write(out, vehicle, path, report)
    if json_file:  # before anything is printed: a closed pipe must not lose it
        document: dict[str, Any] = table_views.as_json(vehicle.airframe, report, written)
        document |= vehicle.to_json() | gains.to_json()
        document |= {"chosen": chosen.to_json()} if chosen else {}
        document["price"] = cost
        files.write_json(json_file, document)
    if chosen:
        say(f"--law was not named, chosen: {chosen.why}")
    table_views.show(vehicle.airframe, report, [*cost, gains.line])
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


class _Spin(NamedTuple):
    """A spin range, normalised; without `arm` the table's own."""

    low: float
    high: float
    arm: float | None = None


def _spin(firmware: str, spin_min: float | None, board: Mapping[str, float | int]) -> _Spin:
    """PX4 has none; ArduPilot's is what was asked for, else what its owner tuned, else the table's."""
    from coaxlink.tables.ardupilot import SPIN_MIN
    from coaxlink.uploading.owners_numbers import SPIN

    if firmware == "px4":
        return _Spin(0.0, 1.0)
    if spin_min is None and all(name in board for name in SPIN):
        arm, low, high = (round(float(board[name]), 6) for name in SPIN)
        say(f"made for the board's spin range, {low:g} to {high:g} (--spin-min takes another)")
        return _Spin(low, high, arm)
    return _Spin(SPIN_MIN if spin_min is None else spin_min, 1.0)


def _present(firmware: str, url: str, system: int | None) -> tuple[Mapping[str, float | int], ApTable | None]:
    """The parameters on the board at `url` and, of ArduPilot, its table; nothing without a `url`."""
    from coaxlink.uploading.beside import present_ap, present_px4

    if not url:
        return {}, None
    with vehicle_at(url, system=system) as session:
        return (present_px4(session), None) if firmware == "px4" else present_ap(session)


def _write(out: Path, vehicle: Vehicle, rotors: Path, report: TableReport | ApReport) -> list[str]:
    """The files of the table, and a copy of the vehicle that it was made from."""
    from coaxlink.tables.files import write_table

    made_of = vehicle_files(vehicle, rotors)
    written = write_table(out, vehicle.airframe, rotors, report, made_of)
    forget_vehicle(out, made_of)
    return written
