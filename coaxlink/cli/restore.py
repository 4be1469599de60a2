"""`coaxlink restore`: a backup back on the board it was taken from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from coaxlink.cli.shared.line import vehicle_at
from coaxlink.cli.shared.shell import JsonOption, say
from coaxlink.cli.upload import (
    BackupOption,
    ConnectOption,
    DryRunOption,
    SigningOption,
    SystemOption,
    TimeoutOption,
    YesOption,
    conversation,
    finish,
)


def restore(
    backups: Annotated[
        list[Path],
        typer.Argument(metavar="BACKUP", help="A file that upload wrote, or your own of the parameters."),
    ],
    connect: ConnectOption,
    dry_run: DryRunOption = False,
    yes: YesOption = False,
    json_file: JsonOption = None,
    timeout: TimeoutOption = 10.0,
    system: SystemOption = None,
    signing_key: SigningOption = None,
    backup_dir: BackupOption = Path("backups"),
    everything: Annotated[
        bool, typer.Option("--all", help="All parameters, not just what the upload wrote.")
    ] = False,
) -> None:
    """Undo an upload: what it wrote goes back to what the backup holds, read back and compared.

    With --all every other parameter as well, but for those that the board itself counts, measures or learns.
    """
    from coaxlink import files
    from coaxlink.errors import InputError
    from coaxlink.uploading.backup import read_backup
    from coaxlink.uploading.worker import Uploader

    backup, *more = backups
    if more:
        found = ", ".join(str(path) for path in backups)
        raise InputError(
            "restore", "", f"one BACKUP is expected, found {found}: the oldest undoes all uploads since it"
        )
    files.refuse_unwritable(json_file)
    saved = read_backup(backup)
    for line in saved.read:
        say(f"note: {line}")
    with vehicle_at(
        connect, timeout_s=timeout, system=system, signing_key=signing_key, station=True
    ) as session:
        talk = conversation(yes or dry_run)
        worker = Uploader(session, backup_folder=backup_dir, talk=talk)
        outcome = worker.restore(saved, dry_run=dry_run, everything=everything)
    finish(outcome, json_file)
