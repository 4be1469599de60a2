"""A folder of logs, looked through log by log and reported vehicle by vehicle over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from coaxlink.cli.shared.progress import progress
from coaxlink.cli.shared.shell import console, say

if TYPE_CHECKING:
    from coaxlink.studies.fleet import Analyse, Fleet


def folder_of(logs: Path) -> str | None:
    """The folder that an argument means; None for a file."""
    return str(logs) if logs.is_dir() else None


def tell_fleet(
    folder: str, analyse: Analyse, workers: int, scheduler: str | None, report: Path | None, json: Path | None
) -> Fleet:
    """Analyse every log under `folder` and show what it says of the vehicles. Raises CoaxlinkError."""
    from coaxlink import files
    from coaxlink.report import fleet as shown
    from coaxlink.report.terminal import table
    from coaxlink.studies.engine import Machine
    from coaxlink.studies.fleet import find_logs, look_through

    logs = find_logs(folder)
    with progress("logs", len(logs)) as bar:
        fleet = look_through(logs, analyse, Machine(workers, scheduler), bar.at)
    screen = console()
    for line in shown.sentences(fleet):
        screen.print(line)
    if fleet.trends:
        screen.print(table("", shown.HEADS, shown.rows(fleet.trends), left=3))
    for name, why in list(fleet.problems.items())[:10]:
        say(f"says nothing: {name}: {why}")
    if report is not None:
        files.write_atomic(report, shown.page(fleet))
        say(f"wrote {report}")
    if json is not None:
        files.write_json(json, fleet.to_json())
    return fleet
