"""`coaxlink upload`: a table on board, all or nothing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coaxlink.cli.shared.line import address_of, typed_again, vehicle_at
from coaxlink.cli.shared.next import after_upload
from coaxlink.cli.shared.shell import JsonOption, console, say
from coaxlink.errors import SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.uploading.outcome import Change, Outcome, Talk

ConnectOption = Annotated[
    str, typer.Option(metavar="URL", help="Where the vehicle is, udpin:0.0.0.0:14550 ...")
]
VehicleConnectOption = Annotated[
    str | None,
    typer.Option(metavar="URL", help="Where it is, udpin:0.0.0.0:14550 ..., if its file does not say."),
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before writing.")]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Show the difference and write nothing.")]
TimeoutOption = Annotated[float, typer.Option(metavar="S", help="How long to wait for the vehicle.")]
SystemOption = Annotated[
    int | None, typer.Option(metavar="ID", help="System id, where several are heard or recorded.")
]
SigningOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="MAVLink 2 signing key, mode 600; both sides must sign.")
]
NewGeometryOption = Annotated[
    bool, typer.Option("--new-geometry", help="Allow other rotor places or spins than the board has.")
]
BackupOption = Annotated[Path, typer.Option(metavar="DIR", help="Where backups go.")]


def upload(
    source: Annotated[
        Path, typer.Argument(metavar="DIR", help="What `coaxlink table` wrote, or one file of parameters.")
    ],
    connect: VehicleConnectOption = None,
    dry_run: DryRunOption = False,
    yes: YesOption = False,
    json_file: JsonOption = None,
    timeout: TimeoutOption = 10.0,
    system: SystemOption = None,
    signing_key: SigningOption = None,
    backup_dir: BackupOption = Path("backups"),
    new_geometry: NewGeometryOption = False,
    spin_from_table: Annotated[
        bool,
        typer.Option("--spin-from-table", help="ArduPilot: also MOT_SPIN_*, else as tuned on board."),
    ] = False,
    take_over: Annotated[
        bool,
        typer.Option("--take-over", help="ArduPilot: your own matrix script makes way; the backup has it."),
    ] = False,
    reboot: Annotated[
        bool, typer.Option("--reboot", help="Restart the autopilot in any case and read the table once more.")
    ] = False,
) -> None:
    """Show the difference, back up, write, read back, compare; roll back on any failure."""
    from coaxlink import files
    from coaxlink.cli.shared.rate_loops import kept_airframe, reported_first
    from coaxlink.uploading.outcome import REFUSED, VERIFIED, Outcome
    from coaxlink.uploading.plan import load_plan, refuse_values
    from coaxlink.uploading.worker import Uploader

    files.refuse_unwritable(json_file)
    connect = address_of(connect, kept_airframe(source))
    plan = load_plan(source)
    for note in plan.notes:
        say(f"note: {note}")
    try:
        refuse_values(plan.firmware, plan.params, plan.files[0])
    except SafetyRefusal as error:
        finish(Outcome(REFUSED, files=tuple(map(str, plan.files)), reason=str(error), error=error), json_file)
    with vehicle_at(
        connect, timeout_s=timeout, system=system, signing_key=signing_key, station=True
    ) as session:
        doubts: list[str] = []
        present = reported_first(source, plan, doubts, spin_from_table=spin_from_table)
        talk = replace(conversation(yes or dry_run, doubts), present=present)
        worker = Uploader(session, backup_folder=backup_dir, talk=talk)
        outcome = worker.upload(
            plan,
            dry_run=dry_run,
            new_geometry=new_geometry,
            reboot=reboot,
            spin_from_table=spin_from_table,
            take_over=take_over,
        )
    finish(outcome, json_file)
    if outcome.result == VERIFIED:
        say(after_upload(source, typed_again(connect, system)))


def conversation(yes: bool, doubts: Sequence[str] = ()) -> Talk:
    """Differences on stdout, talk on stderr, and a question unless `yes`; `doubts` are part of it."""
    from coaxlink.uploading.outcome import Talk

    def ask() -> bool:
        if yes:
            return True
        say(f"write this to the vehicle{', its other yaw gain too' if doubts else ''}? [y/N]")
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return Talk(say=say, difference=show, confirm=ask)


def show(changes: tuple[Change, ...]) -> None:
    """The difference, a row a parameter."""
    from rich.table import Table

    from coaxlink.uploading.outcome import value_text

    if not changes:
        return
    rows = Table("parameter", "on board", "new", box=None)
    for change in changes:
        old = value_text(change.name, change.old.value) if change.old.bits else "not there yet"
        rows.add_row(change.name, old, value_text(change.name, change.new.value))
    console().print(rows)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def finish(outcome: Outcome, json_file: Path | None) -> None:
    """Write the JSON, say the result, end with its exit code."""
    from coaxlink import files

    if json_file:
        files.write_json(json_file, outcome.to_json())
    if outcome.error is not None:
        raise outcome.error
    out = console()
    changed = _counted(len(outcome.changed), "parameter")
    changed += f" and {_counted(len(outcome.scripts), 'script')}" if outcome.scripts else ""
    if outcome.result == "dry_run":
        out.print(f"dry run: {changed} would change; nothing was written")
    else:
        detail = outcome.reason or f"{changed} written and read back"
        out.print(f"verified: {detail} ({outcome.retries} repeats)")
