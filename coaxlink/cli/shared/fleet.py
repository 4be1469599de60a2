"""A folder or bucket of logs, looked through log by log and reported vehicle by vehicle over time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink.cli.shared.shell import console, say

if TYPE_CHECKING:
    from coaxlink.studies.campaign.fleet import Analyse, Fleet


def folder_of(logs: Path) -> str | None:
    """The folder or bucket that an argument means; None for a file. `s3://bucket` loses a slash as a Path."""
    text = str(logs)
    scheme, colon, rest = text.partition(":/")
    if colon and len(scheme) > 1 and not logs.exists():
        return f"{scheme}://{rest.lstrip('/')}" if scheme != "file" else f"file:///{rest.lstrip('/')}"
    return text if logs.is_dir() else None


def tell_fleet(
    folder: str, analyse: Analyse, workers: int, scheduler: str | None, report: Path | None, json: Path | None
) -> Fleet:
    """Analyse every log under `folder` and show what it says of the vehicles. Raises CoaxlinkError."""
    from rich.table import Table

    from coaxlink import files
    from coaxlink.report import fleet as shown
    from coaxlink.studies.campaign.engine import Machine
    from coaxlink.studies.campaign.fleet import find_logs, look_through
    from coaxlink.studies.campaign.progress import Progress

    logs = find_logs(folder)
    progress = Progress(len(logs), 0, "logs", _write, sys.stderr.isatty())
    fleet = look_through(logs, analyse, Machine(workers, scheduler), progress.at)
    progress.end(len(logs))
    screen = console()
    for line in shown.sentences(fleet):
        screen.print(line)
    if fleet.trends:
        table = Table(*shown.HEADS, box=None)
        for row in shown.rows(fleet.trends):
            table.add_row(*row)
        screen.print(table)
    for name, why in list(fleet.problems.items())[:10]:
        say(f"says nothing: {name}: {why}")
    if report is not None:
        files.write_atomic(report, shown.page(fleet))
        say(f"wrote {report}")
    if json is not None:
        files.write_json(json, fleet.to_json())
    return fleet


def _write(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()
